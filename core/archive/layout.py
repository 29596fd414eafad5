"""How an archive's netCDF files are laid out: mesh, runs and variables, of one run or of all."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from core.archive.declaration import DIMENSIONS, Declaration, Mesh, Quantity, Run
from core.errors import ModelError

if TYPE_CHECKING:  # whoever loads a built model has this module, and reads no netCDF
    import h5netcdf


def mesh_of(data: h5netcdf.File, declared: Declaration) -> Mesh:
    """The mesh in a file of `write_mesh`."""
    if not declared.nodes:
        return Mesh.none()
    points, cells, parametric = (data[name][...] for name in ("points", "cells", "parametric"))
    kind = str(data["cells"].attrs.get("kind", ""))
    return Mesh(declared.mesh, points, cells, parametric, declared.named, kind)


def write_mesh(out: h5netcdf.File, mesh: Mesh) -> None:
    out.dimensions.update({"cell": mesh.cells.shape[0], "corner": mesh.cells.shape[1]})
    out.create_variable("points", ("node", "xyz"), data=np.asarray(mesh.points, dtype=float))
    cells = np.asarray(mesh.cells, dtype=np.int64)
    made = out.create_variable("cells", ("cell", "corner"), data=cells)
    if mesh.kind:
        made.attrs["kind"] = mesh.kind
    parametric = np.asarray(mesh.parametric, dtype=float)
    out.create_variable("parametric", ("node", "xyz"), data=parametric)


def run_of(data: h5netcdf.File, declared: Declaration) -> Run:
    """The run in a file of `write_run`."""
    names = [item.name for item in declared.inputs]
    inputs = dict(zip(names, map(float, data["inputs"][...]), strict=True))
    return Run(inputs, {q.name: data[q.name][...] for q in declared.quantities})


def write_run(name: Path, declared: Declaration, run: Run) -> None:
    """A new file with one run: its inputs, and each quantity as a variable."""
    with created(name) as out:
        out.dimensions = declared.dimensions()
        inputs = np.array([float(run.inputs[item.name]) for item in declared.inputs])
        out.create_variable("inputs", ("input",), data=inputs)
        for quantity in declared.quantities:
            variable_of(out, quantity)[...] = run.values[quantity.name]


def variable_of(out: h5netcdf.File, quantity: Quantity, *, runs: bool = False) -> Any:
    """A compressed variable, one chunk per run."""
    names = DIMENSIONS[quantity.kind]
    shape = tuple(out.dimensions[name].size for name in names)
    made = out.create_variable(
        quantity.name,
        ("run", *names) if runs else names,
        dtype="f8" if quantity.kind == "scalar" else "f4",
        chunks=(1, *shape) if runs else shape,
        compression="gzip",
        compression_opts=1,
        shuffle=True,
    )
    made.attrs["units"] = quantity.unit
    return made


def opened(path: Path) -> h5netcdf.File:
    """A netCDF file for reading; ModelError where it is none, or where its bytes are damaged."""
    import h5netcdf
    import h5py

    try:
        with h5py.File(path, "r") as file:  # whose end h5netcdf's object cannot bear half made
            file.attrs.get("_nc3_strict")
        return h5netcdf.File(path, "r")
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise ModelError(f"{path} cannot be read as netCDF: {error}") from error


def created(path: Path) -> h5netcdf.File:
    """A new netCDF file, for writing."""
    import h5netcdf

    return h5netcdf.File(path, "w")
