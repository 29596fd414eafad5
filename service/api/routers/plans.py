"""Which inspection next, and what it would tell."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import Response

from service.api.services import Name, Wired, tag_of_basis, tagged, unchanged
from service.api.which import Asked
from service.handlers import plans as use
from service.handlers.reads import basis
from service.names import ID_PATTERN

router = APIRouter(prefix="/v1/rotors/{r}/plan", tags=["reads"])


@router.get("", summary="Inspections, by how much they would narrow a prediction or parameter")
def get_plan(
    r: Name,
    request: Request,
    services: Wired,
    which: Asked,
    blade: Annotated[
        str | None, Query(max_length=100, pattern=ID_PATTERN, description="whose prediction")
    ] = None,
    quantity: Annotated[
        str | None, Query(max_length=100, description="default: the model's first one")
    ] = None,
    time_h: Annotated[
        float | None, Query(description="hour of the prediction; default: the model's last")
    ] = None,
    parameter: Annotated[
        str | None, Query(max_length=100, description="instead of a prediction")
    ] = None,
    count: Annotated[int, Query(ge=1, le=5, description="readings of the set")] = 3,
) -> Response:
    found = basis(services.store, services.science, r, which, blade)
    target = use.target_of(found, quantity, time_h, parameter)
    tag = tag_of_basis(request, found)
    if (same := unchanged(request, tag)) is not None:
        return same
    body = {"rotor": r} | use.plan(services.store, services.science, found, target, count)
    return tagged(body | {"rests_on": found.to_json()}, tag)
