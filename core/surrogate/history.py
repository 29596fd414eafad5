"""Inputs that change in time, from a surrogate of runs with constant ones.

Creep remembers by its strain: what a blade does next depends on how far it has crept and on the
present inputs, hardly on how it got there (strain hardening). So with the mean CEEQ as the memory
e, on a piece [a, b] of time with inputs x

    t* : E(t*; x) = e,      e ← E(t* + b − a; x),      y ← y + y(t* + b − a; x) − y(t*; x)

for elongation, deformation and damage; CEEQ at a node has a memory and a t* of its own. Against
213 finite-element histories of the prototype: 0.1–0.4 % after drifts, 0.3 and 2.4 % (median, 95 %)
after steps; time hardening, t* = a, is 5–15 % off. `FOLLOWED` is that error relative to what has
grown, `EXTRAPOLATED` what comes to it for what grows beyond the runs (half of those 2.4 %).

Rows of several quantities are followed at once: what the process says of the inputs, nearly all of
the cost, is asked once for all of them, and the memory is moved once.

t* may pass the last instant of the runs, after a step down above all; the curve then goes on with
the slope in log E over log t that it has there (`core.surrogate.clock`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError
from core.surrogate.clock import clock, unreached
from core.surrogate.followed import Curves, Followed, Scales
from core.surrogate.model import Surrogate
from core.surrogate.targets import MEAN_CEEQ

Array = NDArray[np.float64]
Answer = tuple[Array, Array, Array]  # mean and sd (n, M, R) of rows, mean CEEQ (n, M)
FOLLOWED = 0.004
EXTRAPOLATED = 0.012  # sd of a change beyond the runs' last instant, relative


@dataclass(frozen=True)
class Grown:
    """What has grown of rows: strain, totals and their doubt (n, R); log t of clocks of their
    own."""

    strain: Array
    total: Array
    doubt: Array
    log_t: Array | None = None


@dataclass(frozen=True)
class Memory:
    """What has grown: mean CEEQ (n, 1), and rows of each quantity; log t there."""

    mean_ceeq: Array
    rows: tuple[Grown, ...]
    log_t: Array | None = None

    @staticmethod
    def of(n: int, what: Sequence[Followed]) -> Memory:
        """Of n histories that begin."""
        nothing = [np.zeros((n, one.curves.forms.shape[2])) for one in what]
        return Memory(np.zeros((n, 1)), tuple(Grown(one, one, one) for one in nothing))

    def at(self, rows: NDArray[np.intp]) -> Memory:
        """Of these histories."""

        def own(one: Array | None) -> Array | None:
            return None if one is None else one[rows]

        grown = tuple(
            Grown(g.strain[rows], g.total[rows], g.doubt[rows], own(g.log_t)) for g in self.rows
        )
        return Memory(self.mean_ceeq[rows], grown, own(self.log_t))


def follow(
    surrogate: Surrogate,
    edges: Array,
    inputs: Array,
    marks: Array,
    at_marks: Array,
    what: Sequence[Followed],
    rule: float = FOLLOWED,
    *,
    doubt: bool = True,
    late: bool = False,
) -> list[Answer]:
    """Of each of `what` mean and sd of its rows at hours `marks`, (n, M, R), and mean CEEQ there
    (n, M). What is followed besides changes no bit of it.

    edges     hours (P + 1,), from 0, between which inputs are held
    inputs    (n, P, d), held over each piece
    at_marks  (n, M, d), held from the last edge before each mark to the mark; what is found at one
              mark depends on no other
    rule      the rule's own error, relative to what has grown; 0 where inputs are constant
    doubt     False: the surrogate's own error is left out of the sd, which saves most of the time
    late      a memory that inputs reach only long after the horizon grows as it would at
              `clock.BEYOND` of it (where creep is steady, as it would anywhere), in place of a
              RangeError

    Raises RangeError for inputs outside the surrogate's box, and for such a memory.
    """
    fits = inputs.shape[1] == len(edges) - 1 and at_marks.shape[1] == len(marks)
    if edges[0] != 0 or np.any(np.diff(edges) <= 0) or not fits or np.any(marks <= 0):
        raise InputError("edges", edges.tolist(), "do not fit the inputs", "one piece per interval")
    walk, now = Walk.of(surrogate, what, doubt, late), Memory.of(len(inputs), what)
    found = _room(len(inputs), len(marks), what)
    last = np.searchsorted(edges, marks, side="left") - 1  # the edge strictly before
    for p in range(int(last.max(initial=-1)) + 1):
        for m in np.flatnonzero(last == p):
            seen = walk.on(now, walk.known(at_marks[:, m]), float(marks[m] - edges[p]))
            _put(found, int(m), seen)
        if p < last.max() and p < len(edges) - 1:
            now = walk.on(now, walk.known(inputs[:, p]), float(edges[p + 1] - edges[p]))
    return [(mean, np.hypot(sd, rule * np.abs(mean)), path) for mean, sd, path in found]


def constant(
    surrogate: Surrogate, x: Array, marks: Array, what: Sequence[Followed], *, doubt: bool = True
) -> list[Answer]:
    """`follow` under inputs x (n, d) that do not change, to the last bit.

    The process is asked for them once, not at every mark.
    """
    walk, nothing = Walk.of(surrogate, what, doubt), Memory.of(len(x), what)
    known, found = walk.known(x), _room(len(x), len(marks), what)
    for m, hour in enumerate(marks):
        _put(found, m, walk.on(nothing, known, float(hour)))
    return [(mean, np.abs(sd), path) for mean, sd, path in found]


def _room(n: int, marks: int, what: Sequence[Followed]) -> list[Answer]:
    """For the answers; mean CEEQ is one for all."""
    path = np.empty((n, marks))
    shapes = [(n, marks, one.curves.forms.shape[2]) for one in what]
    return [(np.empty(shape), np.empty(shape), path) for shape in shapes]


def _put(found: Sequence[Answer], m: int, seen: Memory) -> None:
    """What is seen at a mark."""
    for (mean, sd, path), own in zip(found, seen.rows, strict=True):
        mean[:, m], sd[:, m], path[:, m] = own.total, own.doubt, seen.mean_ceeq[:, 0]


@dataclass(frozen=True)
class Known:
    """What the process says of inputs: weights of memory (n, A, 1), of rows (n, A, R), v (n,)."""

    memory: Array
    own: tuple[Array, ...]
    v: Array


@dataclass(frozen=True)
class _Step:
    """A piece of time: log t* (n, 1) at its ends, mean CEEQ (n, 1) there, and its hours."""

    before: Array
    after: Array
    begun: Array
    ceeq: Array
    hours: float | Array

    @property
    def first(self) -> bool:
        """Nothing has grown: what was there before is not asked for."""
        return not np.any(self.begun > 0)


@dataclass(frozen=True)
class Walk:
    """The rule, step by step."""

    surrogate: Surrogate
    memory: Curves
    k_memory: Scales
    what: Sequence[Followed]
    doubt: bool
    late: bool = False

    @staticmethod
    def of(surrogate: Surrogate, what: Sequence[Followed], doubt: bool, late: bool = False) -> Walk:
        """With the memory that the surrogate has."""
        part, one = surrogate.parts[MEAN_CEEQ], np.zeros(1, dtype=np.int64)
        time = part.factors.time_h
        k_memory = Scales(np.log(time), part.scale(time, one, surrogate.v_typical))
        memory = Curves.of(part, part.factors.space.astype(float))
        return Walk(surrogate, memory, k_memory, what, doubt, late)

    def known(self, x: Array) -> Known:
        """Of inputs x (n, d)."""
        z, curves = self.surrogate.scaled(x), (self.memory, *(one.curves for one in self.what))
        process, columns = self.surrogate.process, [one.columns for one in curves]
        if self.doubt:
            c, v = process.mean_and_variance(z, columns)
        else:
            c, v = process.mean(z, columns), np.zeros(len(z))
        memory, *own = (one.weights(of_it) for one, of_it in zip(curves, c, strict=True))
        return Known(memory, tuple(own), v)

    def on(self, now: Memory, known: Known, hours: float | Array) -> Memory:
        """After some hours, (n, 1) or of all, under inputs of which so much is known."""
        memory, e, begun = self.memory, known.memory, now.mean_ceeq
        before = clock(memory, e, begun, self.late, now.log_t)
        after = np.log(np.exp(before) + hours)
        ceeq = np.exp(after + memory(e, after))
        if self.late and np.any(there := unreached(memory, before)):  # it is carried along
            ceeq += _short(begun, np.exp(before + memory(e, before)), there)
        step, each = _Step(before, after, begun, ceeq, hours), (self.what, known.own, now.rows)
        rows = tuple(self._grown(*one, step, known.v) for one in zip(*each, strict=True))
        return Memory(ceeq, rows, after)

    def _grown(self, what: Followed, y: Array, now: Grown, step: _Step, v: Array) -> Grown:
        """Rows of one quantity after a step."""
        own, strain, doubt = what.curves, now.strain, now.doubt
        before, after, begun = step.before, step.after, step.begun
        if what.per_ceeq:
            g1 = own(y, after)
            change = g1 * step.ceeq - (0.0 if step.first else own(y, before) * begun)
        else:
            if what.own_clock:
                before = clock(own, y, strain, self.late, now.log_t)
                after = np.log(np.exp(before) + step.hours)
            y1 = np.exp(after + own(y, after))
            y0 = 0.0 * y1 if step.first else np.exp(before + own(y, before))
            change = y1 - np.where(begun > 0, y0, 0.0)
            strain = y1
            if self.late and what.own_clock and np.any(there := unreached(own, before)):
                strain = y1 + _short(now.strain, y0, there)
        if self.doubt:
            k = what.scales(after)
            if what.per_ceeq:
                k = np.hypot(k, g1 * self.k_memory(after)) * (step.ceeq - begun)
            else:
                k = k * np.abs(change)
            doubt = doubt + np.abs(k) * (v ** (0.5 * what.power))[:, None]
        beyond = np.clip((np.exp(after) - np.exp(self.memory.last)) / step.hours, 0.0, 1.0)
        doubt = doubt + EXTRAPOLATED * np.abs(change) * beyond
        return Grown(strain, now.total + change, doubt, after if what.own_clock else None)


def _short(strain: Array, reached: Array, there: NDArray[np.bool_]) -> Array:
    """By how much a strain is beyond what was reached; 0 where it was, to the last bit."""
    return np.where(there, np.maximum(strain - reached, 0.0), 0.0)
