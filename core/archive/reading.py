"""Reads a user's file (`core.archive.source`): what each variable is, and what is wrong with it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from core.archive.cells import CORNERS, kind_of
from core.archive.declaration import DIMENSIONS, Kind, Mesh
from core.archive.faults import Findings
from core.archive.source import UNKNOWN, Array, Column, Given, Source
from core.errors import InputError, UnitError
from core.units import hours, ratio, unit

KINDS: dict[frozenset[str], Kind] = {
    frozenset(("run", *dimensions)): kind  # type: ignore[misc]
    for kind, dimensions in DIMENSIONS.items()
}
OURS = ("points", "cells", "time", "run", "time_of_run", "parametric", "xyz", "node")
MOST_VALUES = 2**30  # of one file: 8 GiB in the precision that training computes in


def read_user_file(path: Path, data: Any, most_values: int) -> Source:
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
        factor = hours(text)
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
    cells, kind = np.zeros((0, 0), dtype=np.int64), ""
    if "cells" in data.variables:
        cells = np.asarray(data["cells"].values, dtype=np.int64)
        if cells.ndim != 2 or (cells.size and not (0 <= cells.min() <= cells.max() < count)):
            problem = f"does not name nodes 0 … {count - 1} by cell and corner"
            found.fault("cells", list(cells.shape), problem, "count nodes from 0")
            cells = np.zeros((0, 0), dtype=np.int64)
        told = data["cells"].attrs.get("kind")
        if told is not None and CORNERS.get(str(told)) != cells.shape[1]:
            remedy = f"use one of {', '.join(CORNERS)}, with as many corners as it has nodes"
            found.fault("kind of cells", str(told), "is no kind of such cells", remedy)
        kind = str(told) if told is not None else kind_of(cells, points)
    named = _named(found, data.attrs.get("named_nodes", "{}"), count)
    return Mesh("own", points, cells, np.zeros((count, 3)), named, kind)


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
