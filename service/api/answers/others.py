"""Models, the audit trail, webhooks, blades at one hour, fields, operations."""

from __future__ import annotations

from service.api.answers.beliefs import BAND, BLADE, HEALTH, RESTS_ON, STANDING
from service.api.answers.diagnoses import DIAGNOSIS_LISTED
from service.api.answers.words import ANY, NUMBER, TEXT, WHOLE, Json, each, having, maybe, named

MODEL = having(
    id=TEXT,
    version=TEXT,
    digest=TEXT,
    state=TEXT,
    network=ANY,
    horizon_h=NUMBER,
    node_count=WHOLE,
    nodes=named(WHOLE),
    time_h=each(NUMBER),
    outputs=named(having(unit=TEXT, kind=TEXT)),
    summary=ANY,
)
AUDIT = having(
    id=WHOLE,
    at=TEXT,
    key=maybe(TEXT),
    who=TEXT,
    address=maybe(TEXT),
    request_id=TEXT,
    what=TEXT,
    path=TEXT,
    rotor=maybe(TEXT),
    entries=maybe(having(first_seq=WHOLE, last_seq=WHOLE)),
    status=WHOLE,
    problem=maybe(TEXT),
)
WEBHOOK = having(
    id=TEXT,
    url=TEXT,
    events=each(TEXT),
    rotors=maybe(each(TEXT)),
    created_at=TEXT,
    deliveries=having(pending=WHOLE, delivered=WHOLE, dead=WHOLE, dropped=WHOLE),
)
DELIVERY = having(
    id=TEXT,
    number=WHOLE,
    rotor=TEXT,
    event=TEXT,
    status=TEXT,
    attempts=WHOLE,
    created_at=TEXT,
    tried_at=maybe(TEXT),
    not_before=maybe(TEXT),
    last_error=maybe(TEXT),
)
READINGS_OF_BLADE = having(
    counting=WHOLE,
    overruled=WHOLE,
    last=maybe(having(id=TEXT, time_h=NUMBER, received_at=TEXT)),
)
AT_ONE_HOUR: Json = {"anyOf": [NUMBER, each(NUMBER)]}
BLADE_AT_A_GLANCE = having(
    **BLADE["properties"],
    readings=READINGS_OF_BLADE,
    prediction=having(mean=AT_ONE_HOUR, sd=named(AT_ONE_HOUR), held_from_h=maybe(NUMBER)),
)
BLADES = having(
    items=each(BLADE_AT_A_GLANCE),
    next=maybe(TEXT),
    rotor=TEXT,
    quantity=TEXT,
    unit=TEXT,
    node=maybe(WHOLE),
    time_h=NUMBER,
    head_seq=WHOLE,
    health=HEALTH,
    rests_on=RESTS_ON,
)
DRAWS = having(
    rotor=TEXT,
    blade=TEXT,
    names=each(TEXT),
    values=each(each(NUMBER)),
    of=WHOLE,
    health=HEALTH,
    rests_on=RESTS_ON,
)
ROTOR_DRAWS = having(
    rotor=TEXT,
    shared=having(names=each(TEXT), values=each(each(NUMBER))),
    local=having(names=each(TEXT), values=each(each(each(NUMBER)))),
    blades=each(TEXT),
    of=WHOLE,
    health=HEALTH,
    rests_on=RESTS_ON,
)
FIELD = having(
    rotor=TEXT,
    blade=TEXT,
    quantity=TEXT,
    unit=TEXT,
    time_h=NUMBER,
    particles=WHOLE,
    mean=BAND,
    sd=BAND,
    held_from_h=maybe(NUMBER),
    health=HEALTH,
    rests_on=RESTS_ON,
)
SURFACE = having(
    model=TEXT, version=TEXT, unit=TEXT, points=each(each(NUMBER)), triangles=each(each(WHOLE))
)
GAUGES = {
    **dict.fromkeys(("rotors", "backlog", "applied", "versions", "seals", "takeovers"), WHOLE),
    **dict.fromkeys(("dirty", "blocked", "provisional", "jobs"), WHOLE),
    **dict.fromkeys(("deliveries_pending", "deliveries_dead", "deliveries_dropped"), WHOLE),
    **dict.fromkeys(("alarms", "outdated", "adoptions", "back_outs"), WHOLE),
    **dict.fromkeys(("diagnosed", "undiagnosed"), WHOLE),
    "least_ess_ratio": maybe(NUMBER),
    "oldest_s": NUMBER,
}
UNFINISHED = {k: v for k, v in DIAGNOSIS_LISTED.items() if k not in ("rotor", "request")}
OPERATIONS = having(
    gauges=having(**GAUGES),
    work=each(
        having(owner=TEXT, does=TEXT, rotor_id=maybe(TEXT), lease_s=NUMBER, behind=maybe(WHOLE))
    ),
    jobs=each(having(**UNFINISHED, kind=TEXT, rotor=maybe(TEXT), request=ANY)),
    blocked=each(having(**STANDING)),
)
