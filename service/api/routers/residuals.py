"""Every reading against its prediction from before it was used, and tests of them by grouping."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query

from service.api.services import Limit, Name, Number, Wired, moment, page_size
from service.handlers.residuals import read_residuals

router = APIRouter(prefix="/v1/rotors/{r}", tags=["reads"])
Wanted = Annotated[str | None, Query(min_length=1, max_length=200)]
NOTHING: dict[str, Any] = {
    "visits": [],
    "tests": [],
    "alarms": 0,
    "family_wise_error": 0.05,
    "draws": 0,
    "freedom": None,
}


@router.get("/residuals", summary="Readings predicted before they were used: z, PIT, and tests")
def get_residuals(
    r: Name,
    services: Wired,
    blade: Wanted = None,
    quantity: Wanted = None,
    campaign: Wanted = None,
    limit: Limit = None,
    cursor: Number = None,
) -> dict[str, Any]:
    size = page_size(services, limit)
    wanted = {"blade": blade, "quantity": quantity, "campaign": campaign}
    found = read_residuals(services.store, r, cursor or 0, size + 1, wanted)
    record, shown = found.record, found.items[:size]
    more = str(shown[-1]["number"]) if len(found.items) > size else None
    body = record.body or {}
    as_of = body.get("rests_on")
    return {
        "items": [{k: v for k, v in row.items() if k != "number"} for row in shown],
        "next": more,
        "rotor": r,
        "as_of": as_of and as_of | {"computed_at": moment(record.computed_at)},
        "pending": found.pending,
        "error": record.error,
        **{name: body.get(name, nothing) for name, nothing in NOTHING.items()},
    }
