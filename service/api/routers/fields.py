"""Fields on a model's mesh, at one hour or over many, and the mesh's surface to show them on."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request
from fastapi.responses import Response

from service.api.files import ARROW, NPZ, VTU, ZIP, file
from service.api.problems import fault, invalid
from service.api.routers.glance import Hour, Quantity
from service.api.routers.reads import LONGEST_TIMES, read_times
from service.api.services import Name, Wired, tag_of_basis, tagged, unchanged
from service.api.which import Asked
from service.handlers import exports, series
from service.handlers import glance as use
from service.handlers.reads import basis

router = APIRouter(prefix="/v1", tags=["glance"])
ROTOR, BLADE = "/rotors/{r}", "/rotors/{r}/blades/{b}"
Times = Annotated[
    str | None,
    Query(
        max_length=LONGEST_TIMES,
        description="hours with commas between; default: the model's instants",
    ),
]


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
        Literal["json", "vtu", "pvd", "npz", "arrow"],
        Query(
            description="vtu: on the mesh, for ParaView and the like; pvd: many hours as a zip of "
            "a PVD and its VTU files; npz: many hours as numpy arrays; arrow: as an Arrow stream, "
            "a batch for each hour"
        ),
    ] = "json",
) -> Response:
    of_many = format in ("pvd", "npz", "arrow")
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
        if format == "arrow":
            batches = series.arrow(services.store, services.science, found, wanted)
            return file(batches, ARROW, saved, "arrows", tag, found)
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
