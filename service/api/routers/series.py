"""Bands over hours as flat rows."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request
from fastapi.responses import Response

from service.api.routers.reads import LONGEST_TIMES, read_times
from service.api.services import Cursor, Name, Wired, tag_of, tagged, unchanged
from service.api.which import Asked
from service.handlers import rows as use
from service.handlers.life import along_question
from service.handlers.reads import basis, health
from service.names import ID_PATTERN

router = APIRouter(prefix="/v1", tags=["reads"])
BLADES = 10


@router.get(
    "/rotors/{r}/series", summary="Predictions as flat rows: blade, time, value, lower, upper"
)
def get_series(
    r: Name,
    request: Request,
    services: Wired,
    which: Asked,
    blade: Annotated[
        str | None,
        Query(max_length=100, pattern=ID_PATTERN, description="default: those that run, by pages"),
    ] = None,
    quantity: Annotated[
        str | None, Query(max_length=100, description="default: the model's first one")
    ] = None,
    times: Annotated[
        str | None,
        Query(
            max_length=LONGEST_TIMES,
            description="hours, with commas between; default: the model's",
        ),
    ] = None,
    node: Annotated[str | None, Query(max_length=100)] = None,
    component: Annotated[
        Literal["x", "y", "z"] | None, Query(description="of a vector; default: z, the radius")
    ] = None,
    probability: Annotated[float, Query(description="of a reading between lower and upper")] = 0.95,
    limit: Annotated[int, Query(ge=1, le=100, description="blades of a page")] = BLADES,
    cursor: Cursor = None,
) -> Response:
    found = basis(services.store, services.science, r, which, blade)
    hours = read_times(times)
    asked, part = along_question(found.card, quantity, hours, node, component, probability)
    if found.blade is None:
        shown = use.running(services.store, found, cursor or "", limit + 1)
    else:
        shown = [found.blade] if found.blade.id > (cursor or "") else []
    shown, more = shown[:limit], len(shown) > limit
    use.check_rows(asked, len(shown))
    names = [one.id for one in shown]
    tag = tag_of(request, found.state.version, found.state.digest, found.card.digest, names)
    if (same := unchanged(request, tag)) is not None:
        return same
    items = use.rows(services.store, services.science, found, asked, part, shown)
    body = {
        "items": items,
        "next": names[-1] if more else None,
        "rotor": r,
        "quantity": asked.quantity,
        "unit": found.card.outputs[asked.quantity].unit,
        "node": asked.node,
        "component": component or ("z" if part is not None else None),
        "probability": asked.probability,
        "health": health(found.state),
        "rests_on": found.to_json(),
    }
    return tagged(body, tag)
