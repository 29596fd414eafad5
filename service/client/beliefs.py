"""What the twin believes: posterior, draws, predictions, fields, and what would narrow them."""

from __future__ import annotations

import io
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from service.client import answers
from service.client.errors import MissingError
from service.client.steps import Call, Json, Steps, ask, fetch, path, told


def _of(rotor: str, blade: str | None, what: str) -> str:
    parts = ("rotors", rotor) + (() if blade is None else ("blades", blade))
    return path(*parts, what)


def posterior(
    rotor: str, blade: str | None = None, *, version: int | None = None, at: str | None = None
) -> Steps[answers.RotorPosterior]:
    """The shared parameters' posterior, or one blade's; of a version, or as of a moment."""
    return ask("GET", _of(rotor, blade, "posterior"), params=told(version=version, at=at))


def prediction(
    rotor: str,
    blade: str,
    quantity: str | None = None,
    *,
    times: Sequence[float] | None = None,
    node: int | str | None = None,
    probability: float = 0.95,
    instrument: str | None = None,
    version: int | None = None,
    at: str | None = None,
) -> Steps[answers.Prediction]:
    """Bands of a quantity by source; with an instrument, of a reading by it.

    quantity   default: the model's first one

    ``answer["health"]["trusted"]`` is False where the state behind it says why it is not.
    """
    params = _asked(quantity, times, node, probability, instrument, version, at)
    return ask("GET", _of(rotor, blade, "prediction"), params=params)


def life(
    rotor: str,
    blade: str,
    limit: float,
    quantity: str | None = None,
    *,
    times: Sequence[float] | None = None,
    node: int | str | None = None,
    component: str | None = None,
    version: int | None = None,
    at: str | None = None,
) -> Steps[answers.Life]:
    """When a blade passes a limit [the quantity's unit]: hours by which it has, and how surely.

    ``answer["quantiles"]["0.05"]`` is the hour by which it has passed it with probability 0.05;
    None: not within the model's hours.

    quantity   default: the model's first one
    component  x, y or z of a vector; default: z, the radius
    """
    params = told(
        limit=limit,
        quantity=quantity,
        times=_listed(times),
        node=node,
        component=component,
        version=version,
        at=at,
    )
    return ask("GET", _of(rotor, blade, "life"), params=params)


def series(
    rotor: str,
    quantity: str | None = None,
    *,
    blade: str | None = None,
    times: Sequence[float] | None = None,
    node: int | str | None = None,
    component: str | None = None,
    probability: float = 0.95,
    version: int | None = None,
    at: str | None = None,
) -> Call:
    """Predictions as flat rows (blade, time, value, lower, upper), of all blades that run.

    time   operating hours; lower and upper hold a reading with the probability
    """
    params = told(
        quantity=quantity,
        blade=blade,
        times=_listed(times),
        node=node,
        component=component,
        probability=probability,
        version=version,
        at=at,
    )
    return Call("GET", path("rotors", rotor, "series"), params)


def prediction_csv(
    rotor: str,
    blade: str,
    quantity: str | None = None,
    *,
    times: Sequence[float] | None = None,
    node: int | str | None = None,
    probability: float = 0.95,
    instrument: str | None = None,
    version: int | None = None,
    at: str | None = None,
) -> Steps[bytes]:
    """The same bands as CSV in UTF-8, a row for each hour (and x, y, z)."""
    params = _asked(quantity, times, node, probability, instrument, version, at)
    return fetch(_of(rotor, blade, "prediction"), params | {"format": "csv"})


def prediction_sensorthings(
    rotor: str,
    blade: str,
    quantity: str | None = None,
    *,
    times: Sequence[float] | None = None,
    node: int | str | None = None,
    probability: float = 0.95,
    instrument: str | None = None,
    version: int | None = None,
    at: str | None = None,
) -> Steps[bytes]:
    """The same bands as a SensorThings Datastream, an Observation for each hour (JSON)."""
    params = _asked(quantity, times, node, probability, instrument, version, at)
    return fetch(_of(rotor, blade, "prediction"), params | {"format": "sensorthings"})


def _listed(times: Sequence[float] | None) -> str | None:
    return None if times is None else ",".join(repr(float(t)) for t in times)


def _asked(
    quantity: str | None,
    times: Sequence[float] | None,
    node: int | str | None,
    probability: float,
    instrument: str | None,
    version: int | None,
    at: str | None,
) -> dict[str, str]:
    return told(
        quantity=quantity,
        times=_listed(times),
        node=node,
        probability=probability,
        instrument=instrument,
        version=version,
        at=at,
    )


def draws(
    rotor: str,
    blade: str | None = None,
    *,
    count: int | None = None,
    version: int | None = None,
    at: str | None = None,
) -> Steps[Json]:
    """Equally weighted draws: of a blade's parameters, or jointly of all blades'."""
    params = told(count=count, version=version, at=at)
    return ask("GET", _of(rotor, blade, "draws"), params=params)


