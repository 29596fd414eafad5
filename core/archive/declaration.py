"""What the runs of an archive have in common, and what a single run is.

A quantity is a ``scalar`` (T,), a ``field`` (T, N) or a ``vector field`` (T, N, 3) of each run. An
archive of scalars alone has no mesh: N = 0.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError, ModelError, RangeError

SCHEMA = 1
Kind = Literal["scalar", "field", "vector field"]
Floats = NDArray[np.floating[Any]]
DIMENSIONS: dict[str, tuple[str, ...]] = {
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
    """points (N, 3) [mm], cells (E, n) node numbers, parametric (N, 3), and nodes with a name.

    kind  of a user's cells (`core.archive.cells`); "": none that is known
    """

    name: str
    points: Floats
    cells: NDArray[np.integer[Any]]
    parametric: Floats
    named: Mapping[str, int]
    kind: str = ""

    @staticmethod
    def none() -> Mesh:
        """That of an archive of scalars: no nodes."""
        return Mesh("", np.zeros((0, 3)), np.zeros((0, 0), dtype=np.int64), np.zeros((0, 3)), {})


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
            if quantity.kind not in DIMENSIONS:
                raise InputError(
                    f"quantity {quantity.name}",
                    quantity.kind,
                    "is of an unknown kind",
                    f"use one of {', '.join(DIMENSIONS)}",
                )
            if quantity.kind != "scalar" and not self.nodes:
                raise InputError(
                    f"quantity {quantity.name}", quantity.kind, "has no nodes", "give the mesh"
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
        return tuple(full[name] for name in DIMENSIONS[quantity.kind])

    def dimensions(self) -> dict[str, int]:
        """The dimensions of a run's file."""
        found = {"input": len(self.inputs), "time": len(self.time_h)}
        return found | ({"node": self.nodes, "xyz": 3} if self.nodes else {})

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
                f"give {DIMENSIONS[quantity.kind]} = {self.shape(quantity)}",
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
