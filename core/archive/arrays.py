"""Runs from a numpy archive (``.npz``).

Arrays by name, as in `core.archive.source`: (n,) is an input, (n, T), (n, T, N) and (n, T, N, 3)
are quantities, ``time`` (T,) or (n, T) the instants, ``points`` (N, 3) and ``cells`` the mesh.
``units`` is a JSON text of each name's unit, ``bounds`` one of inputs' [low, high],
``named_nodes`` one of nodes with a name. Objects (pickle) are not read.

    np.savez("runs.npz", roughness=r, drop=y, time=t,
             units=json.dumps({"roughness": "um", "drop": "kPa", "time": "h"}))
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.archive.declaration import Kind, Mesh
from core.archive.faults import Findings
from core.archive.source import Column, Given
from core.archive.table import KEPT
from core.archive.write import write_runs
from core.errors import ModelError, UnitError
from core.units import hours, ratio, unit

KINDS: dict[int, Kind] = {2: "scalar", 3: "field", 4: "vector field"}
TEXTS = ("units", "bounds", "named_nodes")
PLACED = ("time", "points", "cells", "run")
NONE = np.zeros((0, 0))


def convert_arrays(path: str | Path, out: str | Path) -> dict[str, object]:
    """Write the archive's runs to `out`; what it took for inputs and quantities.

    Raises RunsError with every fault, ModelError for a file that is no such archive.
    """
    path, found = Path(path), Findings()
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays: dict[str, NDArray[Any]] = {name: stored[name] for name in stored.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise ModelError(f"{path} cannot be read as npz without pickle: {error}") from error
    told = {name: _json(arrays.pop(name, None), name, found) for name in TEXTS}
    units = told["units"]
    values = {name: a for name, a in arrays.items() if name not in PLACED}
    count = next((len(a) for a in values.values() if a.ndim), 0)
    nodes = next((a.shape[2] for a in values.values() if a.ndim > 2), 0)
    _check_placed(arrays, count, nodes, found)
    found.end()
    time = np.asarray(arrays["time"], dtype=float)
    inputs: dict[str, Column] = {}
    quantities: dict[str, Given] = {}
    for name in ("time", *values):
        try:
            if name not in units:
                raise UnitError("unit", None, "has no unit", "add it to units; 1 for none")
            unit(str(units[name]))
        except UnitError as error:
            found.add(UnitError(f"units of {name}", units.get(name), error.problem, error.remedy))
    for name in (one for one in values if "/" in one):
        found.fault(name, None, "holds a slash, which names a group in a file of runs", "rename it")
    for name in sorted(values.keys() & {*KEPT}):
        found.fault(name, None, "is a name that the format of runs keeps for itself", "rename it")
    for name, array in values.items():
        text = str(units.get(name, "1"))
        fits = [count, time.shape[-1], nodes, 3][: array.ndim]
        if array.dtype.kind not in "iuf" or not 1 <= array.ndim <= 4 or list(array.shape) != fits:
            remedy = "give (runs,), (runs, T), (runs, T, N) or (runs, T, N, 3)"
            found.fault(name, list(array.shape), f"does not fit {count} runs", remedy)
        elif array.ndim == 1:
            low, high = _ends(name, told["bounds"].get(name, [None, None]), found)
            inputs[name] = Column(text, low, high, np.asarray(array, float))
        else:
            quantities[name] = Given(text, KINDS[array.ndim])
    for name in sorted(told["bounds"].keys() - (values.keys() - quantities.keys())):
        shown = str(told["bounds"][name])[:100]
        found.fault(f"bounds of {name}", shown, "are of no input", "name it as the array")
    for what, have in (("input", inputs), ("quantity", quantities)):
        if not have and not found.faults:
            found.fault(path.name, None, f"holds no {what}", "give (runs,) and (runs, T)")
    found.end()
    mesh = Mesh.none()
    if nodes:
        try:
            scale = ratio(str(units.get("points", "mm")), "mm")[0]
        except UnitError as error:
            found.add(UnitError("units of points", error.value, error.problem, "say mm or m"))
            found.end()
        cells = np.asarray(arrays.get("cells", NONE), dtype=np.int64)
        points = np.asarray(arrays["points"], float) * scale
        mesh = Mesh("own", points, cells, np.zeros((nodes, 3)), told["named_nodes"])
    try:
        time_h = time * hours(str(units["time"]))
    except UnitError as error:
        found.add(UnitError("units of time", error.value, error.problem, "say h, d, min or s"))
        found.end()
    labels = arrays["run"].tolist() if "run" in arrays else range(count)
    write_runs(
        out,
        labels=[str(one) for one in labels],
        inputs=inputs,
        quantities=quantities,
        time_h=time_h,
        rows=({name: values[name][k] for name in quantities} for k in range(count)),
        mesh=mesh,
        source=path.name,
    )
    return {"runs": count, "inputs": list(inputs), "quantities": list(quantities)}


def _check_placed(
    arrays: Mapping[str, NDArray[Any]], count: int, nodes: int, found: Findings
) -> None:
    """Instants, labels and mesh have the shapes that go with so many runs and nodes."""
    time = arrays.get("time")
    if time is None:
        found.fault("time", None, "is missing", "give the instants, (T,) or (runs, T)")
    elif time.dtype.kind not in "iuf" or time.shape[:-1] not in ((), (count,)) or not time.ndim:
        problem = f"are not instants of {count} runs"
        found.fault("time", list(time.shape), problem, "give numbers, (T,) or (runs, T)")
    if arrays.get("run", np.zeros(count)).shape != (count,):
        shape = list(arrays["run"].shape)
        found.fault("run", shape, f"are not labels of {count} runs", "give (runs,)")
    points, cells = arrays.get("points", NONE), arrays.get("cells", NONE)
    if nodes and (points.shape != (nodes, 3) or points.dtype.kind not in "iuf"):
        found.fault("points", None, f"has not {nodes} nodes", "give numbers, (N, 3)")
    inside = cells.ndim == 2 and cells.dtype.kind in "iu"
    if nodes and cells.size and not (inside and 0 <= cells.min() <= cells.max() < nodes):
        problem = f"does not name nodes 0 … {nodes - 1} by cell and corner"
        found.fault("cells", list(cells.shape), problem, "count nodes from 0")


def _ends(name: str, told: object, found: Findings) -> tuple[float | None, float | None]:
    """An input's lower and upper bound."""
    if isinstance(told, list) and len(told) == 2:
        low, high = told
        if all(v is None or (type(v) in (int, float) and np.isfinite(v)) for v in told):
            return low, high
    found.fault(f"bounds of {name}", str(told)[:100], "are not [low, high]", "give two numbers")
    return None, None


def _json(array: NDArray[Any] | None, name: str, found: Findings) -> dict[str, Any]:
    """The object that a text in the archive is."""
    if array is None:
        return {}
    try:
        told = json.loads(str(array))
    except ValueError:
        told = None
    if not isinstance(told, dict):
        found.fault(
            name, str(array)[:100], "is no JSON object", 'write json.dumps({"drop": "kPa"})'
        )
        return {}
    return told
