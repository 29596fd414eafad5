"""Writes the format of `core.archive.source`, run by run: only one is in memory."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import h5netcdf
import h5py
import numpy as np
from numpy.typing import NDArray

from core.archive.declaration import DIMENSIONS, Mesh
from core.archive.disk import replace_file
from core.archive.source import Column, Given

Array = NDArray[np.float64]
TEXT = h5py.string_dtype()


def write_runs(
    path: str | Path,
    *,
    labels: Sequence[str],
    inputs: Mapping[str, Column],
    quantities: Mapping[str, Given],
    time_h: Array,
    rows: Iterable[Mapping[str, Array]],
    mesh: Mesh | None = None,
    source: str = "",
) -> None:
    """A file of runs; it appears whole or not at all.

    time_h  (T,) hours, or (n, T) where runs have instants of their own, NaN after the last
    rows    one per label: by quantity (T,), (T, N) or (T, N, 3)
    mesh    with points in mm; needed for fields
    """
    mesh = mesh or Mesh.none()

    def fill(part: Path) -> None:
        with h5netcdf.File(part, "w") as out:
            sizes = {"run": len(labels), "time": time_h.shape[-1]}
            out.dimensions = sizes | (
                {"node": len(mesh.points), "xyz": 3} if len(mesh.points) else {}
            )
            out.attrs["source"] = source or "bladetwin model convert"
            made = out.create_variable("run", ("run",), dtype=TEXT)
            made[...] = np.array(labels, dtype=object)
            dims = ("time",) if time_h.ndim == 1 else ("run", "time")
            name = "time" if time_h.ndim == 1 else "time_of_run"
            out.create_variable(name, dims, data=time_h).attrs["units"] = "h"
            for one, column in inputs.items():
                told: dict[str, Any] = {
                    "units": column.unit,
                    "low": column.low,
                    "high": column.high,
                }
                made = out.create_variable(one, ("run",), data=np.asarray(column.values, float))
                made.attrs.update({k: v for k, v in told.items() if v is not None})
            if len(mesh.points):
                _write_mesh(out, mesh)
            for one, given in quantities.items():
                own = DIMENSIONS[given.kind]
                shape = tuple(out.dimensions[d].size for d in own)
                made = out.create_variable(
                    one,
                    ("run", *own),
                    dtype="f8" if given.kind == "scalar" else "f4",
                    chunks=(1, *shape),
                    compression="gzip",
                    compression_opts=1,
                    shuffle=True,
                )
                made.attrs["units"] = given.unit
            for k, row in enumerate(rows):
                for one in quantities:
                    out[one][k] = row[one]

    replace_file(Path(path), fill)


def _write_mesh(out: h5netcdf.File, mesh: Mesh) -> None:
    points = out.create_variable("points", ("node", "xyz"), data=np.asarray(mesh.points, float))
    points.attrs["units"] = "mm"
    if mesh.cells.size:
        out.dimensions.update({"cell": mesh.cells.shape[0], "corner": mesh.cells.shape[1]})
        cells = np.asarray(mesh.cells, dtype=np.int64)
        made = out.create_variable("cells", ("cell", "corner"), data=cells)
        if mesh.kind:
            made.attrs["kind"] = mesh.kind
    out.attrs["named_nodes"] = json.dumps(dict(mesh.named))
