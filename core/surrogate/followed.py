"""Curves over time at as many times as inputs: what `core.surrogate.history` follows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from core.errors import InputError
from core.surrogate.model import Surrogate
from core.surrogate.part import Part
from core.surrogate.targets import DEFORMATION
from core.surrogate.tucker import Factors

Array = NDArray[np.float64]


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

    def with_slope(self, weights: Array, log_t: Array) -> tuple[Array, Array]:
        """g and dg / d log t, (n, R) each; like `__call__`.

        Weights first, which of few rows is cheaper: a cubic each, of which both are read off.
        """
        spline = self.spline
        at = np.clip(log_t, self.first, self.last)
        place = np.clip(np.searchsorted(spline.x, at, side="right") - 1, 0, len(spline.x) - 2)
        if at.shape[1] == 1:
            cubic = np.einsum("kna,nar->knr", spline.c[:, place[:, 0]], weights)
        else:
            cubic = np.einsum("knra,nar->knr", spline.c[:, place], weights)
        c3, c2, c1, c0 = cubic
        h = at - spline.x[place]
        slope = (3.0 * c3 * h + 2.0 * c2) * h + c1
        value = ((c3 * h + c2) * h + c1) * h + c0
        past = np.maximum(log_t - self.last, 0.0)
        return np.asarray(value + past * slope), np.asarray(slope * (log_t >= self.first))


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
        """k (n, R) at log times (n, R) or (n, 1): linear in between, held beyond both ends.

        >>> double = Scales(np.array([0.0, 1.0, 3.0]), np.array([[0.0], [2.0], [6.0]]))
        >>> double(np.array([[-1.0], [0.25], [1.0], [2.0], [9.0]])).ravel().tolist()
        [0.0, 0.5, 2.0, 4.0, 6.0]
        """
        begin = np.searchsorted(self.log_t, log_t, side="right") - 1
        begin = np.clip(begin, 0, len(self.log_t) - 2)
        start, rows = self.log_t[begin], np.arange(self.k.shape[1])
        k = self.k[begin, rows]
        slope = (self.k[begin + 1, rows] - k) / (self.log_t[begin + 1] - start)
        k = slope * (log_t - start) + k
        k = np.where(log_t < self.log_t[0], self.k[0], k)
        return np.asarray(np.where(log_t >= self.log_t[-1], self.k[-1], k))


@dataclass(frozen=True)
class Followed:
    """What is followed: the curves of its rows and the sizes of their errors.

    per_ceeq   the curves are those of the value over mean CEEQ
    own_clock  each row remembers itself, not the mean CEEQ
    power      of v in their variance (`core.surrogate.part`)
    """

    curves: Curves
    scales: Scales
    per_ceeq: bool
    own_clock: bool
    power: float = 1.0

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
            part.power,
        )

    @staticmethod
    def mixed(surrogate: Surrogate, mixing: Array) -> Followed:
        """Mixtures T (Q, B) of the deformation's spatial modes."""
        part = surrogate.parts[DEFORMATION]
        time = part.factors.time_h
        covariance = part.mode_covariance(time)
        k = np.sqrt(np.einsum("qb,tbc,qc->tq", mixing, covariance, mixing))
        return Followed(Curves.of(part, mixing), Scales(np.log(time), k), True, False)
