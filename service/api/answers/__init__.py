"""What answers hold, as JSON schema for the OpenAPI document.

Every field is named and no other comes, so that a test that reads answers against the document sees
a field that is lost, renamed or added without a word.
"""

from __future__ import annotations

from service.api.answers.beliefs import (
    ACCEPTED,
    BLADE,
    HEALTH,
    INSPECTION,
    JOB,
    LIFE,
    MADE,
    POSTERIOR_OF_ROTOR,
    PREDICTION,
    RESTS_ON,
    ROTOR_LIFE,
    SERIES,
    STANDING,
    SUMMARY,
)
from service.api.answers.diagnoses import ADOPTION, DIAGNOSIS, DIAGNOSIS_LISTED
from service.api.answers.others import (
    AUDIT,
    BLADES,
    DELIVERY,
    DRAWS,
    FIELD,
    MODEL,
    OPERATIONS,
    ROTOR_DRAWS,
    SURFACE,
    WEBHOOK,
)
from service.api.answers.residuals import RESIDUALS
from service.api.answers.shown import PLANNED
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
    paged,
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
    "GET /v1/rotors": paged(having(**STANDING, sealed=maybe(YES), health=maybe(HEALTH))),
    "POST /v1/rotors": having(**MADE, blades=each(BLADE)),
    f"GET {ROTOR}": having(
        **STANDING,
        blades=each(BLADE),
        posterior=maybe(POSTERIOR_OF_ROTOR),
        health=maybe(HEALTH),
        effects=each(ANY),
    ),
    f"POST {ROTOR}/retry": having(**STANDING),
    f"POST {ROTOR}/policy": having(**STANDING),
    f"POST {ROTOR}/blades": ACCEPTED,
    f"POST {ROTOR}/blades/{{b}}/retirement": ACCEPTED,
    f"GET {ROTOR}/inspections": paged(INSPECTION),
    f"POST {ROTOR}/inspections": ACCEPTED,
    f"GET {ROTOR}/inspections/{{i}}": INSPECTION,
    f"POST {ROTOR}/inspections/{{i}}/retraction": ACCEPTED,
    f"GET {ROTOR}/posterior": having(**SUMMARY),
    f"GET {ROTOR}/blades/{{b}}/posterior": having(**SUMMARY, blade=TEXT),
    f"GET {ROTOR}/blades/{{b}}/prediction": PREDICTION,
    f"GET {ROTOR}/blades/{{b}}/life": LIFE,
    f"GET {ROTOR}/life": ROTOR_LIFE,
    f"GET {ROTOR}/series": SERIES,
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
        having(
            **DIAGNOSIS_LISTED,
            verdict={"type": ["string", "null"]},
            names=maybe(each(TEXT)),
            not_adopted=maybe(TEXT),
        )
    ),
    f"GET {ROTOR}/diagnoses/{{d}}": DIAGNOSIS,
    f"DELETE {ROTOR}/diagnoses/{{d}}": DIAGNOSIS,
    f"POST {ROTOR}/diagnoses/{{d}}/adoption": having(
        adoption=ADOPTION, joined=each(TEXT), head_seq=WHOLE
    ),
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
