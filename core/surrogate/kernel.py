"""One Gaussian process for all coefficients.

Every coefficient c_j (j = 1 … J) of the reduced model is a function of the same d inputs
z in [-1, 1]^d and gets the same correlation, a trend and a scale of its own:

    c_j(z) = h(z)^T beta_j + sigma_j g_j(z),    cov(g_j(z), g_j(z')) = k(z, z'),
    k(z, z') = 1 / (1 + 1/2 sum_i (z_i - z'_i)^2 / l_i^2) + nugget [z = z'],

the rational quadratic kernel with alpha = 1. (On blade runs its leave-one-out error of the tip
elongation, median and 95th percentile, was 0.28 and 1.55 %; the squared exponential's 0.30 and
1.63, Matern 7/2's 0.34 and 1.72, Matern 5/2's 0.44 and 2.00.)

With R the correlation matrix of the n runs, H (n, p) their trend rows and

    Q = R^-1 - R^-1 H (H^T R^-1 H)^-1 H^T R^-1,

sigma_j^2 is c_j^T Q c_j / (n - p), and length scales and nugget are those of the maximum restricted
likelihood (`core.surrogate.likelihood`). Because R is shared there is one predictive variance,
relative to the prior's, for everything:

    v(z) = 1 + nugget - k^T R^-1 k + u^T (H^T R^-1 H)^-1 u,   u = h(z) - H^T R^-1 k,

and the leave-one-out residuals have the closed form e_ij = [Q c_j]_i / Q_ii with v_i = 1 / Q_ii.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular

from core.errors import ModelError
from core.monomials import monomials
from core.pools import by_rows

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Hyper:
    """Length scales (d,) in units of half the input's interval, nugget, degree of the trend."""

    lengths: tuple[float, ...]
    nugget: float
    trend: int


def correlation(z: Array, other: Array, lengths: Array) -> Array:
    """1 / (1 + |z - z'|^2 / 2) in scaled units, (n, m).

    >>> correlation(np.array([[0.0]]), np.array([[2.0]]), np.array([2.0])).round(4).tolist()
    [[0.6667]]
    """
    a, b = z / lengths, other / lengths
    # |a - b|^2 / 2 as one product: [a, |a|^2/2, 1] . [-b, 1, |b|^2/2]
    left = np.column_stack([a, 0.5 * np.sum(a * a, axis=1), np.ones(len(a))])
    right = np.column_stack([-b, np.ones(len(b)), 0.5 * np.sum(b * b, axis=1)])
    out = left @ right.T
    if "numba" in sys.modules:
        from core.surrogate.near import nearness

        nearness(out)
        return np.asarray(out)
    np.maximum(out, 0.0, out=out)
    out += 1.0
    return np.asarray(np.reciprocal(out, out=out))


def carries(z: Array, trend: int) -> bool:
    """Whether inputs z (n, d) tell the terms of a trend apart.

    >>> star = np.array([[0, 0], [-1, 0], [1, 0], [0, -1], [0, 1], [0.5, 0], [0, 0.5]])
    >>> carries(star, 1), carries(star, 2)
    (True, False)
    """
    h = monomials(z, trend)
    return bool(np.linalg.matrix_rank(h) == min(h.shape[1], len(z)))


def _along(a: Array, b: Array) -> Array:
    """Products of rows (m, n) with rows, (m,)."""
    return np.asarray(np.einsum("ij,ij->i", a, b))


