"""Readings by the visits at which they were taken, and what was predicted of them (`residuals`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from core.diagnosis.grammar import Facts
from core.observation import Inspection

Array = NDArray[np.float64]
SAME = 0.02  # share of the longest history within which hours are one visit
MOST = 12  # visits; neighbours are joined beyond


@dataclass(frozen=True, slots=True)
class Residual:
    """A reading against its prediction [unit]; of a scan, one for each of its rows (`part`)."""

    reading: Inspection
    part: int
    visit: int
    hour: float
    y: float
    mean: float
    sd: float
    z: float
    pit: float


@dataclass(frozen=True)
class Visit:
    """Readings that were predicted together; n rows.

    residuals   in the order of (blade, hour, id, part)
    covariance  C of their z, (n, n)
    signal, noise   draws of z: signal + noise · e, (DRAWS, n) each
    health      of the state that predicted them
    """

    residuals: tuple[Residual, ...]
    covariance: Array
    signal: Array
    noise: Array
    health: Mapping[str, object]

    @property
    def z(self) -> Array:
        return np.array([r.z for r in self.residuals])


def visits_of(
    readings: Sequence[Inspection], facts: Mapping[str, Facts], most: int = MOST
) -> list[list[Inspection]]:
    """The readings by visit, in the order of the rotor's hours.

    >>> a, b, c = (Inspection(n, "B", "y", h, [0.0]) for n, h in (("a", 99.0), ("b", 1.0),
    ...     ("c", 100.0)))
    >>> [[r.id for r in visit] for visit in visits_of([a, b, c], {})]
    [['b'], ['a', 'c']]
    """
    hours = np.array([hour_of(r, facts) for r in readings])
    apart = SAME * float(hours.max(initial=0.0))
    found: list[list[Inspection]] = []
    began = -np.inf
    for i in np.lexsort((np.array([r.id for r in readings]), hours)):
        if hours[i] - began > apart:
            began = float(hours[i])
            found.append([])
        found[-1].append(readings[int(i)])
    while len(found) > most:
        sizes = [len(a) + len(b) for a, b in pairwise(found)]
        k = int(np.argmin(sizes))
        found[k : k + 2] = [found[k] + found[k + 1]]
    return found


def hour_of(reading: Inspection, facts: Mapping[str, Facts]) -> float:
    own = facts.get(reading.blade)
    return reading.time_h + (0.0 if own is None else own.offset_h)
