"""Posteriors, predictions, rotors and readings."""

from __future__ import annotations

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

WHICH = {"blades": each(TEXT), "campaign": maybe(TEXT), "time_h": each(NUMBER)}
HEALTH = having(
    ("exchanged", "few_draws", "noisier"),
    status={"enum": ["ok", "degenerate", "contradicted", "unknown"]},
    reasons=each(TEXT),
    met_floor=maybe(YES),
    contradicted=each(
        having(
            ("bounded", "suspects"),
            blade=TEXT,
            misfit_nat=NUMBER,
            own_nat=NUMBER,
            rows=WHOLE,
            bounded=YES,
            suspects=each(having(reading=TEXT, time_h=NUMBER, misfit_nat=NUMBER)),
        )
    ),
    exchanged=each(
        having(
            **WHICH,
            readings=each(each(TEXT)),
            gained_nat=NUMBER,
            probability=NUMBER,
            rivals=each(having(**WHICH)),
        )
    ),
    few_draws=each(having(blade=TEXT, share=NUMBER)),
    noisier=each(having(quantities=each(TEXT), stated=YES, times=NUMBER, visits=WHOLE)),
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
    "diagnose": {"enum": ["never", "alarm", "readings"]},
    "created_at": TEXT,
}
STANDING = MADE | {
    "policy_since": maybe(TEXT),
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
    untold=each(TEXT),
)
SUMMARY = {
    "rotor": TEXT,
    "parameters": named(
        having(mean=NUMBER, sd=NUMBER, r_hat=maybe(NUMBER), quantiles=named(NUMBER))
    ),
    "names": each(TEXT),
    "correlation": each(each(NUMBER)),
    "ess": NUMBER,
    "r_hat": maybe(NUMBER),
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
    held_from_h=maybe(NUMBER),
    health=HEALTH,
    rests_on=RESTS_ON,
)
LIFE = having(
    rotor=TEXT,
    blade=TEXT,
    quantity=TEXT,
    unit=TEXT,
    node=maybe(WHOLE),
    component={"enum": ["x", "y", "z", None]},
    limit=NUMBER,
    time_h=each(NUMBER),
    passed=each(NUMBER),
    quantiles=named(maybe(NUMBER)),
    held_from_h=maybe(NUMBER),
    health=HEALTH,
    rests_on=RESTS_ON,
)
ROTOR_LIFE = having(
    rotor=TEXT,
    quantity=TEXT,
    unit=TEXT,
    node=maybe(WHOLE),
    component={"enum": ["x", "y", "z", None]},
    limit=NUMBER,
    ahead=YES,
    time_h=each(NUMBER),
    any=each(NUMBER),
    expected=each(NUMBER),
    blades=each(
        having(
            id=TEXT,
            age_h=maybe(NUMBER),
            age_by={"enum": ["campaign", "reading", "rotor", None]},
            passed=each(NUMBER),
            held_from_h=maybe(NUMBER),
        )
    ),
    health=HEALTH,
    rests_on=RESTS_ON,
)
SERIES = having(
    items=each(having(blade=TEXT, time=NUMBER, value=NUMBER, lower=NUMBER, upper=NUMBER, held=YES)),
    next=maybe(TEXT),
    rotor=TEXT,
    quantity=TEXT,
    unit=TEXT,
    node=maybe(WHOLE),
    component={"enum": ["x", "y", "z", None]},
    probability=NUMBER,
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
    progress=maybe(having(what=TEXT, done=WHOLE, total=WHOLE, seconds_left=maybe(NUMBER))),
    attempts=WHOLE,
    created_at=TEXT,
    finished_at=maybe(TEXT),
)
