"""The format of users' own runs, and how it is read.

One netCDF-4 file, as xarray writes it (``engine="h5netcdf"`` or ``"netcdf4"``). What a variable is
shows in its dimensions, in any order; every variable has ``units`` (`core.units`; 1 for none):

=====================  ==========================  ==============================================
dimensions             is                          attributes
=====================  ==========================  ==============================================
(run)                  an input of the simulation  units; low, high: bounds of the design (default:
                                                   those of the network's prior)
(time)                 ``time``, the instants      units (h, s, d …); from 0, increasing, four or
                                                   more
(run, time)            a scalar quantity           units
(run, time, node)      a field                     units
(run, time, node, xyz) a field of vectors          units
(node, xyz)            ``points`` of the mesh      units; optional
(cell, corner)         ``cells``: node numbers     optional
(run)                  ``run``: labels             optional: 0 … n − 1
(run, time)            ``time_of_run``             units; in place of ``time`` where runs have
                                                   instants of their own, NaN after the last
=====================  ==========================  ==============================================

The file's attributes: ``named_nodes``, JSON of name → node number; ``title`` or ``source``, free
text. A run that failed may be left out of the labels or hold NaN throughout; it is named and left
out. `core.archive.write` makes such files; a packed archive of ours (`Archive.to_netcdf`) and a
folder of runs (`Archive`) are read as well.

    >>> ds = xr.Dataset(                                                        # doctest: +SKIP
    ...     {"roughness": ("run", r, {"units": "um", "low": 1.0, "high": 9.0}),
    ...      "drop": (("run", "time"), y, {"units": "kPa"})},
    ...     coords={"time": ("time", t, {"units": "h"})})
    >>> ds.to_netcdf("runs.nc", engine="h5netcdf")                              # doctest: +SKIP
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from core.archive.declaration import DIMENSIONS, Declaration, Kind, Mesh
from core.archive.faults import Findings
from core.archive.store import Archive
from core.errors import InputError, ModelError, UnitError
from core.units import ratio, unit

Array = NDArray[np.float64]
KINDS: dict[frozenset[str], Kind] = {
    frozenset(("run", *dimensions)): kind  # type: ignore[misc]
    for kind, dimensions in DIMENSIONS.items()
}
OURS = ("points", "cells", "time", "run", "time_of_run", "parametric", "xyz", "node")
UNKNOWN = ""  # the unit where the file says none that is known
MOST_VALUES = 2**30  # of one file: 8 GiB in the precision that training computes in


@dataclass(frozen=True, slots=True)
class Column:
    """An input: values (n,) of the runs in `unit`, and the bounds that the file gives it."""

    unit: str
    low: float | None
    high: float | None
    values: Array


@dataclass(frozen=True, slots=True)
class Given:
    """A quantity: its unit in the file, and its kind."""

    unit: str
    kind: Kind


@dataclass(frozen=True, slots=True)
class Source:
    """Runs as a file or folder holds them; one run's values are read at a time.

    labels   of the runs, as the user calls them
    time_h   (T,), or (n, T) where runs have instants of their own, NaN after a run's last
    read     (run, quantity) → values (T,), (T, N) or (T, N, 3) in the quantity's unit
    command  where the runs come from
    faults   what is wrong with it and keeps no value from being read: units
    """

    name: str
    labels: tuple[str, ...]
    inputs: Mapping[str, Column]
    quantities: Mapping[str, Given]
    time_h: Array
    mesh: Mesh
    read: Callable[[int, str], Array]
    command: str
    faults: tuple[InputError, ...] = ()


@contextmanager
def opened(path: str | Path, *, most_values: int = MOST_VALUES) -> Iterator[Source]:
    """A file or folder of runs, open for reading.

    Raises ModelError for what is no archive, RunsError for one whose variables do not fit.
    """
    path = Path(path)
    if path.is_dir():
        yield of_archive(Archive.open(path))
        return
    check_file(path)
    import xarray as xr

    try:
        data = xr.open_dataset(
            path, engine="h5netcdf", decode_times=False, decode_timedelta=False, cache=False
        )
    except (OSError, ValueError, KeyError, TypeError, RuntimeError) as error:
        raise ModelError(f"{path.name} cannot be read as netCDF: {error}") from error
    with data:
        if "declaration" in data.attrs:
            yield _packed(path, data)
        else:
            yield _read(path, data, most_values)


def check_file(path: Path) -> None:
    """Refuse what is no HDF5 file, and one whose data would come from elsewhere.

    HDF5 can point into other files of the machine that reads it (external links and storage,
    virtual datasets); an archive holds its own numbers.
    """
    try:
        with h5py.File(path, "r") as file:
            _check_group(file, path.name)
    except (OSError, RuntimeError, KeyError, ValueError) as error:
        raise ModelError(f"{path.name} cannot be read as netCDF-4: {error}") from error


def _check_group(group: Any, name: str) -> None:
    for key in group:
        if not isinstance(group.get(key, getlink=True), h5py.HardLink):
            raise ModelError(f"{name}: {key!r} points elsewhere; an archive holds its own numbers")
        found = group[key]
        if isinstance(found, h5py.Group):
            raise ModelError(f"{name}: group {key!r}: put all variables at the top")
        if isinstance(found, h5py.Dataset) and (found.external or found.is_virtual):
            raise ModelError(f"{name}: {key!r} is stored elsewhere; write the numbers into it")


def of_archive(archive: Archive) -> Source:
    """Our own folder of runs; its inputs have no units, those of the network are taken."""
    declared, done = archive.declaration, archive.done()
    inputs = archive.inputs(done)
    columns = {
        item.name: Column("", item.low, item.high, inputs[:, j])
        for j, item in enumerate(declared.inputs)
    }
    return Source(
        archive.path.name,
        tuple(map(str, done)),
        columns,
        {q.name: Given(q.unit, q.kind) for q in declared.quantities},
        np.array(declared.time_h),
        archive.mesh(),
        lambda k, quantity: np.asarray(archive.stack(quantity, [done[k]])[0], dtype=float),
        declared.command,
    )


def _packed(path: Path, data: Any) -> Source:
    """One file of `Archive.to_netcdf`."""
    declared = Declaration.from_json(str(data.attrs["declaration"]))
    needed = {"index", "inputs", *(q.name for q in declared.quantities)}
    needed |= {"points", "cells", "parametric"} if declared.nodes else set()
    if needed - set(data.variables):
        missing = sorted(needed - set(data.variables))
        raise ModelError(f"{path.name} declares {missing} and does not hold them")
    inputs = np.asarray(data["inputs"].values, dtype=float)
    columns = {
        item.name: Column("", item.low, item.high, inputs[:, j])
        for j, item in enumerate(declared.inputs)
    }
    mesh = Mesh.none()
    if declared.nodes:
        points, cells, parametric = (data[n].values for n in ("points", "cells", "parametric"))
        mesh = Mesh(declared.mesh, points, cells, parametric, declared.named)
    return Source(
        path.name,
        tuple(str(int(k)) for k in data["index"].values),
        columns,
        {q.name: Given(q.unit, q.kind) for q in declared.quantities},
        np.array(declared.time_h),
        mesh,
        lambda k, quantity: np.asarray(data[quantity][k].values, dtype=float),
        declared.command,
    )


def _read(path: Path, data: Any, most_values: int) -> Source:
    """A user's file; every fault of its structure is found before any value is read."""
    found, units_found = Findings(), Findings()
    sizes = {str(name): int(size) for name, size in data.sizes.items()}
    inputs: dict[str, Column] = {}
    quantities: dict[str, Given] = {}
    if "run" not in sizes:
        found.fault("run", sorted(sizes), "is not among the dimensions", "give each run a place")
        found.end()
    total = sum(int(data[name].size) for name in data.variables)
    if total > most_values:
        problem = f"values are declared, more than {most_values}"
        found.fault(path.name, total, problem, "thin out instants or nodes")
        found.end()
    for name in map(str, data.variables):
        variable = data.variables[name]
        if name in OURS:
            continue
        own = frozenset(map(str, variable.dims))
        if own not in (frozenset(("run",)), *KINDS):
            shown = ", ".join(map(str, variable.dims)) or "none"
            problem = (
                "are those of neither an input (run) nor a quantity (run, time[, node[, xyz]])"
            )
            found.fault(f"dimensions of {name}", shown, problem, "rename them, or drop it")
            continue
        if variable.dtype.kind not in "iuf":
            found.fault(name, str(variable.dtype), "holds no numbers", "write it as float64")
            continue
        units = _units(units_found, name, variable.attrs)
        if own == frozenset(("run",)):
            values = np.asarray(variable.values, dtype=float)
            low, high = (_bound(found, name, variable.attrs, end) for end in ("low", "high"))
            inputs[name] = Column(units, low, high, values)
        else:
            quantities[name] = Given(units, KINDS[own])
    for what, have in (("input", inputs), ("quantity", quantities)):
        if not have:
            remedy = "give one over (run)" if what == "input" else "give one over (run, time)"
            found.fault(path.name, None, f"holds no {what}", remedy)
    labels = _labels(found, data, sizes["run"])
    time_h = _time(found, data)
    mesh = _mesh(found, data, sizes, quantities)
    if found.faults:
        found.faults += units_found.faults
        found.end()

    def read(k: int, quantity: str) -> Array:
        dims = DIMENSIONS[quantities[quantity].kind]
        return np.asarray(data[quantity].isel(run=k).transpose(*dims).values, dtype=float)

    command = str(data.attrs.get("source") or data.attrs.get("title") or path.name)
    return Source(
        path.name,
        labels,
        inputs,
        quantities,
        time_h,
        mesh,
        read,
        command[:200],
        tuple(units_found.faults),
    )


