"""Simulation archive: run x time x node x quantity, in a directory of netCDF files.

::

    archive.json     schema number, inputs with bounds, quantities with unit and kind, instants,
                     named nodes, mesh name, seed, command
    mesh.nc          points (N, 3) [mm], cells (E, n), parametric coordinates (N, 3)
    run-0007.nc      one file per run: inputs (d,), fields (T, N) and (T, N, 3) float32,
                     scalars (T,) float64

Each file is written under a temporary name, flushed to the disk and renamed, so a killed write
leaves nothing half-done and a campaign resumes from `Archive.done`. `to_netcdf` packs the whole
archive into one file for transport and `from_netcdf` unpacks it; both keep one run in memory.
A user's own runs are written with the same calls and pass the same checks: an error names the
run, the quantity, the instant and the node.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import h5netcdf
import numpy as np
from numpy.typing import NDArray

from core.errors import InputError, ModelError, RangeError

SCHEMA = 1
Kind = Literal["scalar", "field", "vector field"]
Floats = NDArray[np.floating[Any]]
_DIMENSIONS: dict[str, tuple[str, ...]] = {
    "scalar": ("time",),
    "field": ("time", "node"),
    "vector field": ("time", "node", "xyz"),
}


@dataclass(frozen=True, slots=True)
class Input:
    """An input of the simulation and the interval its runs cover."""

    name: str
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Quantity:
    """A result: its unit, and whether it is a curve, a field or a field of vectors."""

    name: str
    unit: str
    kind: Kind


BLADE_QUANTITIES = (
    Quantity("ceeq", "1", "field"),
    Quantity("creep_damage", "1", "field"),
    Quantity("mises", "MPa", "field"),
    Quantity("displacement", "mm", "vector field"),
    Quantity("elongation", "mm", "scalar"),
)


@dataclass(frozen=True, slots=True)
class Mesh:
    """points (N, 3) [mm], cells (E, n) node numbers, parametric (N, 3), and nodes with a name."""

    name: str
    points: Floats
    cells: NDArray[np.integer[Any]]
    parametric: Floats
    named: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class Run:
    """One simulation: inputs by name, and per quantity the array (T,), (T, N) or (T, N, 3)."""

    inputs: Mapping[str, float]
    values: Mapping[str, Floats]


@dataclass(frozen=True, slots=True)
class Declaration:
    """What every run of an archive has in common (the content of ``archive.json``).

    `code` is a digest of the program that makes the runs (empty: not known). An archive begun
    with one code does not go on with another.
    """

    inputs: tuple[Input, ...]
    quantities: tuple[Quantity, ...]
    time_h: tuple[float, ...]
    mesh: str
    nodes: int
    named: Mapping[str, int]
    seed: int
    command: str
    code: str = ""
    schema: int = SCHEMA

    def __post_init__(self) -> None:
        time = np.asarray(self.time_h, dtype=float)
        if time.ndim != 1 or len(time) < 4 or time[0] != 0.0:
            raise InputError(
                "time_h",
                self.time_h[:4],
                "does not start at 0 or has fewer than four instants",
                "give the instants in operating hours, the first one 0 (the loaded, uncrept blade)",
            )
        step = np.diff(time)
        if not np.all(np.isfinite(time)) or np.any(step <= 0):
            k = int(np.flatnonzero(~(step > 0))[0]) + 1
            raise InputError(
                f"time_h[{k}]", self.time_h[k], "does not increase", "sort the instants"
            )
        for item in self.inputs:
            if not (np.isfinite(item.low) and np.isfinite(item.high) and item.low < item.high):
                raise InputError(
                    f"input {item.name}",
                    (item.low, item.high),
                    "is not an interval",
                    "give finite bounds with low < high",
                )
        for quantity in self.quantities:
            if quantity.kind not in _DIMENSIONS:
                raise InputError(
                    f"quantity {quantity.name}",
                    quantity.kind,
                    "is of an unknown kind",
                    f"use one of {', '.join(_DIMENSIONS)}",
                )
        names = [item.name for item in self.inputs] + [item.name for item in self.quantities]
        if len(set(names)) < len(names):
            raise InputError(
                "names", names, "has a name twice", "name each input and quantity once"
            )
        for name, node in self.named.items():
            if not 0 <= node < self.nodes:
                raise RangeError(
                    f"named node {name}", node, f"is not in 0 … {self.nodes - 1}", "use a mesh node"
                )

    def shape(self, quantity: Quantity) -> tuple[int, ...]:
        """Shape of one run's array of a quantity."""
        full = {"time": len(self.time_h), "node": self.nodes, "xyz": 3}
        return tuple(full[name] for name in _DIMENSIONS[quantity.kind])

    def dimensions(self) -> dict[str, int]:
        """The dimensions of a run's file."""
        time, inputs = len(self.time_h), len(self.inputs)
        return {"input": inputs, "time": time, "node": self.nodes, "xyz": 3}

    def check(self, index: int, run: Run) -> None:
        """Refuse a run that does not fit, naming run, quantity, instant and node."""
        names = {item.name for item in self.inputs}
        if set(run.inputs) != names:
            odd = sorted(set(run.inputs) ^ names)
            raise InputError(
                f"run {index}: inputs",
                odd,
                "are missing or unknown",
                f"give exactly {sorted(names)}",
            )
        for item in self.inputs:
            value = float(run.inputs[item.name])
            slack = 1e-9 * (item.high - item.low)
            if not item.low - slack <= value <= item.high + slack:
                raise RangeError(
                    f"run {index}: {item.name}",
                    value,
                    f"lies outside {item.low} … {item.high}",
                    "drop the run or widen the archive's bounds",
                )
        known = {quantity.name for quantity in self.quantities}
        if set(run.values) != known:
            odd = sorted(set(run.values) ^ known)
            raise InputError(
                f"run {index}: quantities", odd, "are missing or unknown", f"give {sorted(known)}"
            )
        for quantity in self.quantities:
            self._check_values(index, quantity, np.asarray(run.values[quantity.name]))

    def _check_values(self, index: int, quantity: Quantity, values: Floats) -> None:
        what = f"run {index}: {quantity.name}"
        if values.shape != self.shape(quantity):
            raise InputError(
                what,
                values.shape,
                "is the wrong shape",
                f"give {_DIMENSIONS[quantity.kind]} = {self.shape(quantity)}",
            )
        if not np.all(np.isfinite(values)):
            where = tuple(int(k) for k in np.argwhere(~np.isfinite(values))[0])
            place = f"at {self.time_h[where[0]]:g} h"
            if len(where) > 1:
                place += f", node {where[1]}"
            raise InputError(
                what,
                float(values[where]),
                f"is not finite {place}",
                "repeat the run or leave it out",
            )

    def to_json(self) -> str:
        """The declaration as JSON text."""
        return json.dumps(asdict(self) | {"named": dict(self.named)}, indent=1)

    @classmethod
    def from_json(cls, text: str) -> Declaration:
        """The inverse of `to_json`; another schema or a missing key is a ModelError."""
        try:
            raw = json.loads(text)
            if raw["schema"] != SCHEMA:
                raise ModelError(f"archive schema {raw['schema']} is not {SCHEMA}: write it again")
            raw["inputs"] = tuple(Input(**item) for item in raw["inputs"])
            raw["quantities"] = tuple(Quantity(**item) for item in raw["quantities"])
            raw["time_h"] = tuple(float(t) for t in raw["time_h"])
            return cls(**raw)
        except (ValueError, KeyError, TypeError) as error:
            raise ModelError(f"the archive's declaration cannot be read: {error!r}") from error


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

        _replace(path / "mesh.nc", fill)
        _replace(path / "archive.json", lambda name: name.write_text(declaration.to_json()))
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
        with _opened(self.path / "mesh.nc") as data:
            return Mesh(
                self.declaration.mesh,
                data["points"][...],
                data["cells"][...],
                data["parametric"][...],
                self.declaration.named,
            )

    def file(self, index: int) -> Path:
        """Where run `index` lies."""
        return self.path / f"run-{index:04d}.nc"

    def write(self, index: int, run: Run) -> None:
        """Check a run and store it; a run of the same index is replaced."""
        if index < 0:
            raise RangeError("index", index, "is negative", "number the runs from 0")
        self.declaration.check(index, run)
        declared = self.declaration

        def fill(name: Path) -> None:
            with h5netcdf.File(name, "w") as out:
                out.dimensions = declared.dimensions()
                inputs = np.array([float(run.inputs[item.name]) for item in declared.inputs])
                out.create_variable("inputs", ("input",), data=inputs)
                for quantity in declared.quantities:
                    _variable(out, quantity)[...] = run.values[quantity.name]

        _replace(self.file(index), fill)

    def done(self) -> tuple[int, ...]:
        """Indices of the runs that are present and can be opened, ascending."""
        found = []
        for file in sorted(self.path.glob("run-*.nc")):
            try:
                with _opened(file) as data:
                    if "inputs" in data.variables:
                        found.append(int(file.stem.removeprefix("run-")))
            except (ModelError, ValueError):
                continue
        return tuple(found)

    def inputs(self, indices: Sequence[int] | None = None) -> NDArray[np.float64]:
        """Inputs of the runs, (n, d), in the order of `indices` (default `done`)."""
        rows = []
        for index in self.done() if indices is None else indices:
            with _opened(self.file(index)) as data:
                rows.append(np.asarray(data["inputs"][...], dtype=float))
        return np.array(rows).reshape(len(rows), len(self.declaration.inputs))

    def read(self, index: int) -> Run:
        """One run."""
        names = [item.name for item in self.declaration.inputs]
        with _opened(self.file(index)) as data:
            inputs = dict(zip(names, map(float, data["inputs"][...]), strict=True))
            return Run(inputs, {q.name: data[q.name][...] for q in self.declaration.quantities})

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
            with _opened(self.file(index)) as data:
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
                _write_mesh(out, mesh)
                out.create_variable("index", ("run",), data=np.array(done, dtype=np.int64))
                out.create_variable("inputs", ("run", "input"), data=self.inputs(done))
                for quantity in declared.quantities:
                    variable = _variable(out, quantity, runs=True)
                    for k, index in enumerate(done):
                        variable[k] = self.read(index).values[quantity.name]

        _replace(Path(path), fill)

    @classmethod
    def from_netcdf(cls, path: str | Path, directory: str | Path) -> Archive:
        """Unpack a file of `to_netcdf` into `directory`; every run is checked again."""
        with _opened(Path(path)) as packed:
            needed = {"points", "cells", "parametric", "index", "inputs"}
            if "declaration" not in packed.attrs or not needed <= set(packed.variables):
                raise ModelError(f"{path} holds no packed archive (no declaration, mesh or inputs)")
            declared = Declaration.from_json(str(packed.attrs["declaration"]))
            missing = {q.name for q in declared.quantities} - set(packed.variables)
            if missing:
                raise ModelError(f"{path} declares {sorted(missing)} and does not hold them")
            archive = cls.create(
                directory,
                inputs=declared.inputs,
                quantities=declared.quantities,
                time_h=declared.time_h,
                mesh=Mesh(
                    declared.mesh,
                    packed["points"][...],
                    packed["cells"][...],
                    packed["parametric"][...],
                    declared.named,
                ),
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


def _write_mesh(out: h5netcdf.File, mesh: Mesh) -> None:
    out.dimensions.update({"cell": mesh.cells.shape[0], "corner": mesh.cells.shape[1]})
    out.create_variable("points", ("node", "xyz"), data=np.asarray(mesh.points, dtype=float))
    out.create_variable("cells", ("cell", "corner"), data=np.asarray(mesh.cells, dtype=np.int64))
    parametric = np.asarray(mesh.parametric, dtype=float)
    out.create_variable("parametric", ("node", "xyz"), data=parametric)


def _variable(out: h5netcdf.File, quantity: Quantity, *, runs: bool = False) -> Any:
    """A compressed variable, one chunk per run."""
    names = _DIMENSIONS[quantity.kind]
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


def _opened(path: Path) -> h5netcdf.File:
    try:
        return h5netcdf.File(path, "r")
    except (OSError, ValueError) as error:
        raise ModelError(f"{path} cannot be read as netCDF: {error}") from error


def _replace(path: Path, fill: Callable[[Path], object]) -> None:
    """Write under a temporary name, flush to the disk, rename."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        fill(part)
        with open(part, "rb") as handle:
            os.fsync(handle.fileno())
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
