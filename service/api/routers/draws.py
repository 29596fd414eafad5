"""Equally weighted draws: of one blade's parameters, or of all blades' jointly."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request
from fastapi.responses import Response

from service.api.files import NETCDF, file
from service.api.problems import fault, invalid
from service.api.services import Name, Wired, tag_of_basis, tagged, unchanged
from service.api.which import Asked
from service.handlers import exports
from service.handlers import glance as use
from service.handlers.reads import basis

router = APIRouter(prefix="/v1", tags=["glance"])
ROTOR, BLADE = "/rotors/{r}", "/rotors/{r}/blades/{b}"
Count = Annotated[int, Query(ge=1, le=use.MOST_DRAWS)]
Groups = Annotated[
    str | None,
    Query(
        description="of a netCDF file, with commas between: prior, posterior_predictive (both), "
        "particles (weighted, where asked for)"
    ),
]


def _groups(groups: str | None, form: str) -> tuple[str, ...]:
    """The groups of a file of draws that are asked for, `posterior` among them or not."""
    if groups is None:
        return exports.GROUPS
    if form != "netcdf":
        raise invalid([fault("groups", groups, f"is not for format={form}", "take format=netcdf")])
    named = tuple(name.strip() for name in groups.split(",") if name.strip())
    known = ("posterior", *exports.GROUPS, *exports.ASKED)
    faults = [
        fault("groups", name, "is no group of the file", f"use {', '.join(known)}")
        for name in named
        if name not in known
    ]
    if faults:
        raise invalid(faults)
    return named


@router.get(BLADE + "/draws", summary="Equally weighted draws of a blade's parameters")
def get_draws(
    r: Name,
    b: Name,
    request: Request,
    services: Wired,
    which: Asked,
    count: Count = 1000,
    format: Annotated[
        Literal["json", "netcdf"], Query(description="netcdf: in ArviZ's schema")
    ] = "json",
    groups: Groups = None,
) -> Response:
    wanted = _groups(groups, format)
    found = basis(services.store, services.science, r, which, b)
    tag = tag_of_basis(request, found)
    if (same := unchanged(request, tag)) is not None:
        return same
    drawn = use.draws(services.store, services.science, found, count)
    if format == "netcdf":
        assert found.blade is not None
        joint = exports.of_one_blade(drawn, found, services.science, services.store)
        body = exports.draws_netcdf(
            services.store, services.science, joint, [found.blade], found, wanted
        )
        return file(body, NETCDF, (r, b, "draws", f"v{found.state.version}"), "nc", tag, found)
    told = {"rotor": r, "blade": b} | drawn
    return tagged(told | {"rests_on": found.to_json()}, tag)


@router.get(ROTOR + "/draws", summary="Joint, equally weighted draws of all blades' parameters")
def get_rotor_draws(
    r: Name,
    request: Request,
    services: Wired,
    which: Asked,
    count: Count = 1000,
    format: Annotated[
        Literal["json", "netcdf"], Query(description="netcdf: in ArviZ's schema")
    ] = "json",
    groups: Groups = None,
) -> Response:
    wanted = _groups(groups, format)
    found = basis(services.store, services.science, r, which)
    tag = tag_of_basis(request, found)
    if (same := unchanged(request, tag)) is not None:
        return same
    drawn, blades = exports.rotor_draws(services.store, services.science, found, count, format)
    if format == "netcdf":
        body = exports.draws_netcdf(services.store, services.science, drawn, blades, found, wanted)
        return file(body, NETCDF, (r, "draws", f"v{found.state.version}"), "nc", tag, found)
    told = {"rotor": r} | exports.told(drawn, found)
    return tagged(told | {"rests_on": found.to_json()}, tag)
