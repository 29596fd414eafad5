"""Inputs that change in time, from a surrogate of runs with constant ones.

Creep remembers by its strain: what a blade does next depends on how far it has crept and on the
present inputs, hardly on how it got there (strain hardening). So with the mean CEEQ as the memory
e, on a piece [a, b] of time with inputs x

    t* : E(t*; x) = e,      e ← E(t* + b − a; x),      y ← y + y(t* + b − a; x) − y(t*; x)

for elongation, deformation and damage; CEEQ at a node has a memory and a t* of its own. Against
213 finite-element histories of the prototype: 0.1–0.4 % after drifts, 0.3 and 2.4 % (median, 95 %)
after steps; time hardening, t* = a, is 5–15 % off. `FOLLOWED` is that error relative to what has
grown, `EXTRAPOLATED` what comes to it for what grows beyond the runs (half of those 2.4 %).

t* may pass the last instant of the runs, after a step down above all; the curve then goes on with
the slope in log E over log t that it has there, up to `BEYOND` times that instant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError, RangeError
from core.surrogate.followed import Curves, Followed, Scales
from core.surrogate.model import Surrogate
from core.surrogate.targets import MEAN_CEEQ

Array = NDArray[np.float64]
FOLLOWED = 0.004
EXTRAPOLATED = 0.012  # sd of a change beyond the runs' last instant, relative
BEYOND = 3.0
EARLIEST_H = 1e-6
STEPS = 60
CLOSE = 1e-12  # of log t


def _clock(curve: Curves, weights: Array, strain: Array, late: bool = False) -> Array:
    """log t* (n, R) at which t exp(g(t)) reaches `strain` (n, R), for it grows.

    By Newton's steps, halving where one would leave what is known to hold it.

    late  where it is reached only after `BEYOND`: that time, in place of a RangeError
    """
    start = np.full(strain.shape, np.log(EARLIEST_H))
    if not np.any(strain > 0):
        return start
    wanted = np.log(np.maximum(strain, 1e-300))
    low, high = start.copy(), np.full(strain.shape, curve.last + np.log(BEYOND))
    reached = high + curve(weights, high)
    if late:
        wanted = np.minimum(wanted, reached)
    elif np.any(reached < wanted):
        raise RangeError(
            "creep strain",
            float(strain.max()),
            f"is not reached within {BEYOND:g} times the horizon under the inputs that follow",
            "train on longer runs",
        )
    at = 0.5 * (low + high)
    for _ in range(STEPS):
        short = at + curve(weights, at) - wanted
        low, high = np.where(short < 0, at, low), np.where(short < 0, high, at)
        slope = 1.0 + curve.slope(weights, at)
        step = at - short / np.where(slope > 0, slope, 1.0)
        following = np.where((step >= low) & (step <= high), step, 0.5 * (low + high))
        moved = np.max(np.abs(following - at), where=strain > 0, initial=0.0)
        at = following
        if moved < CLOSE:
            break
    return np.asarray(np.where(strain > 0, at, start))


@dataclass(frozen=True)
class _Memory:
    """What has grown: mean CEEQ (n, 1); strain, totals and their doubt (n, R)."""

    mean_ceeq: Array
    strain: Array
    total: Array
    doubt: Array

    @staticmethod
    def of(n: int, rows: int) -> _Memory:
        """Of n histories that begin."""
        return _Memory(np.zeros((n, 1)), *(np.zeros((n, rows)) for _ in range(3)))


def follow(
    surrogate: Surrogate,
    edges: Array,
    inputs: Array,
    marks: Array,
    at_marks: Array,
    what: Followed,
    rule: float = FOLLOWED,
    *,
    doubt: bool = True,
    late: bool = False,
) -> tuple[Array, Array, Array]:
    """Mean and sd of rows at hours `marks`, (n, M, R), and mean CEEQ there (n, M).

    edges     hours (P + 1,), from 0, between which inputs are held
    inputs    (n, P, d), held over each piece
    at_marks  (n, M, d), held from the last edge before each mark to the mark; what is found at one
              mark depends on no other
    rule      the rule's own error, relative to what has grown; 0 where inputs are constant
    doubt     False: the surrogate's own error is left out of the sd, which saves most of the time
    late      a memory that inputs reach only long after the horizon grows as it would at `BEYOND`
              of it (where creep is steady, as it would anywhere), in place of a RangeError

    Raises RangeError for inputs outside the surrogate's box, and for such a memory.
    """
    fits = inputs.shape[1] == len(edges) - 1 and at_marks.shape[1] == len(marks)
    if edges[0] != 0 or np.any(np.diff(edges) <= 0) or not fits or np.any(marks <= 0):
        raise InputError("edges", edges.tolist(), "do not fit the inputs", "one piece per interval")
    walk, many = _Walk.of(surrogate, what, doubt, late), what.curves.forms.shape[2]
    now = _Memory.of(len(inputs), many)
    mean, sd, path = (np.empty((len(inputs), len(marks), width)) for width in (many, many, 1))
    last = np.searchsorted(edges, marks, side="left") - 1  # the edge strictly before
    for p in range(int(last.max(initial=-1)) + 1):
        for m in np.flatnonzero(last == p):
            seen = walk.on(now, walk.known(at_marks[:, m]), float(marks[m] - edges[p]))
            mean[:, m], sd[:, m], path[:, m] = seen.total, seen.doubt, seen.mean_ceeq
        if p < last.max() and p < len(edges) - 1:
            now = walk.on(now, walk.known(inputs[:, p]), float(edges[p + 1] - edges[p]))
    return mean, np.hypot(sd, rule * np.abs(mean)), path[:, :, 0]


def constant(
    surrogate: Surrogate, x: Array, marks: Array, what: Followed, *, doubt: bool = True
) -> tuple[Array, Array, Array]:
    """`follow` under inputs x (n, d) that do not change, to the last bit.

    The process is asked for them once, not at every mark.
    """
    walk, nothing = _Walk.of(surrogate, what, doubt), _Memory.of(len(x), what.curves.forms.shape[2])
    known = walk.known(x)
    seen = [walk.on(nothing, known, float(hour)) for hour in marks]
    mean, sd, path = (
        np.stack([getattr(one, name) for one in seen], axis=1)
        for name in ("total", "doubt", "mean_ceeq")
    )
    return mean, np.abs(sd), path[:, :, 0]


@dataclass(frozen=True)
class _Known:
    """What the process says of inputs: weights of memory (n, A, 1) and rows (n, A, R), v (n,)."""

    memory: Array
    own: Array
    v: Array


@dataclass(frozen=True)
class _Walk:
    """The rule, step by step."""

    surrogate: Surrogate
    memory: Curves
    k_memory: Scales
    what: Followed
    doubt: bool
    late: bool = False

    @staticmethod
    def of(surrogate: Surrogate, what: Followed, doubt: bool, late: bool = False) -> _Walk:
        """With the memory that the surrogate has."""
        part, one = surrogate.parts[MEAN_CEEQ], np.zeros(1, dtype=np.int64)
        time = part.factors.time_h
        k_memory = Scales(np.log(time), part.scale(time, one, surrogate.v_typical))
        memory = Curves.of(part, part.factors.space.astype(float))
        return _Walk(surrogate, memory, k_memory, what, doubt, late)

    def known(self, x: Array) -> _Known:
        """Of inputs x (n, d)."""
        z, own, memory = self.surrogate.scaled(x), self.what.curves, self.memory
        process, columns = self.surrogate.process, [memory.columns, own.columns]
        if self.doubt:
            (c_memory, c_own), v = process.mean_and_variance(z, columns)
        else:
            (c_memory, c_own), v = process.mean(z, columns), np.zeros(len(z))
        return _Known(memory.weights(c_memory), own.weights(c_own), v)

    def on(self, now: _Memory, known: _Known, hours: float) -> _Memory:
        """After some hours under inputs of which so much is known."""
        what, own, memory = self.what, self.what.curves, self.memory
        e, y = known.memory, known.own
        begun, before = now.mean_ceeq, _clock(memory, e, now.mean_ceeq, self.late)
        first = not np.any(begun > 0)  # nothing has grown: what was there before is not asked for
        after = np.log(np.exp(before) + hours)
        mean_ceeq, strain = np.exp(after + memory(e, after)), now.strain
        if self.late:  # what was not reached is carried along
            mean_ceeq += _short(begun, np.exp(before + memory(e, before)))
        if what.per_ceeq:
            g1 = own(y, after)
            change = g1 * mean_ceeq - (0.0 if first else own(y, before) * begun)
        else:
            if what.own_clock:
                before = _clock(own, y, strain, self.late)
                after = np.log(np.exp(before) + hours)
            y1 = np.exp(after + own(y, after))
            y0 = 0.0 * y1 if first else np.exp(before + own(y, before))
            change = y1 - np.where(begun > 0, y0, 0.0)
            strain = y1 + _short(strain, y0) if self.late and what.own_clock else y1
        doubt = now.doubt
        if self.doubt:
            k = what.scales(after)
            if what.per_ceeq:
                k = np.hypot(k, g1 * self.k_memory(after)) * (mean_ceeq - begun)
            else:
                k = k * np.abs(change)
            doubt = doubt + np.abs(k) * np.sqrt(known.v)[:, None]
        beyond = np.clip((np.exp(after) - np.exp(memory.last)) / hours, 0.0, 1.0)
        doubt = doubt + EXTRAPOLATED * np.abs(change) * beyond
        return _Memory(mean_ceeq, strain, now.total + change, doubt)


def _short(strain: Array, reached: Array) -> Array:
    """By how much a strain is beyond what was reached; 0 where it was."""
    return np.maximum(strain - reached, 0.0)
