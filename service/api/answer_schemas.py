"""What answers hold, as JSON schema for the OpenAPI document.

Every field is named and no other comes, so that a test that reads answers against the document sees
a field that is lost, renamed or added without a word.
"""

from __future__ import annotations

from typing import Any

Json = dict[str, Any]

TEXT: Json = {"type": "string"}
WHOLE: Json = {"type": "integer"}
NUMBER: Json = {"type": "number"}
YES: Json = {"type": "boolean"}
ANY: Json = {"type": "object"}


def maybe(schema: Json) -> Json:
    """The value, or null."""
    return schema | {"type": [schema["type"], "null"]}


def each(schema: Json) -> Json:
    return {"type": "array", "items": schema}


def named(schema: Json) -> Json:
    """Values by name."""
    return {"type": "object", "additionalProperties": schema}


def having(optional: tuple[str, ...] = (), /, **fields: Json) -> Json:
    """An object with these fields and no other."""
    required = [name for name in fields if name not in optional]
    return {
        "type": "object",
        "properties": fields,
        "required": required,
        "additionalProperties": False,
    }


def paged(schema: Json) -> Json:
    """A page; `next` is the cursor of the one after it."""
    return having(items=each(schema), next=maybe(TEXT))


HEALTH = having(
    status={"enum": ["ok", "degenerate", "contradicted", "unknown"]},
    reasons=each(TEXT),
    met_floor=maybe(YES),
    contradicted=each({}),
    trusted=YES,
) | {"additionalProperties": True}
BLADE = having(
    id=TEXT,
    slot=maybe(TEXT),
    lot=maybe(TEXT),
    coating_lot=maybe(TEXT),
    installed_at=maybe(TEXT),
    time_h0=maybe(NUMBER),
    added_seq=WHOLE,
    retired_seq=maybe(WHOLE),
    known=maybe(ANY),
    retired=YES,
)
MADE = {
    "id": TEXT,
    "model": TEXT,
    "model_version": TEXT,
    "particles": WHOLE,
    "seed": WHOLE,
    "network": maybe(ANY),
    "adopt": {"enum": ["never", "effect"]},
    "created_at": TEXT,
}
STANDING = MADE | {
    "origin": maybe(TEXT),
    "head_seq": WHOLE,
    "applied_seq": WHOLE,
    "version": WHOLE,
    "status": {"enum": ["blocked", "pending", "current"]},
    "attempts": WHOLE,
    "last_error": maybe(having(error=maybe(TEXT), event=maybe(TEXT))),
}
POSTERIOR_OF_ROTOR = having(
    version=WHOLE,
    through_seq=WHOLE,
    sealed=YES,
    state_digest=TEXT,
    events_digest=TEXT,
    model_version=TEXT,
    algorithm_version=TEXT,
    created_at=TEXT,
)
RESTS_ON = having(
    rotor=TEXT,
    version=WHOLE,
    through_seq=WHOLE,
    events_digest=TEXT,
    state_digest=TEXT,
    sealed=YES,
    model=TEXT,
    model_version=TEXT,
    model_digest=TEXT,
    algorithm_version=TEXT,
)
SUMMARY = {
    "rotor": TEXT,
    "parameters": named(having(mean=NUMBER, sd=NUMBER, quantiles=named(NUMBER))),
    "names": each(TEXT),
    "correlation": each(each(NUMBER)),
    "ess": NUMBER,
    "draws": WHOLE,
    "health": HEALTH,
    "rests_on": RESTS_ON,
}
BAND: Json = each({"anyOf": [NUMBER, each(NUMBER)]})
PREDICTION = having(
    rotor=TEXT,
    blade=TEXT,
    quantity=TEXT,
    unit=TEXT,
    node=maybe(WHOLE),
    probability=NUMBER,
    instrument=maybe(TEXT),
    noise_from={"enum": ["readings", "prior"]},
    time_h=each(NUMBER),
    mean=BAND,
    sd=named(BAND),
    lower=BAND,
    upper=BAND,
    quantiles=named(BAND),
    health=HEALTH,
    rests_on=RESTS_ON,
)
READING_MAY_LACK = (
    *("nodes", "unit", "sigma", "instrument", "campaign", "observed_at", "replaces", "count"),
)
INSPECTION = having(
    READING_MAY_LACK,
    id=TEXT,
    blade=TEXT,
    quantity=TEXT,
    time_h=NUMBER,
    values=maybe(each({})),
    nodes=maybe(each(WHOLE)),
    unit=maybe(TEXT),
    sigma=maybe(NUMBER),
    instrument=maybe(TEXT),
    campaign=maybe(TEXT),
    observed_at=maybe(TEXT),
    replaces=maybe(TEXT),
    count=WHOLE,
    seq=WHOLE,
    status={"enum": ["counts", "replaced", "retracted"]},
    received_at=TEXT,
    posted_by=maybe(TEXT),
)
ACCEPTED = having(
    items=each(having(id=TEXT, seq=WHOLE, status={"enum": ["accepted"]})), head_seq=WHOLE
)
JOB = having(
    id=TEXT,
    kind=TEXT,
    status=TEXT,
    request=ANY,
    result=maybe(ANY),
    error=maybe(TEXT),
    attempts=WHOLE,
    created_at=TEXT,
    finished_at=maybe(TEXT),
)
TWICE = having(mean=NUMBER, sd=NUMBER, z=NUMBER)
COURSE = having(
    mean=each(each(NUMBER)),
    sd=each(each(NUMBER)),
    low=each(each(NUMBER)),
    median=each(each(NUMBER)),
    high=each(each(NUMBER)),
)
PLACED = having(mean=NUMBER, sd=NUMBER, spread=NUMBER, of=WHOLE, at_low=WHOLE, at_high=WHOLE)
PICTURES = having(
    schema=WHOLE,
    readings=each(
        having(
            id=TEXT,
            blade=TEXT,
            quantity=TEXT,
            unit=TEXT,
            time_h=NUMBER,
            rotor_h=NUMBER,
            instrument=maybe(TEXT),
            campaign=maybe(TEXT),
            value=NUMBER,
            before=TWICE,
            after=TWICE,
        )
    ),
    readings_not_shown=WHOLE,
    courses=maybe(
        having(
            quantity=TEXT,
            unit=TEXT,
            time_h=each(NUMBER),
            blades=each(TEXT),
            before=COURSE,
            after=COURSE,
        )
    ),
    amplitudes=each(
        having(
            name=TEXT,
            unit=TEXT,
            prior=having(low=NUMBER, high=NUMBER, mean=NUMBER, sd=NUMBER),
            quantiles=each(NUMBER),
            at_bound=maybe(TEXT),
            x=each(NUMBER),
            prior_density=each(NUMBER),
            density=each(NUMBER),
        )
    ),
    parameters=each(
        having(
            name=TEXT,
            level={"enum": ["shared", "local"]},
            unit=TEXT,
            low=NUMBER,
            high=NUMBER,
            effect=YES,
            before=maybe(PLACED),
            after=maybe(PLACED),
        )
    ),
)
READABLE = {
    "blade": TEXT,
    "quantity": TEXT,
    "time_h": NUMBER,
    "ahead_h": NUMBER,
    "instrument": maybe(TEXT),
    "sigma": maybe(NUMBER),
}
PLANNED = having(**READABLE, sd_after=NUMBER, narrower=NUMBER)
CANDIDATE = READABLE | {"gain_nat": NUMBER, "share": NUMBER, "settled": NUMBER}
SEPARATING = having(
    rivals=each(having(names=each(TEXT), weight=NUMBER)),
    entropy_nat=NUMBER,
    single=each(
        having(
            **CANDIDATE,
            unit=TEXT,
            blades_alike=WHOLE,
            expected=each(having(mean=NUMBER, sd=NUMBER)),
        )
    ),
    set=each(having(**CANDIDATE)),
)
VERDICT: Json = {"enum": ["adequate", "effect", "not separable", "unattributed"]}
ADOPTION = having(
    rotor=TEXT,
    diagnosis=TEXT,
    what={"enum": ["adoption", "back-out"]},
    seq=WHOLE,
    effects=each(ANY),
    models=having(before=TEXT, after=TEXT),
    networks=having(before=maybe(ANY), after=maybe(ANY)),
    readings_since=maybe(WHOLE),
    unasked=YES,
    posted_by=maybe(TEXT),
    at=TEXT,
)
FOUND = having(
    ("adds", "conditions", "not_adopted", "pictures", "separating"),
    verdict=VERDICT,
    names=each(TEXT),
    reasons=each(TEXT),
    p=maybe(NUMBER),
    p_after=maybe(NUMBER),
    effects=each(ANY),
    claimed=YES,
    gained_nat=maybe(NUMBER),
    evidence=named(maybe(NUMBER)),
    calibrated=each(having(names=each(TEXT), gained_nat=maybe(NUMBER))),
    no_room=each(having(names=each(TEXT), why=TEXT)),
    tried=each(having(what=TEXT, log_bf=maybe(NUMBER))),
    holds=each(ANY),
    parameters=having(before=ANY, after=ANY),
    readings=having(delivered=WHOLE, used=WHOLE),
    models=having(before=TEXT, after=TEXT),
    before_after=maybe(ANY),
    adds=maybe(having(parameters=each(ANY), drifts=each(ANY), biases=each(ANY))),
    conditions=each(
        having(
            input=TEXT,
            value=NUMBER,
            holds=YES,
            blades=each(TEXT),
            before=ANY,
            after=ANY,
        )
    ),
    not_adopted=TEXT,
    pictures=maybe(PICTURES),
    separating=maybe(SEPARATING),
    rests_on=having(
        rotor=TEXT,
        through_seq=WHOLE,
        events_digest=TEXT,
        model=TEXT,
        model_version=TEXT,
        model_digest=TEXT,
        particles=WHOLE,
        seed=WHOLE,
    ),
)
DIAGNOSIS_LISTED = {
    "id": TEXT,
    "rotor": TEXT,
    "status": {"enum": ["queued", "running", "done", "failed", "cancelled"]},
    "request": having(families=each(ANY), compare=YES, horizon_h=NUMBER, through_seq=WHOLE),
    "progress": maybe(having(what=TEXT, done=WHOLE, total=WHOLE, seconds_left=maybe(NUMBER))),
    "error": maybe(TEXT),
    "attempts": WHOLE,
    "created_at": TEXT,
    "finished_at": maybe(TEXT),
}
DIAGNOSIS = having(**DIAGNOSIS_LISTED, result=maybe(FOUND), adoption=maybe(ADOPTION))
RESIDUAL = having(
    inspection=TEXT,
    blade=TEXT,
    quantity=TEXT,
    campaign=maybe(TEXT),
    instrument=maybe(TEXT),
    time_h=NUMBER,
    rotor_h=NUMBER,
    visit=WHOLE,
    part=WHOLE,
    y=NUMBER,
    mean=NUMBER,
    sd=NUMBER,
    z=NUMBER,
    pit=NUMBER,
)
TEST = having(
    grouping=TEXT,
    value=maybe(TEXT),
    statistic={"enum": ["mean", "variance", "autocorrelation"]},
    count=WHOLE,
    score=NUMBER,
    p=NUMBER,
    p_family=NUMBER,
    alarm=YES,
)
VISIT = having(
    visit=WHOLE, readings=WHOLE, from_h=NUMBER, to_h=NUMBER, health=maybe(TEXT), reasons=each(TEXT)
)
RESIDUALS = having(
    items=each(RESIDUAL),
    next=maybe(TEXT),
    rotor=TEXT,
    as_of=maybe(
        having(
            version=WHOLE,
            through_seq=WHOLE,
            events_digest=TEXT,
            model_digest=TEXT,
            particles=WHOLE,
            computed_at=TEXT,
        )
    ),
    pending=YES,
    error=maybe(TEXT),
    visits=each(VISIT),
    tests=each(TEST),
    alarms=WHOLE,
    family_wise_error=NUMBER,
    draws=WHOLE,
    freedom=maybe(NUMBER),
)
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
    deliveries=having(pending=WHOLE, delivered=WHOLE, dead=WHOLE),
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
    prediction=having(mean=AT_ONE_HOUR, sd=named(AT_ONE_HOUR)),
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
    health=HEALTH,
    rests_on=RESTS_ON,
)
SURFACE = having(
    model=TEXT, version=TEXT, unit=TEXT, points=each(each(NUMBER)), triangles=each(each(WHOLE))
)
GAUGES = {
    **dict.fromkeys(("rotors", "backlog", "applied", "versions", "seals", "takeovers"), WHOLE),
    **dict.fromkeys(("dirty", "blocked", "provisional", "jobs"), WHOLE),
    **dict.fromkeys(("deliveries_pending", "deliveries_dead", "alarms"), WHOLE),
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
ROTOR = "/v1/rotors/{r}"
ANSWERS: dict[str, Json] = {
    "GET /healthz": having(status=TEXT),
    "GET /readyz": having(
        ("schema", "database", "remedy"), ready=YES, database=TEXT, schema=maybe(TEXT), remedy=TEXT
    ),
    "GET /v1/models": paged(having(id=TEXT, version=TEXT, digest=TEXT, state=TEXT)),
    "GET /v1/models/{m}": MODEL,
    "POST /v1/models": having(job=JOB),
    "GET /v1/jobs/{id}": JOB,
    "GET /v1/rotors": paged(having(**STANDING)),
    "POST /v1/rotors": having(**MADE, blades=each(BLADE)),
    f"GET {ROTOR}": having(
        **STANDING,
        blades=each(BLADE),
        posterior=maybe(POSTERIOR_OF_ROTOR),
        health=maybe(HEALTH),
        effects=each(ANY),
    ),
    f"POST {ROTOR}/retry": having(**STANDING),
    f"POST {ROTOR}/blades": ACCEPTED,
    f"POST {ROTOR}/blades/{{b}}/retirement": ACCEPTED,
    f"GET {ROTOR}/inspections": paged(INSPECTION),
    f"POST {ROTOR}/inspections": ACCEPTED,
    f"GET {ROTOR}/inspections/{{i}}": INSPECTION,
    f"POST {ROTOR}/inspections/{{i}}/retraction": ACCEPTED,
    f"GET {ROTOR}/posterior": having(**SUMMARY),
    f"GET {ROTOR}/blades/{{b}}/posterior": having(**SUMMARY, blade=TEXT),
    f"GET {ROTOR}/blades/{{b}}/prediction": PREDICTION,
    f"GET {ROTOR}/plan": having(
        rotor=TEXT,
        target=having(
            blade=maybe(TEXT),
            quantity=maybe(TEXT),
            time_h=maybe(NUMBER),
            parameter=maybe(TEXT),
            unit=TEXT,
            mean=NUMBER,
            sd=NUMBER,
        ),
        single=each(PLANNED),
        set=each(PLANNED),
        health=HEALTH,
        rests_on=RESTS_ON,
    ),
    f"POST {ROTOR}/diagnoses": having(diagnosis=DIAGNOSIS),
    f"GET {ROTOR}/diagnoses": paged(
        having(**DIAGNOSIS_LISTED, verdict={"type": ["string", "null"]}, names=maybe(each(TEXT)))
    ),
    f"GET {ROTOR}/diagnoses/{{d}}": DIAGNOSIS,
    f"DELETE {ROTOR}/diagnoses/{{d}}": DIAGNOSIS,
    f"POST {ROTOR}/diagnoses/{{d}}/adoption": having(adoption=ADOPTION, head_seq=WHOLE),
    f"DELETE {ROTOR}/diagnoses/{{d}}/adoption": having(adoption=ADOPTION, head_seq=WHOLE),
    f"GET {ROTOR}/adoptions": paged(ADOPTION),
    "GET /v1/webhooks": paged(WEBHOOK),
    "POST /v1/webhooks": having(webhook=WEBHOOK, secret=maybe(TEXT)),
    "GET /v1/webhooks/{w}": WEBHOOK,
    "DELETE /v1/webhooks/{w}": having(id=TEXT, deleted=YES),
    "GET /v1/webhooks/{w}/deliveries": paged(DELIVERY),
    "POST /v1/webhooks/{w}/deliveries/{d}/retry": DELIVERY,
    f"GET {ROTOR}/residuals": RESIDUALS,
    "GET /v1/audit": paged(AUDIT),
    "GET /v1/models/{m}/surface": SURFACE,
    f"GET {ROTOR}/blades": BLADES,
    f"GET {ROTOR}/draws": ROTOR_DRAWS,
    f"GET {ROTOR}/blades/{{b}}/draws": DRAWS,
    f"GET {ROTOR}/blades/{{b}}/field": FIELD,
    f"GET {ROTOR}/versions": paged(having(**POSTERIOR_OF_ROTOR["properties"], health=HEALTH)),
    "GET /v1/operations": OPERATIONS,
}
