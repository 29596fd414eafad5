"""Residuals: every reading beside its prediction, the visits, and tests of all of them.

z = (y − mean) / sd, and `pit` is the predicted probability of a reading below y. A test's p is its
own, `p_family` that among all of them (`core.diagnosis.omnibus`). Those that alarm may ask for a
diagnosis: `because` of its request.
"""

from __future__ import annotations

from service.api.answers.words import (
    ANY,
    NUMBER,
    TEXT,
    WHOLE,
    YES,
    each,
    having,
    maybe,
)

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
ASKS = {
    "grouping": TEXT,
    "value": maybe(TEXT),
    "statistic": {"enum": ["mean", "variance", "autocorrelation"]},
}
BECAUSE = having(version=WHOLE, readings=WHOLE, alarms=WHOLE, tests=each(having(**ASKS)))
REQUEST = having(
    ("because",), families=each(ANY), compare=YES, horizon_h=NUMBER, through_seq=WHOLE,
    because=BECAUSE,
)  # fmt: skip
TEST = having(
    **ASKS,
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
