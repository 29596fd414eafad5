"""Diagnoses and adoptions."""

from __future__ import annotations

from service.api.answers.residuals import REQUEST
from service.api.answers.shown import ADDS, ALTERNATIVES, COURSE, NOTICED, PICTURES, SEPARATING
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
    chosen=maybe(having(alternative=WHOLE, because=TEXT)),
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
        "dealt",
        "not_adopted",
        "noticed",
        "pictures",
        "placebos",
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
    dealt=WHOLE,
    p_after=maybe(NUMBER),
    effects=each(ANY),
    claimed=YES,
    gained_nat=maybe(NUMBER),
    evidence=named(maybe(NUMBER)),
    calibrated=each(
        having(("effects",), names=each(TEXT), effects=each(COURSE), gained_nat=maybe(NUMBER))
    ),
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
    placebos=each(
        having(
            effect=TEXT,
            by=TEXT,
            count=WHOLE,
            won=WHOLE,
            gained_nat=NUMBER,
            best_nat=NUMBER,
            stands=YES,
        )
    ),
    parameters=having(before=ANY, after=ANY),
    readings=having(delivered=WHOLE, used=WHOLE),
    models=having(before=TEXT, after=TEXT),
    before_after=maybe(ANY),
    adds=maybe(ADDS),
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
    noticed=maybe(NOTICED),
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
