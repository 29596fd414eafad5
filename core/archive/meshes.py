"""Runs from series of mesh files (VTU, VTK, XDMF …, whatever meshio reads).

A table (`core.archive.table`) with a column ``file`` says which file holds which run and instant::

    run, time [h], file,            load [kN]
    1,   0,        run1/t000.vtu,   12
    1,   500,      run1/t001.vtu,   12

Paths are relative to the table. `fields` names the point data that become quantities, with units:
``{"temperature": "K"}``; data of one column are fields, of three vectors. All files have the same
nodes, and the runs the same instants. Other columns of the table that change within a run are
scalar quantities.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.archive.cells import CORNERS, FROM_MESHIO
from core.archive.declaration import Kind, Mesh
from core.archive.faults import Findings
from core.archive.source import Given
from core.archive.table import Table, by_run, read_table, split_columns, times
from core.archive.write import write_runs
from core.errors import ModelError, UnitError
from core.units import ratio, unit

Array = NDArray[np.float64]
APART = 1e-6  # of the mesh's size


def convert_meshes(
    path: str | Path,
    out: str | Path,
    fields: Mapping[str, str],
    *,
    inputs: Sequence[str] | None = None,
    points_unit: str = "mm",
    named: Mapping[str, int] | None = None,
) -> dict[str, object]:
    """Write the runs of a table of mesh files to `out`; each file is read once, one at a time.

    Raises RunsError with every fault: files that are missing or hold other nodes, fields that
    they lack.
    """
    table, found = read_table(path), Findings()
    chosen, names = split_columns(table, inputs, found)
    for name, text in fields.items():
        try:
            unit(text)
        except UnitError as error:
            found.add(UnitError(f"unit of field {name}", text, error.problem, error.remedy))
    if not fields:
        found.fault("fields", None, "are not named", "name the point data with units: --field")
    try:
        scale = ratio(points_unit, "mm")[0]
    except UnitError as error:
        found.add(UnitError("unit of points", points_unit, error.problem, "say mm or m"))
    hours = times(table)
    if hours.ndim > 1:
        found.fault("time", None, "differs between runs", "write all runs at the same instants")
    files = [table.path.parent / one for one in table.texts["file"]]
    for k, file in enumerate(files):
        if not file.is_file():
            where = f"run {table.labels[table.run[k]]}: file at {table.time_h[k]:g} h"
            found.fault(
                where, table.texts["file"][k], "does not exist", "repeat it, or take it out"
            )
    found.end()
    first = _opened(files[0])
    quantities = {name: Given(table.units[name], "scalar") for name in names}
    for name, text in fields.items():
        kind = _kind(first, name, files[0], found)
        if kind is not None:
            quantities[name] = Given(text, kind)
    found.end()
    points = _points(first)
    for name, node in (named or {}).items():
        if not 0 <= node < len(points):
            remedy = "count nodes from 0"
            found.fault(f"node {name}", node, f"is not in 0 … {len(points) - 1}", remedy)
    found.end()
    blocks = sorted(first.cells, key=lambda block: -len(block.data))
    cells = np.asarray(blocks[0].data, np.int64) if blocks else np.zeros((0, 0), np.int64)
    known = str(blocks[0].type) if blocks and blocks[0].type in CORNERS else ""
    cells = cells[:, FROM_MESHIO[known]] if known in FROM_MESHIO else cells
    mesh = Mesh("own", scale * points, cells, np.zeros(points.shape), dict(named or {}), known)
    wide = {name: by_run(table, table.columns[name]) for name in names}

    def rows() -> Iterator[Mapping[str, Array]]:
        for k in range(len(table.labels)):
            own = {name: wide[name][k] for name in names}
            yield own | _run_fields(table, files, k, fields, points, found)
        found.end()

    write_runs(
        out,
        labels=table.labels,
        inputs=chosen,
        quantities=quantities,
        time_h=hours,
        rows=rows(),
        mesh=mesh,
        source=table.path.name,
    )
    return {"runs": len(table.labels), "inputs": list(chosen), "quantities": list(quantities)}


def _opened(file: Path) -> Any:
    import meshio

    try:
        return meshio.read(file)
    except (meshio.ReadError, OSError, ValueError, KeyError, SystemExit) as error:
        raise ModelError(f"{file} cannot be read as a mesh: {error}") from error


def _points(mesh: Any) -> Array:
    """(N, 3); a plane mesh lies at z = 0."""
    points = np.asarray(mesh.points, dtype=float)[:, :3]
    return np.pad(points, ((0, 0), (0, 3 - points.shape[1])))


def _kind(mesh: Any, name: str, file: Path, found: Findings) -> Kind | None:
    data = mesh.point_data.get(name)
    if data is None:
        have = ", ".join(mesh.point_data) or "none"
        found.fault(f"field {name}", None, f"is not in {file.name}", f"its point data are {have}")
        return None
    if data.ndim == 1 or data.shape[1:] == (1,):
        return "field"
    if data.shape[1:] == (3,):
        return "vector field"
    shape = list(data.shape[1:])
    found.fault(f"field {name}", shape, "are not its columns: 1 or 3", "write components apart")
    return None


def _run_fields(
    table: Table,
    files: Sequence[Path],
    k: int,
    fields: Mapping[str, str],
    points: Array,
    found: Findings,
) -> dict[str, Array]:
    """The fields of run k, (T, N) or (T, N, 3); NaN where a file does not fit."""
    lines = [int(line) for line in np.flatnonzero(table.run == k)]
    size = float(np.ptp(points, axis=0).max()) or 1.0
    out: dict[str, list[Array]] = {name: [] for name in fields}
    for line in lines:
        where = f"run {table.labels[k]}: {files[line].name}"
        mesh = _opened(files[line])
        own = _points(mesh)
        nodes = len(points)
        if len(own) != nodes:
            found.fault(where, len(own), f"nodes are not the {nodes} of the first file", "remesh")
            own = points
        else:
            apart = np.linalg.norm(own - points, axis=1)
            node = int(apart.argmax())
            if apart[node] > APART * size:
                problem = f"is how far node {node} lies from its place in the first file"
                remedy = "write all runs on one mesh, undeformed"
                found.fault(where, float(apart[node]), problem, remedy)
        for name in fields:
            data = mesh.point_data.get(name)
            if data is None or len(data) != nodes:
                if data is None:
                    found.fault(where, name, "is not among its point data", "write the field")
                data = np.full(nodes, np.nan)
            data = np.asarray(data, dtype=float)
            out[name].append(data[:, 0] if data.shape[1:] == (1,) else data)
    shapes = {name: max((one.shape for one in own), key=len) for name, own in out.items()}
    return {
        name: np.stack(
            [one if one.shape == shapes[name] else np.full(shapes[name], np.nan) for one in own]
        )
        for name, own in out.items()
    }
