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

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from core.errors import InputError, RangeError
from core.surrogate.model import Surrogate
from core.surrogate.part import Part
from core.surrogate.targets import DEFORMATION, MEAN_CEEQ
from core.surrogate.tucker import Factors

Array = NDArray[np.float64]
FOLLOWED = 0.004
EXTRAPOLATED = 0.012  # sd of a change beyond the runs' last instant, relative
BEYOND = 3.0
EARLIEST_H = 1e-6
STEPS = 60
CLOSE = 1e-12  # of log t


@dataclass(frozen=True)
class Curves:
    """One part at as many times as inputs: g(t_i; x_i), by the splines of `core.surrogate.tucker`.

    forms (1 + J, A, R) for the rows asked for; offset and slope of the time modes at the last
    instant carry on beyond it.
    """

    spline: CubicSpline
    first: float
    last: float
    forms: Array
    columns: slice

    @staticmethod
    def of(part: Part, to_rows: Array) -> Curves:
        """Of the rows that `to_rows` (R, B) makes of the part's spatial modes."""
        factors: Factors = part.factors
        forms = factors.core @ to_rows.T
        clock = np.log(factors.time_h)
        return Curves(
            CubicSpline(clock, factors.time, axis=0),
            float(clock[0]),
            float(clock[-1]),
            np.ascontiguousarray(forms),
            part.columns,
        )

    def weights(self, c: Array) -> Array:
        """The time modes' weights for coefficients c (n, J) of this part: (n, A, R)."""
        return np.asarray(self.forms[0] + np.tensordot(c, self.forms[1:], axes=1))

    def __call__(self, weights: Array, log_t: Array) -> Array:
        """g (n, R) at log times (n, 1) or, a time for each row, (n, R)."""
        at, past = np.clip(log_t, self.first, self.last), np.maximum(log_t - self.last, 0.0)
        modes = self.spline(at) + past[..., None] * self.spline(self.last, 1)
        return _mixed(modes, weights)

    def slope(self, weights: Array, log_t: Array) -> Array:
        """dg / d log t (n, R); like `__call__`."""
        modes = self.spline(np.clip(log_t, self.first, self.last), 1)
        return _mixed(modes * (log_t >= self.first)[..., None], weights)


def _mixed(modes: Array, weights: Array) -> Array:
    """Time modes (n, 1 or R, A) by their weights (n, A, R)."""
    if modes.shape[1] == 1:
        return np.asarray(np.einsum("na,nar->nr", modes[:, 0], weights))
    return np.asarray(np.einsum("nra,nar->nr", modes, weights))


@dataclass(frozen=True)
class Scales:
    """k of a part's error (`core.surrogate.part`) at its instants (T,), by row (T, R)."""

    log_t: Array
    k: Array

    def __call__(self, log_t: Array) -> Array:
        """k (n, R) at log times (n, R) or (n, 1)."""
        at = np.broadcast_to(log_t, (len(log_t), self.k.shape[1]))
        rows = [np.interp(at[:, r], self.log_t, self.k[:, r]) for r in range(self.k.shape[1])]
        return np.stack(rows, axis=1)


@dataclass(frozen=True)
class Followed:
    """What is followed: the curves of its rows and the sizes of their errors.

    per_ceeq   the curves are those of the value over mean CEEQ
    own_clock  each row remembers itself, not the mean CEEQ
    """

    curves: Curves
    scales: Scales
    per_ceeq: bool
    own_clock: bool

    @staticmethod
    def of(surrogate: Surrogate, quantity: str, nodes: Sequence[int] | None) -> Followed:
        """A quantity at nodes, rows in C order of (node, xyz)."""
        if quantity not in ("elongation", DEFORMATION, "ceeq", "creep_damage"):
            raise InputError(
                "quantity",
                quantity,
                "has no rule in time",
                "ask elongation, deformation, ceeq or creep_damage",
            )
        rows, part = surrogate.rows(quantity, nodes), surrogate.parts[quantity]
        needed = "per ceeq" if quantity in ("elongation", DEFORMATION) else "log rate"
        if part.form != needed:
            problem = f"is learnt as {part.form!r} of its value: it does not grow from 0 with creep"
            remedy = "give runs in which it does, or leave out inputs that run in time"
            raise InputError("quantity", quantity, problem, remedy)
        return Followed(
            Curves.of(part, part.factors.space[rows].astype(float)),
            Scales(
                np.log(part.factors.time_h),
                part.scale(part.factors.time_h, rows, surrogate.v_typical),
            ),
            quantity in ("elongation", DEFORMATION),
            quantity == "ceeq",
        )

    @staticmethod
    def mixed(surrogate: Surrogate, mixing: Array) -> Followed:
        """Mixtures T (Q, B) of the deformation's spatial modes."""
        part = surrogate.parts[DEFORMATION]
        time = part.factors.time_h
        covariance = part.mode_covariance(time)
        k = np.sqrt(np.einsum("qb,tbc,qc->tq", mixing, covariance, mixing))
        return Followed(Curves.of(part, mixing), Scales(np.log(time), k), True, False)


