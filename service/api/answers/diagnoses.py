"""Diagnoses, their pictures, and adoptions."""

from __future__ import annotations

from service.api.answers.residuals import REQUEST
from service.api.answers.words import (
    ANY,
    NUMBER,
    TEXT,
    WHOLE,
    YES,
    Json,
    each,
    having,
    maybe,
    named,
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
            ("now_h",),  # older reports have none
            quantity=TEXT,
            unit=TEXT,
            time_h=each(NUMBER),
            blades=each(TEXT),
            now_h=each(NUMBER),
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
TELLS = {"gain_nat": NUMBER, "share": NUMBER, "settled": NUMBER}
CANDIDATE = READABLE | TELLS
SEPARATING = having(
    ("campaigns",),  # older reports have none
    rivals=each(having(("called",), names=each(TEXT), called=each(TEXT), weight=NUMBER)),
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
    campaigns=each(
        having(
            quantity=TEXT,
            ahead_h=NUMBER,
            blades=WHOLE,
            instrument=maybe(TEXT),
            sigma=maybe(NUMBER),
            nodes=maybe(WHOLE),
            **TELLS,
        )
    ),
)
FORESEEN = {"mean": NUMBER, "sd": NUMBER}
ALTERNATIVES = having(
    quantity=TEXT,
    time_h=NUMBER,
    blades=each(TEXT),
    before=having(**FORESEEN),
    together=having(**FORESEEN),
    each=each(
        having(
            effects=each(having(name=TEXT, shape=TEXT, step_h=maybe(NUMBER))),
            share=NUMBER,
            **FORESEEN,
        )
    ),
)
VERDICT: Json = {"enum": ["adequate", "effect", "not separable", "unattributed"]}
ADOPTION = having(
    rotor=TEXT,
    diagnosis=TEXT,
    what={"enum": ["adoption", "back-out", "joining"]},
    seq=WHOLE,
    blade=maybe(TEXT),
    effects=each(ANY),
    models=maybe(having(before=TEXT, after=TEXT)),
    networks=having(before=maybe(ANY), after=maybe(ANY)),
    readings_since=maybe(WHOLE),
    unasked=YES,
    posted_by=maybe(TEXT),
    at=TEXT,
)
FOUND = having(
    (
        "adds",
        "alternatives",
        "beside",
        "concerns",
        "conditions",
        "not_adopted",
        "noticed",
        "pictures",
        "separating",
        "several",
        "widened",
    ),
    verdict=VERDICT,
    names=each(TEXT),
    beside=each(TEXT),
    several=each(TEXT),
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
    concerns=each(
        having(
            effect=TEXT,
            blades=WHOLE,
            all=NUMBER,
            share=NUMBER,
            some_nat=NUMBER,
            those=each(TEXT),
            stands=YES,
        )
    ),
    parameters=having(before=ANY, after=ANY),
    readings=having(delivered=WHOLE, used=WHOLE),
    models=having(before=TEXT, after=TEXT),
    before_after=maybe(ANY),
    adds=maybe(
        having(
            ("parameters", "drifts", "biases", "quantities"),
            parameters=each(ANY),
            drifts=each(ANY),
            biases=each(ANY),
            quantities=named(ANY),
        )
    ),
    widened=maybe(
        having(
            quantity=TEXT,
            discrepancy=ANY,
            gained_nat=NUMBER,
            borne_out=YES,
            time_h=NUMBER,
            share=NUMBER,
            sd=having(before=NUMBER, after=NUMBER),
        )
    ),
    noticed=maybe(
        having(
            probability=NUMBER,
            alarm=NUMBER,
            families=each(
                having(
                    family=TEXT,
                    whom=TEXT,
                    kind=TEXT,
                    on=TEXT,
                    target=TEXT,
                    how=TEXT,
                    of=TEXT,
                    unit=TEXT,
                    least=maybe(NUMBER),
                    easiest=TEXT,
                    most=maybe(NUMBER),
                    hardest=TEXT,
                )
            ),
        )
    ),
    conditions=each(
        having(
            ("fault",),
            fault=maybe(TEXT),
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
    alternatives=maybe(ALTERNATIVES),
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
    "request": REQUEST,
    "progress": maybe(having(what=TEXT, done=WHOLE, total=WHOLE, seconds_left=maybe(NUMBER))),
    "error": maybe(TEXT),
    "attempts": WHOLE,
    "created_at": TEXT,
    "finished_at": maybe(TEXT),
}
DIAGNOSIS = having(**DIAGNOSIS_LISTED, result=maybe(FOUND), adoption=maybe(ADOPTION))
