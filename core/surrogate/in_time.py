"""Inputs that run in time: what a surrogate's own inputs are over pieces of it.

    x_j(t) = x_j + a s(t)        or        x_j(t) = x_j (1 + a s(t))

The surrogate knows inputs that stay as they are, so time is cut where a course has a point, each
way in between into up to `PARTS` pieces, and over a piece an input is held at its mean. What the
blade makes of one piece after the other: `core.surrogate.history`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from core.archive import Input
from core.drift import Drift
from core.errors import InputError, RangeError
from core.surrogate.reach import check_reach, run

Array = NDArray[np.float64]
PARTS = 8


@dataclass(frozen=True)
class InTime:
    """A surrogate's own inputs where some of them run, and those that are given in their place.

    own                     the surrogate's inputs
    drifts, ranges, fixed   as in `core.surrogate.driven.Driven`
    """

    own: Sequence[Input]
    drifts: tuple[Drift, ...]
    ranges: Mapping[str, tuple[float, float]]
    fixed: Mapping[str, float]

    def check(self, horizon_h: float) -> None:
        """Refuse names that are unknown or taken, and a course that leaves the surrogate's box."""
        known = {i.name: i for i in self.own}
        names = [d.name for d in self.drifts]
        moved = {d.input for d in self.drifts}
        for name in sorted({*self.ranges, *self.fixed, *moved} - known.keys() - set(names)):
            raise InputError("input", name, "is unknown", f"use one of {', '.join(known)}")
        if len(set(names)) < len(names) or known.keys() & set(names):
            raise InputError("drifts", names, "need names of their own", "rename one")
        for name in names:
            low, high = self.ranges.get(name, (0.0, 0.0))
            if not low < high:
                raise InputError(name, (low, high), "is no range", "give low < high")
        for own in known.values():
            fixed = self.fixed.get(own.name)
            start = self.range_of(own) if fixed is None else (fixed,)
            check_reach(own, start, self.drifts, self.ranges, horizon_h)

    def range_of(self, own: Input) -> tuple[float, float]:
        """Where an own input may start."""
        return self.ranges.get(own.name, (own.low, own.high))

    @cached_property
    def inputs(self) -> tuple[Input, ...]:
        """The own ones that are not fixed, then the amplitudes."""
        free = [i for i in self.own if i.name not in self.fixed]
        kept = [Input(i.name, *self.range_of(i)) for i in free]
        return (*kept, *(Input(d.name, *self.ranges[d.name]) for d in self.drifts))

    def checked(self, x: Array) -> Array:
        """Inputs x (n, D) where all of them are in their ranges, beyond which polynomials know
        nothing; InputError, RangeError."""
        own = self.inputs
        if x.shape[1:] != (len(own),):
            names = ", ".join(i.name for i in own)
            raise InputError("x", x.shape, "is the wrong shape", f"give (n, {len(own)}): {names}")
        low, high = np.array([(i.low, i.high) for i in own]).T
        slack = 1e-9 * (high - low)
        outside = np.argwhere(~((x >= low - slack) & (x <= high + slack)))
        if len(outside):
            i, j = outside[0].tolist()
            problem = f"lies outside {low[j]:g} … {high[j]:g}"
            remedy = "stay inside the ranges that the model was given"
            raise RangeError(f"x[{i}], {own[j].name}", float(x[i, j]), problem, remedy)
        return x

    def until(self, x: Array, times: Array) -> tuple[Array, Array, Array]:
        """Edges (P + 1,) of pieces of time, and the own inputs for inputs x (n, D): over these
        pieces (n, P, d), and from the last edge before each of `times` to it (n, T, d)."""
        cuts = {h for d in self.drifts for h in d.shape.cuts(PARTS) if h > 0}
        edges = np.array([0.0, *sorted(cuts)])
        edges = edges[edges < times.max()]
        starts = edges[np.searchsorted(edges, times) - 1]
        held = self._held(x, list(pairwise(edges)))
        at_times = self._held(x, list(zip(starts, times, strict=True)))
        return edges, held, at_times

    def _held(self, x: Array, pieces: Sequence[tuple[float, float]]) -> Array:
        """The own inputs (n, P, d) over pieces of time: the mean of each."""
        values = dict(zip((i.name for i in self.inputs), x.T, strict=True))
        held = np.empty((len(x), len(pieces), len(self.own)))
        for p, (start, end) in enumerate(pieces):
            for j, own in enumerate(self.own):
                now = values.get(own.name)
                now = np.full(len(x), self.fixed[own.name]) if now is None else now
                held[:, p, j] = run(now, own, self.drifts, values, start, end)
        return held

    def start(self, x: Array, asleep: Mapping[str, float]) -> Array:
        """The own inputs (n, d) before anything runs, with what sleeps asleep."""
        names = [i.name for i in self.inputs]
        out = np.empty((len(x), len(self.own)))
        for j, own in enumerate(self.own):
            still = asleep.get(own.name, self.fixed.get(own.name))
            out[:, j] = x[:, names.index(own.name)] if still is None else still
        return out


def from_start(edges: Array, held: Array, times: Array, at_times: Array) -> Array:
    """Mean inputs from the start to each of the times (n, T, d), of those of `InTime.until`."""
    return np.stack(
        [
            (np.diff(edges[: k + 1]) @ held[:, :k] + (t - edges[k]) * at_times[:, m]) / t
            for m, (t, k) in enumerate(zip(times, np.searchsorted(edges, times) - 1, strict=True))
        ],
        axis=1,
    )
