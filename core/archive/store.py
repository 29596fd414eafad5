"""Simulation archive: run x time x node x quantity, in a directory of netCDF files.

::

    archive.json     schema number, inputs with bounds, quantities with unit and kind, instants,
                     named nodes, mesh name, seed, command
    mesh.nc          points (N, 3) [mm], cells (E, n), parametric coordinates (N, 3)
    run-0007.nc      one file per run: inputs (d,), fields (T, N) and (T, N, 3) float32,
                     scalars (T,) float64

A killed write leaves nothing half-done (`core.archive.disk`), and a campaign resumes from
`Archive.done`. Several workers share one archive by `core.archive.shared`; their runs appear by
`Archive.add`, and the first one stays. `to_netcdf` packs the whole archive into one file for
transport and `from_netcdf` unpacks it; both keep one run in memory. An error names the run, the
quantity, the instant and the node. Archives of scalars have no mesh.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from core.archive.declaration import (
    BLADE_QUANTITIES,
    Declaration,
    Floats,
    Input,
    Mesh,
    Quantity,
    Run,
)
from core.archive.disk import first_file, flush, link_file, part_of, replace_file
from core.archive.layout import created, mesh_of, opened, run_of, variable_of, write_mesh, write_run
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
        """Start an archive, or go on with one whose declaration is the same.

        Of several who start different ones in one place at a time the first has it.
        """
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
        path.mkdir(parents=True, exist_ok=True)
        told, drawn = path / "archive.json", path / "mesh.nc"
        text = declaration.to_json()
        first = not told.exists() and first_file(told, lambda name: name.write_text(text))
        if not first and (present := cls.open(path)).declaration != declaration:
            old, new = asdict(present.declaration), asdict(declaration)
            odd = ", ".join(name for name in new if new[name] != old[name])
            raise ModelError(f"{path} holds another archive ({odd}): choose an empty directory")

        def fill(name: Path) -> None:
            with created(name) as out:
                out.dimensions = {"node": len(mesh.points), "xyz": 3}
                write_mesh(out, mesh)

        if len(mesh.points) and (first or not drawn.exists()):  # who was first may be killed here
            replace_file(drawn, fill)
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
        replace_file(self.file(index), lambda name: write_run(name, self.declaration, run))

    def add(self, index: int, run: Run) -> bool:
        """Check a run and store it, unless one of this index is there; whether it was stored."""
        if index < 0:
            raise RangeError("index", index, "is negative", "number the runs from 0")
        self.declaration.check(index, run)
        file = self.file(index)
        part = part_of(file)
        try:
            write_run(part, self.declaration, run)
            flush(part)
            first = link_file(part, file)
        except OSError:  # HDF5 has words of its own for a file that is gone
            if part.exists() or not file.exists():
                raise
            first = False  # swept away below, by the one who was first
        finally:
            part.unlink(missing_ok=True)
        for left in self.path.glob(f".{file.name}.*.part"):
            left.unlink(missing_ok=True)
        return first

    def done(self) -> tuple[int, ...]:
        """Indices of the runs that are present and can be opened, ascending."""
        found = []
        for file in self.path.glob("run-*.nc"):
            try:
                with opened(file) as data:
                    if "inputs" in data.variables:
                        found.append(int(file.stem.removeprefix("run-")))
            except (ModelError, ValueError):
                continue
        return tuple(sorted(found))

    def inputs(self, indices: Sequence[int] | None = None) -> NDArray[np.float64]:
        """Inputs of the runs, (n, d), in the order of `indices` (default `done`)."""
        rows = []
        for index in self.done() if indices is None else indices:
            with opened(self.file(index)) as data:
                rows.append(np.asarray(data["inputs"][...], dtype=float))
        return np.array(rows).reshape(len(rows), len(self.declaration.inputs))

    def read(self, index: int) -> Run:
        """One run."""
        with opened(self.file(index)) as data:
            return run_of(data, self.declaration)

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
            with created(name) as out:
                out.attrs["declaration"] = declared.to_json()
                out.dimensions = {"run": len(done), **declared.dimensions()}
                if declared.nodes:
                    write_mesh(out, mesh)
                out.create_variable("index", ("run",), data=np.array(done, dtype=np.int64))
                out.create_variable("inputs", ("run", "input"), data=self.inputs(done))
                for quantity in declared.quantities:
                    variable = variable_of(out, quantity, runs=True)
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
