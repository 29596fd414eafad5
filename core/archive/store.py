"""Simulation archive: run x time x node x quantity, in a directory of netCDF files.

::

    archive.json     schema number, inputs with bounds, quantities with unit and kind, instants,
                     named nodes, mesh name, seed, command
    mesh.nc          points (N, 3) [mm], cells (E, n), parametric coordinates (N, 3)
    run-0007.nc      one file per run: inputs (d,), fields (T, N) and (T, N, 3) float32,
                     scalars (T,) float64

Each file is written under a temporary name, flushed to the disk and renamed, so a killed write
leaves nothing half-done and a campaign resumes from `Archive.done`. Several workers share one
archive by `core.archive.shared`; their runs appear by `Archive.add`, and the first one stays.
`to_netcdf` packs the whole archive into one file for transport and `from_netcdf` unpacks it; both
keep one run in memory. An error names the run, the quantity, the instant and the node. Archives of
scalars have no mesh.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from uuid import uuid4

import h5netcdf
import numpy as np
from numpy.typing import NDArray

from core.archive.declaration import (
    BLADE_QUANTITIES,
    DIMENSIONS,
    Declaration,
    Floats,
    Input,
    Mesh,
    Quantity,
    Run,
)
from core.errors import InputError, ModelError, RangeError


@dataclass(frozen=True, slots=True)
class Archive:
    """A directory of runs. Make one with `create`, `open` or `from_netcdf`."""

    path: Path
    declaration: Declaration

    @classmethod
    def create(
        cls,
        path: str | Path,
        *,
        inputs: Sequence[Input],
        time_h: Sequence[float] | Floats,
        mesh: Mesh,
        seed: int,
        command: str,
        code: str = "",
        quantities: Sequence[Quantity] = BLADE_QUANTITIES,
    ) -> Archive:
        """Start an archive, or go on with one whose declaration is the same."""
        path = Path(path)
        declaration = Declaration(
            inputs=tuple(inputs),
            quantities=tuple(quantities),
            time_h=tuple(float(t) for t in time_h),
            mesh=mesh.name,
            nodes=len(mesh.points),
            named={str(name): int(node) for name, node in mesh.named.items()},
            seed=seed,
            command=command,
            code=code,
        )
        if (path / "archive.json").exists():
            present = cls.open(path)
            if present.declaration != declaration:
                old, new = asdict(present.declaration), asdict(declaration)
                odd = ", ".join(name for name in new if new[name] != old[name])
                raise ModelError(f"{path} holds another archive ({odd}): choose an empty directory")
            return present
        path.mkdir(parents=True, exist_ok=True)

        def fill(name: Path) -> None:
            with h5netcdf.File(name, "w") as out:
                out.dimensions = {"node": len(mesh.points), "xyz": 3}
                _write_mesh(out, mesh)

        if len(mesh.points):
            replace_file(path / "mesh.nc", fill)
        replace_file(path / "archive.json", lambda name: name.write_text(declaration.to_json()))
        return cls(path, declaration)

    @classmethod
    def open(cls, path: str | Path) -> Archive:
        """An archive that exists."""
        path = Path(path)
        try:
            text = (path / "archive.json").read_text()
        except OSError as error:
            raise ModelError(f"{path} is no archive: archive.json cannot be read") from error
        return cls(path, Declaration.from_json(text))

    def mesh(self) -> Mesh:
        """The mesh all runs share."""
        if not self.declaration.nodes:
            return Mesh.none()
        with opened(self.path / "mesh.nc") as data:
            return mesh_of(data, self.declaration)

    def file(self, index: int) -> Path:
        """Where run `index` lies."""
        return self.path / f"run-{index:04d}.nc"

    def write(self, index: int, run: Run) -> None:
        """Check a run and store it; a run of the same index is replaced."""
        if index < 0:
            raise RangeError("index", index, "is negative", "number the runs from 0")
        self.declaration.check(index, run)
        replace_file(self.file(index), lambda name: self._fill(name, run))

    def add(self, index: int, run: Run) -> bool:
        """Check a run and store it, unless one of this index is there; whether it was stored."""
        if index < 0:
            raise RangeError("index", index, "is negative", "number the runs from 0")
        self.declaration.check(index, run)
        file = self.file(index)
        part = _part(file)
        try:
            self._fill(part, run)
            _flush(part)
            first = link_file(part, file)
        except FileNotFoundError:
            if not file.exists():
                raise
            first = False  # swept away below, by the one who was first
        finally:
            part.unlink(missing_ok=True)
        for left in self.path.glob(f".{file.name}.*.part"):
            left.unlink(missing_ok=True)
        return first

    def _fill(self, name: Path, run: Run) -> None:
        declared = self.declaration
        with h5netcdf.File(name, "w") as out:
            out.dimensions = declared.dimensions()
            inputs = np.array([float(run.inputs[item.name]) for item in declared.inputs])
            out.create_variable("inputs", ("input",), data=inputs)
            for quantity in declared.quantities:
                _variable(out, quantity)[...] = run.values[quantity.name]

    def done(self) -> tuple[int, ...]:
        """Indices of the runs that are present and can be opened, ascending."""
        found = []
        for file in sorted(self.path.glob("run-*.nc")):
            try:
                with opened(file) as data:
                    if "inputs" in data.variables:
                        found.append(int(file.stem.removeprefix("run-")))
            except (ModelError, ValueError):
                continue
        return tuple(found)

    def inputs(self, indices: Sequence[int] | None = None) -> NDArray[np.float64]:
        """Inputs of the runs, (n, d), in the order of `indices` (default `done`)."""
        rows = []
        for index in self.done() if indices is None else indices:
            with opened(self.file(index)) as data:
                rows.append(np.asarray(data["inputs"][...], dtype=float))
        return np.array(rows).reshape(len(rows), len(self.declaration.inputs))

    def read(self, index: int) -> Run:
        """One run."""
        names = [item.name for item in self.declaration.inputs]
        with opened(self.file(index)) as data:
            inputs = dict(zip(names, map(float, data["inputs"][...]), strict=True))
            return Run(inputs, {q.name: data[q.name][...] for q in self.declaration.quantities})

    def values(self, index: int, quantities: Collection[str]) -> dict[str, Floats]:
        """Some quantities of one run: the others are not read."""
        with opened(self.file(index)) as data:
            return {name: data[name][...] for name in quantities}

    def runs(self) -> Iterator[tuple[int, Run]]:
        """All runs in turn; only one is in memory."""
        for index in self.done():
            yield index, self.read(index)

    def stack(self, quantity: str, indices: Sequence[int]) -> Floats:
        """One quantity of several runs, (n, T, …)."""
        if quantity not in {q.name for q in self.declaration.quantities}:
            raise InputError(
                "quantity",
                quantity,
                "is not in the archive",
                f"use one of {', '.join(q.name for q in self.declaration.quantities)}",
            )
        rows = []
        for index in indices:
            with opened(self.file(index)) as data:
                rows.append(data[quantity][...])
        return np.stack(rows)

    def to_netcdf(self, path: str | Path) -> None:
        """Pack the archive into one file with a leading dimension ``run``."""
        done = self.done()
        declared = self.declaration
        mesh = self.mesh()

        def fill(name: Path) -> None:
            with h5netcdf.File(name, "w") as out:
                out.attrs["declaration"] = declared.to_json()
                out.dimensions = {"run": len(done), **declared.dimensions()}
                if declared.nodes:
                    _write_mesh(out, mesh)
                out.create_variable("index", ("run",), data=np.array(done, dtype=np.int64))
                out.create_variable("inputs", ("run", "input"), data=self.inputs(done))
                for quantity in declared.quantities:
                    variable = _variable(out, quantity, runs=True)
                    for k, index in enumerate(done):
                        variable[k] = self.read(index).values[quantity.name]

        replace_file(Path(path), fill)

    @classmethod
    def from_netcdf(cls, path: str | Path, directory: str | Path) -> Archive:
        """Unpack a file of `to_netcdf` into `directory`; every run is checked again."""
        with opened(Path(path)) as packed:
            if "declaration" not in packed.attrs or not {"index", "inputs"} <= set(
                packed.variables
            ):
                raise ModelError(f"{path} holds no packed archive (no declaration or inputs)")
            declared = Declaration.from_json(str(packed.attrs["declaration"]))
            needed = {"points", "cells", "parametric"} if declared.nodes else set()
            missing = (needed | {q.name for q in declared.quantities}) - set(packed.variables)
            if missing:
                raise ModelError(f"{path} declares {sorted(missing)} and does not hold them")
            archive = cls.create(
                directory,
                inputs=declared.inputs,
                quantities=declared.quantities,
                time_h=declared.time_h,
                mesh=mesh_of(packed, declared),
                seed=declared.seed,
                command=declared.command,
                code=declared.code,
            )
            names = [item.name for item in declared.inputs]
            for k, index in enumerate(packed["index"][...]):
                inputs = dict(zip(names, map(float, packed["inputs"][k]), strict=True))
                values = {q.name: packed[q.name][k] for q in declared.quantities}
                archive.write(int(index), Run(inputs, values))
        return archive


def mesh_of(data: h5netcdf.File, declared: Declaration) -> Mesh:
    """The mesh in a file of this module."""
    if not declared.nodes:
        return Mesh.none()
    points, cells, parametric = (data[name][...] for name in ("points", "cells", "parametric"))
    return Mesh(declared.mesh, points, cells, parametric, declared.named)


def _write_mesh(out: h5netcdf.File, mesh: Mesh) -> None:
    out.dimensions.update({"cell": mesh.cells.shape[0], "corner": mesh.cells.shape[1]})
    out.create_variable("points", ("node", "xyz"), data=np.asarray(mesh.points, dtype=float))
    out.create_variable("cells", ("cell", "corner"), data=np.asarray(mesh.cells, dtype=np.int64))
    parametric = np.asarray(mesh.parametric, dtype=float)
    out.create_variable("parametric", ("node", "xyz"), data=parametric)


def _variable(out: h5netcdf.File, quantity: Quantity, *, runs: bool = False) -> Any:
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
    """A netCDF file for reading; ModelError where it is none."""
    try:
        return h5netcdf.File(path, "r")
    except (OSError, ValueError) as error:
        raise ModelError(f"{path} cannot be read as netCDF: {error}") from error


def replace_file(path: Path, fill: Callable[[Path], object]) -> None:
    """Write under a temporary name, flush to the disk, rename."""
    part = _part(path)
    try:
        fill(part)
        _flush(part)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def link_file(part: Path, path: Path) -> bool:
    """Give a file a second name that must not exist; False if it does.

    On NFS a call may succeed and its answer be lost; repeated, it says that the name exists. Then
    the number of links tells whose it is.
    """
    try:
        os.link(part, path)
    except FileExistsError:
        return os.stat(part).st_nlink == 2
    except FileNotFoundError:
        raise
    except OSError as error:
        raise ModelError(
            f"{path.parent} has no hard links ({error.strerror}): several workers cannot share "
            "it. Put the archive on a local disk or on NFS"
        ) from error
    return True


def _part(path: Path) -> Path:
    """A name of one's own, on whichever machine."""
    return path.with_name(f".{path.name}.{uuid4().hex}.part")


def _flush(path: Path) -> None:
    with open(path, "rb") as handle:
        os.fsync(handle.fileno())
