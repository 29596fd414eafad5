"""Effects that a diagnosis named: into the rotor's model, out of it, and what was done so far."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter
from fastapi.responses import JSONResponse
from pydantic import ConfigDict, Field

from service.api.schemas import Body, Text
from service.api.services import Limit, Name, Number, Wired, moment, page, page_size
from service.handlers import adoptions as use
from service.handlers.choice import Choice

router = APIRouter(prefix="/v1/rotors/{r}", tags=["diagnoses"])


class AdoptionIn(Body):
    """One of the diagnosis' alternatives in place of what it claims, and from where it is known."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"alternative": 2, "because": "borescope of outage 4"}]}
    )

    alternative: Annotated[int, Field(ge=1)] | None = None
    because: Text | None = None


def adoption_out(rotor: str, change: use.Change) -> dict[str, Any]:
    body, event = change.body, change.event
    return {
        "rotor": rotor,
        "diagnosis": body["diagnosis"],
        "what": event.kind,
        "seq": event.seq,
        "blade": body.get("blade"),
        "effects": body["effects"],
        "models": body.get("models"),
        "networks": {"before": body["before"], "after": body["after"]},
        "readings_since": body.get("readings_since"),
        "unasked": body.get("unasked", False),
        "chosen": body.get("chosen"),
        "posted_by": event.posted_by,
        "at": moment(event.received_at),
    }


def _answer(rotor: str, change: use.Change, **more: Any) -> JSONResponse:
    told = {"adoption": adoption_out(rotor, change), **more, "head_seq": change.head_seq}
    return JSONResponse(told, 202, {} if change.new else {"Idempotent-Replayed": "true"})


@router.post(
    "/diagnoses/{d}/adoption",
    status_code=202,
    summary="The effect that a diagnosis named enters the rotor's model, as a new version",
)
def post_adoption(
    r: Name, d: Name, services: Wired, body: AdoptionIn | None = None
) -> JSONResponse:
    choice = Choice.of(body.alternative, body.because) if body else None
    change = use.adopt(services.store, services.science, r, d, choice)
    return _answer(r, change, joined=change.blades)


@router.delete(
    "/diagnoses/{d}/adoption",
    status_code=202,
    summary="Back out: the network before the adoption comes back",
)
def delete_adoption(r: Name, d: Name, services: Wired) -> JSONResponse:
    return _answer(r, use.back_out(services.store, services.science, r, d))


@router.get(
    "/adoptions",
    summary="What was adopted and backed out, and which blades joined effects since, in order",
)
def get_adoptions(
    r: Name, services: Wired, limit: Limit = None, cursor: Number = None
) -> dict[str, Any]:
    size = page_size(services, limit)
    found = use.history(services.store, r, cursor or 0, size + 1)
    return page([adoption_out(r, change) for change in found], size, "seq")
