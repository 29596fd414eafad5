"""Answers as files: draws and fields for other tools."""

from __future__ import annotations

import io
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from service.client.asking import below, listed, of_prediction
from service.client.errors import MissingError
from service.client.steps import Json, Steps, fetch, told


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
    params = of_prediction(quantity, times, node, probability, instrument, version, at)
    return fetch(below(rotor, blade, "prediction"), params | {"format": "csv"})


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
    params = of_prediction(quantity, times, node, probability, instrument, version, at)
    return fetch(below(rotor, blade, "prediction"), params | {"format": "sensorthings"})


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
    return fetch(below(rotor, blade, "draws"), params)


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
    return fetch(below(rotor, blade, "field"), params)


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
    hours, some = listed(times), None if blades is None else ",".join(blades)
    params = told(quantity=quantity, times=hours, blades=some, version=version, at=at, format="pvd")
    return fetch(below(rotor, blade, "field"), params)


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
    hours = listed(times)
    params = told(quantity=quantity, times=hours, version=version, at=at, format="npz")
    return fetch(below(rotor, blade, "field"), params)


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
    hours = listed(times)
    params = told(quantity=quantity, times=hours, version=version, at=at, format="arrow")
    return fetch(below(rotor, blade, "field"), params)


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