def _clock(curve: Curves, weights: Array, strain: Array) -> Array:
    """log t* (n, R) at which t exp(g(t)) reaches `strain` (n, R), for it grows.

    By Newton's steps, halving where one would leave what is known to hold it.
    """
    start = np.full(strain.shape, np.log(EARLIEST_H))
    if not np.any(strain > 0):
        return start
    wanted = np.log(np.maximum(strain, 1e-300))
    low, high = start.copy(), np.full(strain.shape, curve.last + np.log(BEYOND))
    if np.any(high + curve(weights, high) < wanted):
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
) -> tuple[Array, Array, Array]:
    """Mean and sd of rows at hours `marks`, (n, M, R), and mean CEEQ there (n, M).

    edges     hours (P + 1,), from 0, between which inputs are held
    inputs    (n, P, d), held over each piece
    at_marks  (n, M, d), held from the last edge before each mark to the mark; what is found at one
              mark depends on no other
    rule      the rule's own error, relative to what has grown; 0 where inputs are constant
    doubt     False: the surrogate's own error is left out of the sd, which saves most of the time

    Raises RangeError for inputs outside the surrogate's box, and for a memory that they reach only
    long after the horizon.
    """
    fits = inputs.shape[1] == len(edges) - 1 and at_marks.shape[1] == len(marks)
    if edges[0] != 0 or np.any(np.diff(edges) <= 0) or not fits or np.any(marks <= 0):
        raise InputError("edges", edges.tolist(), "do not fit the inputs", "one piece per interval")
    part, one = surrogate.parts[MEAN_CEEQ], np.zeros(1, dtype=np.int64)
    time = part.factors.time_h
    k_memory = Scales(np.log(time), part.scale(time, one, surrogate.v_typical))
    walk = _Walk(
        surrogate, Curves.of(part, part.factors.space.astype(float)), k_memory, what, doubt
    )
    n, many = len(inputs), what.curves.forms.shape[2]
    now = _Memory(np.zeros((n, 1)), *(np.zeros((n, many)) for _ in range(3)))
    mean, sd, path = (np.empty((n, len(marks), width)) for width in (many, many, 1))
    last = np.searchsorted(edges, marks, side="left") - 1  # the edge strictly before
    for p in range(int(last.max(initial=-1)) + 1):
        for m in np.flatnonzero(last == p):
            seen = walk.on(now, at_marks[:, m], float(marks[m] - edges[p]))
            mean[:, m], sd[:, m], path[:, m] = seen.total, seen.doubt, seen.mean_ceeq
        if p < last.max() and p < len(edges) - 1:
            now = walk.on(now, inputs[:, p], float(edges[p + 1] - edges[p]))
    return mean, np.hypot(sd, rule * np.abs(mean)), path[:, :, 0]


@dataclass(frozen=True)
class _Walk:
    """The rule, step by step."""

    surrogate: Surrogate
    memory: Curves
    k_memory: Scales
    what: Followed
    doubt: bool

    def on(self, now: _Memory, x: Array, hours: float) -> _Memory:
        """After some hours under inputs x (n, d)."""
        what, own, memory = self.what, self.what.curves, self.memory
        z = self.surrogate.scaled(x)
        process, columns = self.surrogate.process, [memory.columns, own.columns]
        if self.doubt:
            (c_memory, c_own), v = process.mean_and_variance(z, columns)
        else:
            (c_memory, c_own), v = process.mean(z, columns), np.zeros(len(z))
        e, y = memory.weights(c_memory), own.weights(c_own)
        begun, before = now.mean_ceeq, _clock(memory, e, now.mean_ceeq)
        after = np.log(np.exp(before) + hours)
        mean_ceeq, strain = np.exp(after + memory(e, after)), now.strain
        if what.per_ceeq:
            g0, g1 = own(y, before), own(y, after)
            change = g1 * mean_ceeq - g0 * begun
            k = np.hypot(what.scales(after), g1 * self.k_memory(after)) * (mean_ceeq - begun)
        else:
            if what.own_clock:
                before = _clock(own, y, strain)
                after = np.log(np.exp(before) + hours)
            y0, y1 = (np.exp(at + own(y, at)) for at in (before, after))
            change = y1 - np.where(begun > 0, y0, 0.0)
            k, strain = what.scales(after) * np.abs(change), y1
        doubt = now.doubt + np.abs(k) * np.sqrt(v)[:, None]
        beyond = np.clip((np.exp(after) - np.exp(memory.last)) / hours, 0.0, 1.0)
        doubt = doubt + EXTRAPOLATED * np.abs(change) * beyond
        return _Memory(mean_ceeq, strain, now.total + change, doubt)
