"""Every reading against its prediction from before it was used, and tests of them by grouping."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query

from service.api.problems import fault, invalid
from service.api.services import Limit, Name, Wired, moment, page_size
from service.handlers.residuals import Place, place_of, read_residuals

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
    cursor: Annotated[str | None, Query(max_length=160)] = None,
) -> dict[str, Any]:
    size = page_size(services, limit)
    wanted = {"blade": blade, "quantity": quantity, "campaign": campaign}
    found = read_residuals(services.store, r, _place(cursor), size + 1, wanted)
    record, shown = found.record, found.items[:size]
    more = _cursor(shown[-1]) if len(found.items) > size else None
    body = record.body or {}
    as_of = body.get("rests_on")
    return {
        "items": shown,
        "next": more,
        "rotor": r,
        "as_of": as_of and as_of | {"computed_at": moment(record.computed_at)},
        "pending": found.pending,
        "error": record.error,
        **{name: body.get(name, nothing) for name, nothing in NOTHING.items()},
    }


def _cursor(row: dict[str, Any]) -> str:
    hour, name, part = place_of(row)
    return f"{hour!r}:{part}:{name}"


def _place(cursor: str | None) -> Place | None:
    if cursor is None:
        return None
    try:
        hour, part, name = cursor.split(":", 2)
        return float(hour), name, int(part)
    except ValueError:
        remedy = "use `next` of the page before"
        raise invalid([fault("cursor", cursor, "is no cursor", remedy)]) from None