def _units(found: Findings, name: str, attrs: Mapping[str, Any]) -> str:
    """The unit that a variable says; a fault where it says none or an unknown one."""
    text = attrs.get("units")
    if text is None:
        found.fault(
            f"units of {name}", None, "are missing", "set its attribute units, e.g. mm or 1"
        )
        return UNKNOWN
    try:
        unit(str(text))
    except UnitError as error:
        found.add(UnitError(f"units of {name}", str(text), error.problem, error.remedy))
        return UNKNOWN
    return str(text)


def _bound(found: Findings, name: str, attrs: Mapping[str, Any], end: str) -> float | None:
    if end not in attrs:
        return None
    try:
        value = float(attrs[end])
    except (TypeError, ValueError):
        value = float("nan")
    if not np.isfinite(value):
        found.fault(f"{end} of {name}", str(attrs[end]), "is no finite number", "give one")
        return None
    return value


def _labels(found: Findings, data: Any, count: int) -> tuple[str, ...]:
    if "run" not in data.variables:
        return tuple(map(str, range(count)))
    labels = tuple(str(one) for one in data["run"].values.tolist())
    twice = sorted({one for one in labels if labels.count(one) > 1})
    if twice:
        found.fault("run", twice[:5], "label more than one run", "give each run its own label")
    return labels


