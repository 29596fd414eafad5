"""Blades that were read of the same things, each at hours of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.diagnosis.moving import Physics
from core.diagnosis.scores import Scores
from core.drift import Drift
from core.observation import Inspection

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Kind:
    """What is read: a quantity at nodes as in `reading`, or a scan by its `modes` (Q, B)."""

    reading: Inspection
    modes: Array | None

    @property
    def key(self) -> tuple[object, ...]:
        if self.modes is not None:
            return ("scan", self.modes.tobytes())
        nodes = self.reading.nodes
        return (self.reading.quantity, None if nodes is None else tuple(nodes))


@dataclass(frozen=True)
class Alike:
    """Blades that run alike and were read of the same kinds, each at hours of its own.

    blades  their places, (b,); hours: of each, (b, T), NaN where it has fewer
    rows    by kind: blade among these, place among its hours, its rows from this one on
    """

    blades: tuple[int, ...]
    drifts: tuple[Drift, ...]
    kinds: tuple[Kind, ...]
    hours: Array
    rows: tuple[tuple[tuple[int, int, int], ...], ...]


def read_alike(physics: Physics, seen: Scores) -> list[Alike]:
    """The blades, those together that run alike and were read of the same kinds."""
    read: dict[int, dict[tuple[object, ...], tuple[Kind, list[int]]]] = {}
    for b, i in np.argwhere(seen.real).tolist():
        place = int(seen.place[b, i])
        mixing = seen.rows[b].mixings.get(place)
        if mixing is not None and i > 0 and seen.place[b, i - 1] == place:
            continue  # a scan's first row stands for all
        kind = Kind(seen.reading(b, i), None if mixing is None else mixing.modes)
        read.setdefault(b, {}).setdefault(kind.key, (kind, []))[1].append(i)
    groups: dict[tuple[tuple[Drift, ...], frozenset[object]], list[int]] = {}
    for b, kinds in read.items():
        runs = physics.drifts(seen.blades[b])
        groups.setdefault((runs, frozenset(kinds)), []).append(b)
    found = []
    for (drifts, _), blades in groups.items():
        own = [np.unique(seen.hours[b][seen.real[b]]) for b in blades]
        hours = np.full((len(blades), max(map(len, own))), np.nan)
        for row, at in zip(hours, own, strict=True):
            row[: len(at)] = at
        of_first = read[blades[0]]
        rows = tuple(
            tuple(
                (n, int(np.searchsorted(own[n], seen.hours[b, i])), i)
                for n, b in enumerate(blades)
                for i in read[b][key][1]
            )
            for key in of_first
        )
        kinds_ = tuple(kind for kind, _ in of_first.values())
        found.append(Alike(tuple(blades), drifts, kinds_, hours, rows))
    return found