@dataclass(frozen=True, slots=True)
class SharedGP:
    """The conditioned process.

    z        runs' inputs in [-1, 1], (n, d)
    hyper    length scales, nugget, degree of the trend
    weights  R^-1 (C - H beta), (n, J)
    beta     trend coefficients, (p, J)
    whiten   L^-1 with R = L L^T, (n, n)
    trend    rows that turn u into its whitened part: (H^T R^-1 H)^{-1/2}, (p, p)
    h_solve  R^-1 H, (n, p)
    """

    z: Array
    hyper: Hyper
    weights: Array
    beta: Array
    whiten: Array
    trend: Array
    h_solve: Array

    @classmethod
    def condition(cls, z: Array, targets: Array, hyper: Hyper) -> SharedGP:
        """Condition on targets (n, J) at z (n, d); with a lower trend where the runs carry none so
        high (two levels of an input, one input changed at a time)."""
        while hyper.trend and not carries(z, hyper.trend):
            hyper = replace(hyper, trend=hyper.trend - 1)
        h = monomials(z, hyper.trend)
        if len(z) < h.shape[1] + 2:
            raise ModelError(
                f"{len(z)} runs do not carry a trend of {h.shape[1]} terms: "
                f"make at least {h.shape[1] + 2} runs"
            )
        lengths = np.array(hyper.lengths)
        r = correlation(z, z, lengths)
        r[np.diag_indices_from(r)] += hyper.nugget
        lower = cholesky(r, lower=True)
        whiten = solve_triangular(lower, np.eye(len(z)), lower=True)
        h_solve = whiten.T @ (whiten @ h)
        gram = h.T @ h_solve
        factor = cho_factor(gram, lower=True)
        beta = cho_solve(factor, h_solve.T @ targets)
        weights = whiten.T @ (whiten @ (targets - h @ beta))
        trend = solve_triangular(factor[0], np.eye(h.shape[1]), lower=True)
        return cls(z, hyper, weights, beta, whiten, trend, h_solve)

    def mean(self, z: Array, columns: Sequence[slice] = (slice(None),)) -> list[Array]:
        """At z (m, d): coefficients (m, J') of each set of columns."""

        def work(z: Array) -> tuple[Array, ...]:
            k, h = self._seen(z)
            return tuple(k @ self.weights[:, some] + h @ self.beta[:, some] for some in columns)

        return list(by_rows(work, z))

    def mean_and_variance(
        self, z: Array, columns: Sequence[slice] = (slice(None),)
    ) -> tuple[list[Array], Array]:
        """At z (m, d): coefficients (m, J') of each set of columns, the shared v (m,)."""

        def work(z: Array) -> tuple[Array, ...]:
            k, h = self._seen(z)
            means = (k @ self.weights[:, some] + h @ self.beta[:, some] for some in columns)
            half, u = self._errors(k, h)
            return *means, self._variance(half, u)

        *means, v = by_rows(work, z)
        return means, v

    def _seen(self, z: Array) -> tuple[Array, Array]:
        """Correlations with the runs (m, n) and trend rows (m, p)."""
        lengths = np.array(self.hyper.lengths)
        return correlation(z, self.z, lengths), monomials(z, self.hyper.trend)

    def _errors(self, k: Array, h: Array) -> tuple[Array, Array]:
        """What the runs, (m, n), and the trend, (m, p), leave unknown, whitened."""
        return k @ self.whiten.T, (h - k @ self.h_solve) @ self.trend.T

    def _variance(self, half: Array, u: Array) -> Array:
        v = 1.0 - _along(half, half) + _along(u, u)
        return np.asarray(np.maximum(v, 0.0) + self.hyper.nugget)

    def covariance(self, z: Array, others: Array) -> tuple[Array, Array, Array]:
        """At z (m, d) v, (m,), and of each of T others (m, T, d) v' and the posterior covariance
        of its error with that at z, (m, T) each.

        The nugget, what the kernel cannot follow, is taken for alike where inputs are nearly so.
        """
        lengths = np.array(self.hyper.lengths)

        def work(z: Array, others: Array) -> tuple[Array, ...]:
            half, u = self._errors(*self._seen(z))
            told = []
            for other in np.moveaxis(others, 1, 0):
                half1, u1 = self._errors(*self._seen(other))
                prior = 1.0 / (1.0 + 0.5 * np.sum(((other - z) / lengths) ** 2, axis=1))
                alike = (1.0 + self.hyper.nugget) * prior
                both = alike - _along(half1, half) + _along(u1, u)
                told.append((self._variance(half1, u1), both))
            v1, c = (np.stack(column, axis=1) for column in zip(*told, strict=True))
            return self._variance(half, u), v1, c

        v, v1, c = by_rows(work, z, others)
        return v, v1, c

    def cross_covariance(self, z: Array, other: Array) -> Array:
        """Posterior covariance of the errors at every pair of z (n, d), z' (m, d): (n, m).

        Relative to sigma_j^2 as v is, without the nugget: c(z, z) = v(z) - nugget.
        """
        (half, u), (half1, u1) = (self._errors(*self._seen(at)) for at in (z, other))
        prior = correlation(z, other, np.array(self.hyper.lengths))
        return np.asarray(prior - half @ half1.T + u @ u1.T)

    def left_out(self) -> tuple[Array, Array]:
        """Leave-one-out residuals e (n, J) and their relative variances v (n,)."""
        q = self.whiten.T @ self.whiten
        tall = self.trend @ self.h_solve.T
        diagonal = np.diag(q) - np.einsum("ij,ij->j", tall, tall)
        # Q c = R^-1 (c - H beta): the weights
        return self.weights / diagonal[:, None], 1.0 / diagonal
