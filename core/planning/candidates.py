"""Inspections that could be made.

A candidate is one reading of one blade at an hour to come, by an instrument, in a campaign of its
own (those that were are over). What a calibrated model expects it to read: `core.planning.ahead`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from statistics import median
from typing import Any

import numpy as np

from core.errors import InputError
from core.model import Model
from core.network import Quantity
from core.observation import Inspection

AHEAD = (0.0, 0.5, 1.0, 2.0)  # of the usual interval: now, before the next visit, at it, after it
UNREAD = 0.16  # of a model's hours: the interval of blades that were never read
ANOTHER = "another"  # an instrument that is none of those that read
MOST = 48  # hours of all candidates, beyond which they lie at common ones
PART = 8  # of the usual interval: from one of those to the next


@dataclass(frozen=True, slots=True)
class Candidate:
    """One reading that could be taken.

    time_h      blade's hours; ahead_h: from the blade's latest reading on, or a little less
    instrument  None: as readings name none; `ANOTHER`: one that has not read this rotor yet
    sigma       its noise, where readings give theirs [unit]; None: as calibrated
    """

    blade: str
    quantity: str
    time_h: float
    ahead_h: float
    instrument: str | None = None
    sigma: float | None = None

    def to_json(self) -> dict[str, Any]:
        """A plain dictionary."""
        return asdict(self)


def candidates(
    model: Model,
    blades: Sequence[str],
    readings: Sequence[Inspection],
    ahead_h: Sequence[float] | None = None,
) -> tuple[Candidate, ...]:
    """Every blade × hour × quantity × instrument; left out are 3-D scans, and quantities that the
    network declares and the surrogate has no answer for.

    Hours count from the blade's latest reading (of a blade without one from zero) as far as the
    model reaches; where none are given, by the interval at which blades are read (`AHEAD`): users'
    models may cover ten hours or a million. Instruments are those that read the quantity, and
    another one.
    """
    interval = usual_interval_h(readings)
    latest: dict[str, float] = {}
    for r in readings:
        latest[r.blade] = max(latest.get(r.blade, 0.0), r.time_h)
    found = []
    for q in model.network.quantities:
        if q.kind == "vector" or not answers(model, q):
            continue
        own = [r for r in readings if r.quantity == q.name]
        used = sorted({r.instrument for r in own if r.instrument is not None})
        told = [r.sigma for r in own if r.sigma is not None]
        sigma = float(median(told)) if told and len(told) == len(own) else None
        horizon = model.part(q.name).horizon_h
        step = UNREAD * horizon if interval is None else interval
        ahead = [share * step for share in AHEAD] if ahead_h is None else ahead_h
        for (blade, later), hour in to_come(latest, blades, ahead, step, horizon).items():
            found += [
                Candidate(blade, q.name, hour, later, name, sigma)
                for name in (*used, ANOTHER if used else None)
            ]
    return tuple(found)


def to_come(
    latest: Mapping[str, float],
    blades: Sequence[str],
    ahead: Sequence[float],
    step: float,
    horizon: float,
) -> dict[tuple[str, float], float]:
    """Hours of each blade and time ahead, as far as the model reaches.

    What a model with an effect answers is compiled hour by hour (`core.planning.ready`). Where
    blades were read at hours of their own, so that there are more than `MOST`, they lie at the next
    `PART` of the usual interval: nobody knows the hour of an inspection to come any better.

    >>> to_come({"a": 7.0}, ["a", "b"], [0.0, 4.0], 8.0, 10.0)
    {('a', 0.0): 7.0, ('b', 4.0): 4.0}
    >>> many = {str(i): 100 + i / 9 for i in range(90)}
    >>> sorted(set(to_come(many, list(many), [0.0], 16.0, 109.0).values()))
    [100.0, 102.0, 104.0, 106.0, 108.0, 109.0]
    """
    hours = {(b, float(a)): latest.get(b, 0.0) + float(a) for b in blades for a in ahead}
    hours = {which: hour for which, hour in hours.items() if 0 < hour <= horizon}
    if len(set(hours.values())) > MOST:
        part = step / PART
        for which, hour in hours.items():
            hours[which] = min(part * math.ceil(hour / part - 1e-9), horizon)
    return hours


def usual_interval_h(readings: Sequence[Inspection]) -> float | None:
    """The median of the hours between readings of a blade one after the other; where no blade was
    read twice, of the hours until it was read; None where none was.

    >>> at = [("a", 8e3), ("a", 16e3), ("a", 16e3), ("b", 2e4), ("b", 28e3), ("b", 4e4)]
    >>> given = [Inspection(str(i), b, "y", h, np.zeros(1)) for i, (b, h) in enumerate(at)]
    >>> usual_interval_h(given), usual_interval_h(given[:1]), usual_interval_h([])
    (8000.0, 8000.0, None)
    """
    hours: dict[str, set[float]] = {}
    for r in readings:
        hours.setdefault(r.blade, set()).add(r.time_h)
    between = [b - a for own in hours.values() for a, b in pairwise(sorted(own))]
    first = [min(own) for own in hours.values()]
    found = [h for h in between or first if h > 0]
    return float(median(found)) if found else None


def answers(model: Model, quantity: Quantity) -> bool:
    """Whether the surrogate answers for a quantity of the network."""
    part = model.part(quantity.name)
    middle = np.array([[0.5 * (i.low + i.high) for i in part.inputs]])
    try:
        nodes = None if quantity.kind == "scalar" else [quantity.node_among(part.named)]
        part.predict(middle, quantity.name, np.array([0.5 * part.horizon_h]), nodes)
    except InputError:
        return False
    return True
