"""What pages show: blades at one hour, draws, fields on the mesh, kept versions, the service."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request
from fastapi.responses import Response
from pydantic import FiniteFloat

from service.api.files import NETCDF, NPZ, VTU, ZIP, file
from service.api.problems import fault, invalid
from service.api.rotor_answers import blade_out, rotor_out
from service.api.routers.diagnoses import diagnosis_out
from service.api.routers.reads import read_times
from service.api.services import (
    Cursor,
    Limit,
    Name,
    Wired,
    moment,
    page,
    page_size,
    seq_of,
    tag_of,
    tag_of_basis,
    tagged,
    unchanged,
)
from service.api.which import Asked
from service.handlers import exports, series
from service.handlers import glance as use
from service.handlers.reads import basis, health, question
from service.ports import StateRecord

router = APIRouter(prefix="/v1", tags=["glance"])
ROTOR, BLADE = "/rotors/{r}", "/rotors/{r}/blades/{b}"
Quantity = Annotated[str | None, Query(max_length=100, description="default: the model's first")]
Count = Annotated[int, Query(ge=1, le=use.MOST_DRAWS)]
Hour = Annotated[FiniteFloat | None, Query(description="default: the model's last hour")]
Groups = Annotated[
    str | None,
    Query(description="of a netCDF file, with commas between: prior, posterior_predictive (both)"),
]
Times = Annotated[
    str | None, Query(description="hours with commas between; default: the model's instants")
]


@router.get(ROTOR + "/blades", summary="Blades at one hour: prediction and readings of each")
def get_blades(
    r: Name,
    request: Request,
    services: Wired,
    which: Asked,
    quantity: Quantity = None,
    time_h: Hour = None,
    node: Annotated[str | None, Query(max_length=100)] = None,
    limit: Limit = None,
    cursor: Cursor = None,
) -> Response:
    size = page_size(services, limit)
    found = basis(services.store, services.science, r, which)
    hours = [found.card.horizon_h if time_h is None else time_h]
    asked = question(found.card, quantity, hours, node, 0.95)
    seen = use.glance(services.store, found, cursor or "", size + 1)
    tag = tag_of(request, found.state.version, found.state.digest, found.card.digest, seen)
    if (same := unchanged(request, tag)) is not None:
        return same
    told = use.at_one_hour(services.store, services.science, found, asked, seen.blades[:size])
    items: list[dict[str, Any]] = [
        blade_out(blade)
        | {
            "readings": use.readings_out(seen.readings.get(blade.id, use.NO_READINGS)),
            "prediction": told[i] if i < size else None,
        }
        for i, blade in enumerate(seen.blades)
    ]
    body = page(items, size, "id") | {
        "rotor": r,
        "quantity": asked.quantity,
        "unit": found.card.outputs[asked.quantity].unit,
        "node": asked.node,
        "time_h": asked.times[0],
        "head_seq": seen.head_seq,
        "health": health(found.state),
        "rests_on": found.to_json(),
    }
    return tagged(body, tag)


def _groups(groups: str | None, form: str) -> tuple[str, ...]:
    """The groups of a file of draws that are asked for, `posterior` among them or not."""
    if groups is None:
        return exports.GROUPS
    if form != "netcdf":
        raise invalid([fault("groups", groups, f"is not for format={form}", "take format=netcdf")])
    named = tuple(name.strip() for name in groups.split(",") if name.strip())
    known = ("posterior", *exports.GROUPS)
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


@router.get(BLADE + "/field", summary="A field of a blade at one hour: mean and sd at every node")
def get_field(
    r: Name,
    b: Name,
    request: Request,
    services: Wired,
    which: Asked,
    quantity: Quantity = None,
    time_h: Hour = None,
    times: Times = None,
    format: Annotated[
        Literal["json", "vtu", "pvd", "npz"],
        Query(
            description="vtu: on the mesh, for ParaView and the like; pvd: many hours as a zip of "
            "a PVD and its VTU files; npz: many hours as numpy arrays"
        ),
    ] = "json",
) -> Response:
    of_many = format in ("pvd", "npz")
    if (times if not of_many else time_h) is not None:
        name, other = ("time_h", "times") if of_many else ("times", "time_h")
        value = time_h if of_many else times
        problem = f"is not for format={format}"
        raise invalid([fault(name, value, problem, f"give `{other}`, or take another format")])
    found = basis(services.store, services.science, r, which, b)
    tag = tag_of_basis(request, found)
    if of_many:
        wanted = series.asked(found, quantity, read_times(times))
        if (same := unchanged(request, tag)) is not None:
            return same
        saved = (r, b, wanted.quantity, f"v{found.state.version}")
        if format == "npz":
            arrays = series.npz(services.store, services.science, found, wanted)
            return file(arrays, NPZ, saved, "npz", tag, found)
        mesh = series.mesh_of(services.science, found)
        parts = series.pvd(services.store, services.science, found, wanted, mesh, ring=False)
        return file(parts, ZIP, saved, "pvd.zip", tag, found)
    name, hour = use.field_question(found.card, quantity, time_h)
    if (same := unchanged(request, tag)) is not None:
        return same
    body = {"rotor": r} | use.field(services.store, services.science, found, name, hour)
    if format == "vtu":
        written = exports.field_vtu(services.store, services.science, found, body)
        named = (r, b, name, f"{hour:g}h", f"v{found.state.version}")
        return file(written, VTU, named, "vtu", tag, found)
    return tagged(body | {"rests_on": found.to_json()}, tag)


@router.get(
    ROTOR + "/field",
    summary="A field of the rotor's blades over hours, as a zip of a PVD and its VTU files",
    response_class=Response,
)
def get_rotor_field(
    r: Name,
    request: Request,
    services: Wired,
    which: Asked,
    quantity: Quantity = None,
    times: Times = None,
    blades: Annotated[
        str | None, Query(description="ids with commas between; default: all that run")
    ] = None,
    format: Annotated[Literal["pvd"], Query(description="fields are not told as JSON")] = "pvd",
) -> Response:
    found = basis(services.store, services.science, r, which)
    names = None if blades is None else [name.strip() for name in blades.split(",")]
    wanted = series.of_rotor(services.store, found, quantity, read_times(times), names)
    mesh = series.mesh_of(services.science, found)
    tag = tag_of_basis(request, found)
    if (same := unchanged(request, tag)) is not None:
        return same
    parts = series.pvd(services.store, services.science, found, wanted, mesh, ring=True)
    saved = (r, wanted.quantity, f"v{found.state.version}")
    return file(parts, ZIP, saved, "pvd.zip", tag, found)


@router.get("/models/{m}/surface", summary="The surface of a model's mesh, as triangles")
def get_surface(m: Name, services: Wired) -> dict[str, Any]:
    card, found = use.surface(services.store, services.science, m)
    return {
        "model": card.id,
        "version": card.version,
        "unit": "mm",
        "points": use.seven_digits(found.points),
        "triangles": found.triangles.tolist(),
    }


@router.get(ROTOR + "/versions", summary="Versions that are kept, the newest first")
def get_versions(
    r: Name, services: Wired, limit: Limit = None, cursor: Cursor = None
) -> dict[str, Any]:
    size = page_size(services, limit)
    found = use.versions(services.store, r, seq_of(cursor), size + 1)
    return page([version_out(state) for state in found], size, "version")


def version_out(state: StateRecord) -> dict[str, Any]:
    return {
        "version": state.version,
        "through_seq": state.through_seq,
        "sealed": state.sealed,
        "state_digest": state.digest,
        "events_digest": state.events_digest,
        "model_version": state.model_version,
        "algorithm_version": state.algorithm_version,
        "created_at": moment(state.created_at),
        "health": health(state),
    }


@router.get("/operations", summary="The service at one moment: backlog, workers, jobs, blocked")
def get_operations(services: Wired, limit: Limit = None) -> dict[str, Any]:
    found = use.operations(services.store, page_size(services, limit))
    jobs = [diagnosis_out(job) | {"kind": job.kind} for job in found.jobs]
    return {
        "gauges": asdict(found.gauges),
        "work": [asdict(one) for one in found.work],
        "jobs": [{k: v for k, v in job.items() if k != "result"} for job in jobs],
        "blocked": [rotor_out(rotor) for rotor in found.blocked],
    }
