"""The runs of an archive as rows of one matrix, each quantity on a scale of its own.

A row holds every number of a run: quantity after quantity, the components of a vector one after
another, each as (instants, nodes). The paper's six quantities are CEEQ, creep damage, von Mises'
stress and the displacement's three components; curves (the elongation) are numbers of a field's
node and are taken only where there are no fields. Rows are

    a = (x - mean) / scale       mean over the runs, (n,);  scale one number per quantity: its
                                 standard deviation over runs, instants and nodes about the mean

so that strains of 1e-3 and stresses of 100 MPa weigh alike in a joint basis. The paper does not
tell its scaling. At any time as many runs are in memory as `each` says.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.archive import Archive, Quantity
from core.errors import InputError

Array = NDArray[np.float64]
AXES = "xyz"


@dataclass(frozen=True, slots=True)
class Part:
    """One quantity's place in a row: its columns, and its unit."""

    name: str
    unit: str
    columns: slice
    source: str
    component: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RunRows:
    """Rows of `indices` of an archive.

    parts  the quantities, in order of their columns
    mean   (n,) in the quantities' own units
    scale  (parts,) in the quantities' own units
    each   runs in memory at a time
    """

    archive: Archive
    indices: tuple[int, ...]
    parts: tuple[Part, ...]
    mean: Array
    scale: Array
    each: int = 4

    @classmethod
    def of(
        cls,
        archive: Archive,
        indices: Sequence[int],
        quantities: Sequence[str] | None = None,
        *,
        each: int = 4,
    ) -> RunRows:
        """One pass over the runs for their mean and scales.

        quantities  names as in `parts_of`; none: all fields, or all curves where there are none
        """
        if len(indices) < 2:
            raise InputError("indices", list(indices), "are fewer than two runs", "give more runs")
        parts = parts_of(archive, quantities)
        n = parts[-1].columns.stop
        self = cls(archive, tuple(indices), parts, np.zeros(n), np.ones(len(parts)), each)
        mean, square = np.zeros(n), np.zeros(len(parts))
        for count, index in enumerate(indices, 1):
            row = self.raw(index)
            for k, part in enumerate(parts):  # Welford's recurrence
                at = part.columns
                step = row[at] - mean[at]
                mean[at] += step / count
                square[k] += float(step @ (row[at] - mean[at]))
        sizes = np.array([part.columns.stop - part.columns.start for part in parts])
        scale = np.sqrt(square / (len(indices) * sizes))
        return replace(self, mean=mean, scale=np.where(scale > 0, scale, 1.0))

    @property
    def shape(self) -> tuple[int, int]:
        """(runs, numbers of a run)."""
        return len(self.indices), len(self.mean)

    def blocks(self) -> Iterator[Array]:
        """Scaled rows, `each` at a time."""
        for k in range(0, len(self.indices), self.each):
            chosen = self.indices[k : k + self.each]
            block = np.empty((len(chosen), self.shape[1]))
            for row, index in zip(block, chosen, strict=True):
                self.raw(index, row)
                self._scaled(row)
            yield block

    def others(self, indices: Sequence[int]) -> RunRows:
        """Other runs on the same mean and scales."""
        return replace(self, indices=tuple(indices))

    def only(self, name: str) -> RunRows:
        """The same runs of one quantity alone."""
        k = next(k for k, part in enumerate(self.parts) if part.name == name)
        columns = self.parts[k].columns
        alone = replace(self.parts[k], columns=slice(0, columns.stop - columns.start))
        return replace(self, parts=(alone,), mean=self.mean[columns], scale=self.scale[k : k + 1])

    def raw(self, index: int, out: Array | None = None) -> Array:
        """One run's numbers in their own units, (n,)."""
        row = np.empty(self.shape[1]) if out is None else out
        run = self.archive.values(index, {part.source for part in self.parts})
        for part in self.parts:
            values = run[part.source]
            chosen = values if part.component is None else values[..., part.component]
            row[part.columns] = chosen.ravel()
        return row

    def _scaled(self, row: Array) -> None:
        row -= self.mean
        for part, scale in zip(self.parts, self.scale, strict=True):
            row[part.columns] /= scale


def parts_of(archive: Archive, quantities: Sequence[str] | None = None) -> tuple[Part, ...]:
    """The quantities of a row: fields, and each component of a vector as ``displacement_x`` …"""
    declared = archive.declaration
    every: list[tuple[str, Quantity, int | None]] = []
    for one in declared.quantities:
        if one.kind == "vector field":
            every += [(f"{one.name}_{axis}", one, k) for k, axis in enumerate(AXES)]
        else:
            every.append((one.name, one, None))
    fields = [name for name, one, _ in every if one.kind != "scalar"]
    wanted = list(quantities or fields or [name for name, _, _ in every])
    known = {name: (one, k) for name, one, k in every}
    if unknown := [name for name in wanted if name not in known]:
        raise InputError(
            "quantities", unknown, "are not in the archive", f"use some of {', '.join(known)}"
        )
    found: list[Part] = []
    start = 0
    for name in wanted:
        one, component = known[name]
        shape: tuple[Any, ...] = declared.shape(one)
        size = int(np.prod(shape if component is None else shape[:-1]))
        columns = slice(start, start + size)
        found.append(Part(name, one.unit, columns, one.name, component))
        start += size
    return tuple(found)
