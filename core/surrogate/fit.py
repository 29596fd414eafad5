"""Rows followed through time, fitted by polynomials over a box of inputs (`core.response`).

    y = A exp(B),   B = log E, A = y / E        (elongation, deformation; E the mean CEEQ)
    y = exp(B)                                  (CEEQ, damage)

and the variance relative to E, or to y, as exp of a polynomial: an error that runs smoothly.

To follow rows costs far more than to fit them, and the error twice as much as the mean. What
polynomials of this degree miss of the rows hardly depends on the number of points: with half of
those that `core.surrogate.compile` takes the rows' error grows by 3 to 5 % (of 0.2 to 0.35 %, rms
over the box), and that of the sd, 13 to 22 % of itself, by 3 to 8 % with a quarter of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.answers import Input
from core.monomials import multi_indices
from core.response import Response
from core.surrogate.compile import fitting
from core.surrogate.history import Answer
from core.surrogate.reach import missed

Array = NDArray[np.float64]
SHARE = 2  # of the points for rows that cost nothing, one is followed
FEWER = 2  # of those again one has a sd: three for each term of the polynomials, or more
TINY = 1e-12


@dataclass(frozen=True)
class Fit:
    """Polynomials of a degree over the box of some inputs.

    bends  whether inputs are held at the runs' end: what polynomials miss of the bend is added to
           the variance (`core.surrogate.reach`)
    """

    inputs: Sequence[Input]
    degree: int
    bends: bool

    @property
    def box(self) -> tuple[Array, Array]:
        """Lower and upper bounds, (d,) each."""
        low, high = np.array([(i.low, i.high) for i in self.inputs]).T
        return low, high

    @property
    def points(self) -> Array:
        """Inputs (S, d) at which rows have to be known; their sd at the first of `FEWER` parts of
        them."""
        low, high = self.box
        z = fitting(len(low), self.degree, SHARE)[0]
        return np.asarray(low + 0.5 * (z + 1.0) * (high - low))

    def nothing(self, rows: int) -> Response:
        """So many rows that are 0, without an error."""
        (low, high), none = self.box, np.zeros(rows)
        zero = np.zeros((rows, len(multi_indices(len(low), self.degree))))
        return Response(self._names, low, high, self.degree, zero, zero, none, none, zero)

    def by_time(self, first: Answer, rest: Answer, per_ceeq: bool) -> list[Response]:
        """At each of T times, from mean, sd (n, T, R) and mean CEEQ (n, T) at the first points, and
        from mean and mean CEEQ at the others.

        Time by time: rows are the same to the last bit whatever else is asked for with them.
        """
        y, ceeq = (np.concatenate([first[k], rest[k]]) for k in (0, 2))
        sd, times = first[1], range(y.shape[1])
        return [self.fitted(y[:, t], sd[:, t], ceeq[:, t, None], per_ceeq) for t in times]

    def fitted(self, y: Array, sd: Array, ceeq: Array, per_ceeq: bool) -> Response:
        """Rows (S, R) at one time, mean CEEQ (S, 1) there; sd (S', R) at the first points."""
        low, high = self.box
        z, factor = fitting(len(low), self.degree, SHARE)
        scale = np.repeat(ceeq, y.shape[1], axis=1) if per_ceeq else y
        v = np.log((sd / (np.abs(scale[: len(sd)]) + TINY)) ** 2 + TINY**2)
        fitted = factor @ np.hstack([y / scale, np.log(scale)])
        if self.bends:
            v = np.logaddexp(v, np.log(missed(z, self.degree, fitted, y, scale) + TINY**2))
        few = fitting(len(low), self.degree, SHARE * (len(y) // len(v)))[1]
        fitted = np.hstack([fitted, few @ v])
        p_a, p_b, p_v = np.split(np.ascontiguousarray(fitted.T), 3)
        ones = np.ones(y.shape[1])
        return Response(self._names, low, high, self.degree, p_a, p_b, ones, 0.0 * ones, p_v)

    @property
    def _names(self) -> tuple[str, ...]:
        return tuple(i.name for i in self.inputs)