def _time(found: Findings, data: Any) -> Array:
    """Hours (T,), or (n, T) where runs have instants of their own."""
    name = "time_of_run" if "time_of_run" in data.variables else "time"
    if name not in data.variables:
        found.fault("time", None, "is missing", "give the instants as the coordinate time")
        return np.zeros(0)
    variable = data[name]
    dims = ("run", "time") if name == "time_of_run" else ("time",)
    if set(variable.dims) != set(dims) or variable.dtype.kind not in "iuf":
        found.fault(
            name, list(variable.dims), "are not its dimensions", f"give numbers over {dims}"
        )
        return np.zeros(0)
    text = str(variable.attrs.get("units", ""))
    try:
        factor, _ = ratio(text, "h")
    except UnitError as error:
        problem = error.problem if text else "says no unit of time"
        found.add(UnitError(f"units of {name}", text, problem, "say h, d, min or s"))
        return np.zeros(0)
    return np.asarray(variable.transpose(*dims).values, dtype=float) * factor


def _mesh(
    found: Findings, data: Any, sizes: Mapping[str, int], quantities: Mapping[str, Given]
) -> Mesh:
    """The mesh; nodes without a place where the file gives none. Points become mm."""
    count = sizes.get("node", 0)
    if not count or all(given.kind == "scalar" for given in quantities.values()):
        return Mesh.none()
    points = np.full((count, 3), np.nan)
    if "points" in data.variables:
        variable = data["points"]
        if set(variable.dims) != {"node", "xyz"} or sizes.get("xyz") != 3:
            found.fault("points", list(variable.dims), "are not (node, xyz)", "give x, y, z")
        else:
            points = np.asarray(variable.transpose("node", "xyz").values, dtype=float)
            try:
                points = points * ratio(str(variable.attrs.get("units", "")), "mm")[0]
            except UnitError as error:
                found.add(UnitError("units of points", error.value, error.problem, "say mm or m"))
    cells = np.zeros((0, 0), dtype=np.int64)
    if "cells" in data.variables:
        cells = np.asarray(data["cells"].values, dtype=np.int64)
        if cells.ndim != 2 or (cells.size and not (0 <= cells.min() <= cells.max() < count)):
            problem = f"does not name nodes 0 … {count - 1} by cell and corner"
            found.fault("cells", list(cells.shape), problem, "count nodes from 0")
    named = _named(found, data.attrs.get("named_nodes", "{}"), count)
    return Mesh("own", points, cells, np.zeros((count, 3)), named)


def _named(found: Findings, text: object, count: int) -> dict[str, int]:
    try:
        named = json.loads(str(text))
        fits = isinstance(named, dict) and all(
            type(node) is int and 0 <= node < count for node in named.values()
        )
    except ValueError:
        fits = False
    if not fits:
        problem = f"is no JSON of names and nodes 0 … {count - 1}"
        found.add(InputError("named_nodes", str(text)[:100], problem, 'write {"tip": 12}'))
        return {}
    return {str(name): int(node) for name, node in named.items()}