def draws_netcdf(
    rotor: str,
    blade: str | None = None,
    *,
    count: int | None = None,
    version: int | None = None,
    at: str | None = None,
    groups: Sequence[str] | None = None,
) -> Steps[bytes]:
    """Joint draws as netCDF in ArviZ's schema: dimensions chain, draw and blade, with units.

    groups   beside the posterior: of `prior` and `posterior_predictive` (None: both), and
             `particles`, the weighted ones
    """
    some = None if groups is None else ",".join(("posterior", *groups))
    params = told(count=count, version=version, at=at, groups=some, format="netcdf")
    return fetch(_of(rotor, blade, "draws"), params)


def draws_arviz(
    rotor: str,
    blade: str | None = None,
    *,
    count: int | None = None,
    version: int | None = None,
    at: str | None = None,
    groups: Sequence[str] | None = None,
) -> Steps[Any]:
    """Joint draws as ArviZ has them in memory (InferenceData; from ArviZ 1.0 on a DataTree).

    groups   as of `draws_netcdf`

    Raises MissingError where ArviZ is not installed (extra `notebook`).
    """
    try:
        import arviz
    except ModuleNotFoundError:
        raise MissingError("arviz", "notebook") from None
    body = yield from draws_netcdf(rotor, blade, count=count, version=version, at=at, groups=groups)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "draws.nc")
        file.write_bytes(body)
        opened = arviz.from_netcdf(str(file))
        found = opened.load()
        opened.close()
    return found


def field(
    rotor: str,
    blade: str,
    quantity: str | None = None,
    *,
    time_h: float | None = None,
    version: int | None = None,
    at: str | None = None,
) -> Steps[answers.Field]:
    """Mean and sd of a field at every node at one hour, without a reading's noise."""
    params = told(quantity=quantity, time_h=time_h, version=version, at=at)
    return ask("GET", _of(rotor, blade, "field"), params=params)


def field_vtu(
    rotor: str,
    blade: str,
    quantity: str | None = None,
    *,
    time_h: float | None = None,
    version: int | None = None,
    at: str | None = None,
) -> Steps[bytes]:
    """The same field on the model's mesh, as a VTU file (ParaView, PyVista, meshio)."""
    params = told(quantity=quantity, time_h=time_h, version=version, at=at, format="vtu")
    return fetch(_of(rotor, blade, "field"), params)


def field_pvd(
    rotor: str,
    blade: str | None = None,
    quantity: str | None = None,
    *,
    times: Sequence[float] | None = None,
    blades: Sequence[str] | None = None,
    version: int | None = None,
    at: str | None = None,
) -> Steps[bytes]:
    """A field over hours as a zip of a PVD and its VTU files (ParaView, PyVista).

    blade    None: those of the rotor, around its axis; `blades`: of these alone
    times    [h], rising; None: the model's instants
    """
    hours, some = _listed(times), None if blades is None else ",".join(blades)
    params = told(quantity=quantity, times=hours, blades=some, version=version, at=at, format="pvd")
    return fetch(_of(rotor, blade, "field"), params)


def field_npz(
    rotor: str,
    blade: str,
    quantity: str | None = None,
    *,
    times: Sequence[float] | None = None,
    version: int | None = None,
    at: str | None = None,
) -> Steps[bytes]:
    """A field over hours as a numpy file: `time_h`, `mean`, `sd`, `unit`, `facts`."""
    hours = _listed(times)
    params = told(quantity=quantity, times=hours, version=version, at=at, format="npz")
    return fetch(_of(rotor, blade, "field"), params)


def field_arrow(
    rotor: str,
    blade: str,
    quantity: str | None = None,
    *,
    times: Sequence[float] | None = None,
    version: int | None = None,
    at: str | None = None,
) -> Steps[bytes]:
    """The same as an Arrow IPC stream: a batch for each hour, a row for each node."""
    hours = _listed(times)
    params = told(quantity=quantity, times=hours, version=version, at=at, format="arrow")
    return fetch(_of(rotor, blade, "field"), params)


def field_series(
    rotor: str,
    blade: str,
    quantity: str | None = None,
    *,
    times: Sequence[float] | None = None,
    version: int | None = None,
    at: str | None = None,
) -> Steps[Json]:
    """The same in memory: `time_h` (T,), `mean` and `sd` (T, N) or (T, N, 3), `unit`, `facts`."""
    body = yield from field_npz(rotor, blade, quantity, times=times, version=version, at=at)
    with np.load(io.BytesIO(body)) as found:
        arrays = {name: found[name] for name in found.files}
    return arrays | {"unit": str(arrays["unit"]), "facts": json.loads(str(arrays["facts"]))}


def plan(
    rotor: str,
    *,
    blade: str | None = None,
    quantity: str | None = None,
    time_h: float | None = None,
    parameter: str | None = None,
    count: int = 3,
) -> Steps[answers.Plan]:
    """Inspections by how much they would narrow a blade's prediction, or a parameter.

    time_h   hour of the prediction [h]; None: the model's last
    """
    params = told(blade=blade, quantity=quantity, time_h=time_h, parameter=parameter, count=count)
    return ask("GET", path("rotors", rotor, "plan"), params=params)
