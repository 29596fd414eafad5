"""Polynomials of the process's coefficients.

Every row of every part is linear in the coefficients c(z), so it is enough to fit polynomials of
total degree p to those once: P (J, M) by least squares at points with the density of Chebyshev
nodes in [-1, 1]^d (Sobol numbers u, z = -cos(pi u)), which keeps the error even up to the edge
of the box. A row then costs one small product, D P. Points, not randomness: nothing is seeded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import qmc

from core.response import monomials, multi_indices
from core.surrogate.kernel import SharedGP

Array = NDArray[np.float64]
OVERSAMPLING = 12


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
        d = process.z.shape[1]
        terms = len(multi_indices(d, degree))
        power = int(np.ceil(np.log2(OVERSAMPLING * terms)))
        sobol = qmc.Sobol(d, scramble=False).random_base2(power)
        points = -np.cos(np.pi * (sobol + 0.5 / 2**power))
        basis = monomials(points, degree)
        # normal equations on an orthonormalised basis: monomials alone are ill-conditioned
        _, r = np.linalg.qr(basis)
        whitened = np.linalg.solve(r.T, basis.T)
        factor = np.linalg.solve(r, cho_solve(cho_factor(whitened @ whitened.T), whitened))
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
