"""Polynomials of the process's coefficients.

Every row of every part is linear in the coefficients c(z), so it is enough to fit polynomials of
total degree p to those once: P (J, M) by least squares at points with the density of Chebyshev
nodes in [-1, 1]^d (Sobol numbers u, z = -cos(pi u)), which keeps the error even up to the edge
of the box. A row then costs one small product, D P. Points, not randomness: nothing is seeded.
`Compiled` puts rows together in the three forms of `core.response.Response`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import qmc

from core.monomials import monomials, multi_indices
from core.response import Response
from core.surrogate.kernel import SharedGP
from core.surrogate.part import Part, Rows
from core.surrogate.targets import DEFORMATION, ELASTIC, MEAN_CEEQ, invert

if TYPE_CHECKING:
    from core.surrogate.model import Surrogate

Array = NDArray[np.float64]
OVERSAMPLING = 12
ONE = np.zeros(1, dtype=np.int64)
TINY_H = 1e-30  # stands for t = 0 in a logarithm


def chebyshev_points(d: int, degree: int) -> Array:
    """Points (S, d) in [-1, 1] to fit polynomials of a degree at, `OVERSAMPLING` of their terms.

    >>> chebyshev_points(2, 3).shape
    (128, 2)
    """
    power = int(np.ceil(np.log2(OVERSAMPLING * len(multi_indices(d, degree)))))
    sobol = qmc.Sobol(d, scramble=False).random_base2(power)
    return np.asarray(-np.cos(np.pi * (sobol + 0.5 / 2**power)))


@lru_cache(maxsize=8)
def fitting(d: int, degree: int, share: int = 1) -> tuple[Array, Array]:
    """Points (S, d) and the factor (M, S) from values there to a polynomial's coefficients.

    share  a power of two: the first points alone, by one of so many

    >>> points, factor = fitting(1, 2)
    >>> np.abs(factor @ points[:, 0] ** 2).round(9).tolist()
    [0.0, 0.0, 1.0]
    """
    points = chebyshev_points(d, degree)
    points = points[: len(points) // share]
    basis = monomials(points, degree)
    # normal equations on an orthonormalised basis: monomials alone are ill-conditioned
    _, r = np.linalg.qr(basis)
    whitened = np.linalg.solve(r.T, basis.T)
    factor = np.linalg.solve(r, cho_solve(cho_factor(whitened @ whitened.T), whitened))
    points.flags.writeable = factor.flags.writeable = False
    return points, factor


@dataclass(frozen=True, slots=True)
class Compiler:
    """polynomials (J, M) of all coefficients, log_v (M,), and what other fits at the points need.

    points   (S, d) in [-1, 1]
    samples  coefficients at the points, (S, J)
    factor   maps values (S, R) to polynomials: factor @ values, (M, S)
    """

    degree: int
    points: Array
    samples: Array
    factor: Array
    polynomials: Array
    log_v: Array

    @classmethod
    def of(cls, process: SharedGP, degree: int) -> Compiler:
        """Fit the polynomials."""
        points, factor = fitting(process.z.shape[1], degree)
        (samples,), v = process.mean_and_variance(points)
        return cls(degree, points, samples, factor, (factor @ samples).T.copy(), factor @ np.log(v))

    def fit(self, values: Array) -> Array:
        """Polynomials (R, M) through values (S, R) at the points."""
        return np.asarray((self.factor @ values).T)

    def constant(self, values: Array) -> Array:
        """Polynomials (R, M) that are the constants `values` (R,)."""
        out = np.zeros((len(values), self.polynomials.shape[1]))
        out[:, 0] = values
        return out

    def linear(self, offset: Array, forms: Array, columns: slice) -> Array:
        """Polynomials (R, M) of offset (R,) + forms^T (R, J) c."""
        out = np.asarray(forms.T @ self.polynomials[columns])
        out[:, 0] += offset
        return out


@dataclass(frozen=True, slots=True)
class Compiled:
    """Responses of a surrogate at times (T,)."""

    model: Surrogate
    compiler: Compiler
    time: Array

    def _scale(self, part: Part, rows: Rows, time: Array | None = None) -> Array:
        return part.scale(self.time if time is None else time, rows, self.model.v_typical)

    def _response(self, a: Array, b: Array, ka: Array, kb: Array, power: float = 1.0) -> Response:
        model, made = self.model, self.compiler
        names = tuple(item.name for item in model.inputs)
        log_v = made.log_v if power == 1.0 else power * made.log_v
        return Response(names, model.low, model.high, made.degree, a, b, ka, kb, log_v)

    def direct(self, part: Part, rows: Rows) -> Response:
        """A part that is the quantity itself or its logarithm."""
        g0, d = part.forms(self.time, rows)
        k = self._scale(part, rows).ravel()
        if part.form == "log rate":
            g0 = g0 + np.log(np.maximum(self.time, TINY_H))[:, None]
        g = self.compiler.linear(g0.ravel(), d.reshape(len(d), -1), part.columns)
        none = np.zeros_like(k)
        if part.form == "raw":
            return self._response(g, np.zeros_like(g), k, none, part.power)
        return self._response(self.compiler.constant(np.ones(len(g))), g, none, k, part.power)

    def per_ceeq(self, part: Part, rows: Rows) -> Response:
        """A part times mean CEEQ."""
        g0, d = part.forms(self.time, rows)
        a = self.compiler.linear(g0.ravel(), d.reshape(len(d), -1), part.columns)
        return self._times_ceeq(a, self._scale(part, rows).ravel())

    def _times_ceeq(self, a: Array, ka: Array) -> Response:
        part, width = self.model.parts[MEAN_CEEQ], len(a) // len(self.time)
        g0, d = part.forms(self.time, ONE)
        logs = g0[:, 0] + np.log(np.maximum(self.time, TINY_H))
        b = self.compiler.linear(logs, d[:, :, 0], part.columns)
        kb = self._scale(part, ONE)[:, 0]
        return self._response(a, np.repeat(b, width, axis=0), ka, np.repeat(kb, width))

    def modes(self, mixing: Array) -> Response:
        """Mixtures T (Q, B) of the deformation's modes, times mean CEEQ in creep, at one time."""
        part = self.model.parts[DEFORMATION]
        rows = part.factors.modes(self.time)[:, 0] @ mixing.T
        a = self.compiler.linear(rows[0], rows[1:], part.columns)
        covariance = part.mode_covariance(self.time)[0]
        ka = np.sqrt(np.einsum("qb,bc,qc->q", mixing, covariance, mixing))
        if part.form == "raw":
            return self._response(a, np.zeros_like(a), ka, np.zeros_like(ka))
        return self._times_ceeq(a, ka)

    def hot(self, rows: Rows) -> Response:
        """Displacement u0 + E g as a exp(b), b = log(E0 + E); E0 is a middle E at the horizon.

        E spans decades over the box, 1/E and so u0/E would not be polynomials; u0/(E0 + E) is.
        """
        model, made, time, start = self.model, self.compiler, self.time, self.time[:1]
        elastic, part, scale = (model.parts[n] for n in (ELASTIC, DEFORMATION, MEAN_CEEQ))
        clock = np.append(time, model.horizon_h)
        logs = scale.factors.decode(made.samples[:, scale.columns], clock, ONE)
        every = invert(scale.form, logs, clock)
        ceeq, middle = every[:, :-1], float(np.exp(np.mean(np.log(every[:, -1]))))
        g = part.factors.decode(made.samples[:, part.columns], time, rows)
        u0 = elastic.factors.decode(made.samples[:, elastic.columns], start, rows)
        a = made.fit(((u0 + ceeq * g) / (middle + ceeq)).reshape(len(g), -1))
        b = np.repeat(made.fit(np.log(middle + ceeq[:, :, 0])), len(rows), axis=0)
        share = np.mean(ceeq / (middle + ceeq), axis=0)
        ka = self._scale(part, rows) * share
        k0 = self._scale(elastic, rows, start) * np.mean(1 / (middle + ceeq), axis=0)
        kb = self._scale(scale, ONE) * np.abs(share * np.mean(g, axis=0))
        ka = np.sqrt(ka**2 + k0**2 + kb**2).ravel()
        return self._response(a, b, ka, np.zeros_like(ka))
