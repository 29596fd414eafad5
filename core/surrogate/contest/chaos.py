"""Sparse polynomial chaos.

With inputs z uniform in [-1, 1]^d the orthonormal polynomials are products of Legendre's,

    Psi_a(z) = prod_i sqrt(2 a_i + 1) P_{a_i}(z_i),     E[Psi_a Psi_b] = [a = b],

over the multi-indices a with ( sum_i a_i^q )^(1/q) <= p: total degree p for q = 1, fewer mixed
terms below (G. Blatman, B. Sudret, J. Comput. Phys. 230 (2011) 2345-2367). Each output picks its
terms by orthogonal matching pursuit, the one that explains most of what is left first, and stops
where the leave-one-out error

    E_m = T_m  mean_i ( (y_i - yhat_i) / (1 - h_i) )^2,     T_m = n (1 + m / n) / (n - m),

is smallest (h the leverage, m terms; the factor T for small samples after O. Chapelle,
V. Vapnik, Y. Bengio, Machine Learning 48 (2002) 9-23, with the terms as orthogonal as they are in
expectation). Without search all terms are fitted by least squares.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from core.monomials import multi_indices

Array = NDArray[np.float64]
Table = NDArray[np.int64]
MOST = 0.7
"""Terms at most, as a share of the runs."""


@lru_cache(maxsize=32)
def hyperbolic(d: int, degree: int, q: float) -> Table:
    """Multi-indices (M, d) of q-norm `degree` at most, the constant first.

    >>> hyperbolic(2, 2, 1.0).tolist()
    [[0, 0], [0, 1], [1, 0], [0, 2], [1, 1], [2, 0]]
    >>> hyperbolic(2, 2, 0.5).tolist()
    [[0, 0], [0, 1], [1, 0], [0, 2], [2, 0]]
    """
    table = multi_indices(d, degree)
    norm = np.sum(table.astype(float) ** q, axis=1) ** (1.0 / q)
    chosen: Table = table[norm <= degree + 1e-9]
    chosen.flags.writeable = False
    return chosen


def legendre(z: Array, table: Table) -> Array:
    """Psi (n, M) at z (n, d).

    >>> legendre(np.array([[0.5]]), np.array([[0], [1], [2]])).round(4).tolist()
    [[1.0, 0.866, -0.2795]]
    """
    degree = int(table.max())
    p = np.ones((degree + 1, *z.shape))
    if degree:
        p[1] = z
    for k in range(1, degree):
        p[k + 1] = ((2 * k + 1) * z * p[k] - k * p[k - 1]) / (k + 1)
    p *= np.sqrt(2.0 * np.arange(degree + 1) + 1.0)[:, None, None]
    out = np.ones((len(z), len(table)))
    for i in range(z.shape[1]):
        out *= p[table[:, i], :, i].T
    return out


@dataclass(frozen=True, slots=True)
class Chaos:
    """table: multi-indices (M, d); weights (M, J); error: leave-one-out error of each output."""

    table: Table
    weights: Array
    error: Array

    def __call__(self, z: Array) -> Array:
        return np.asarray(legendre(z, self.table) @ self.weights)

    @property
    def terms(self) -> NDArray[np.int64]:
        """Terms of each output, (J,)."""
        return np.asarray(np.count_nonzero(self.weights, axis=0))

    @classmethod
    def fit(cls, z: Array, y: Array, degree: int, q: float = 1.0, *, sparse: bool = True) -> Chaos:
        """Through y (n, J) at z (n, d); not sparse where the runs do not carry it: sparse."""
        table = hyperbolic(z.shape[1], degree, q)
        psi = legendre(z, table)
        n, terms = psi.shape
        most = max(min(int(MOST * n), terms), 1)
        if not sparse and terms <= most:
            weights: Array = np.asarray(np.linalg.lstsq(psi, y, rcond=None)[0], dtype=float)
            basis, _ = np.linalg.qr(psi)
            left = (y - psi @ weights) / (1.0 - np.sum(basis**2, axis=1))[:, None]
            return cls(table, weights, penalty(n, terms) * np.mean(left**2, axis=0))
        weights = np.zeros((terms, y.shape[1]))
        error = np.zeros(y.shape[1])
        for j in range(y.shape[1]):
            chosen, error[j] = pursuit(psi, y[:, j], most)
            weights[chosen, j] = np.linalg.lstsq(psi[:, chosen], y[:, j], rcond=None)[0]
        return cls(table, weights, error)


def penalty(n: int, terms: int) -> float:
    """T of the module's text.

    >>> penalty(60, 20)
    2.0
    """
    return (n + terms) / max(n - terms, 1)


def pursuit(psi: Array, y: Array, most: int) -> tuple[list[int], float]:
    """Terms in the order of their choice, the constant first, and their leave-one-out error."""
    n = len(psi)
    q0 = psi[:, 0] / np.linalg.norm(psi[:, 0])
    rest = psi - np.outer(q0, q0 @ psi)
    left, leverage = y - q0 * (q0 @ y), q0**2
    whole = np.sum(psi**2, axis=0)
    chosen, best, smallest = [0], 1, penalty(n, 1) * float(np.mean((left / (1 - leverage)) ** 2))
    for m in range(2, most + 1):
        square = np.sum(rest**2, axis=0)
        free = square > 1e-8 * whole
        free[chosen] = False
        if not np.any(free):
            break
        gain = np.where(free, (left @ rest) ** 2 / np.where(free, square, 1.0), -1.0)
        at = int(np.argmax(gain))
        q = rest[:, at] / np.sqrt(square[at])
        rest = rest - np.outer(q, q @ rest)
        left, leverage = left - q * (q @ left), leverage + q**2
        chosen.append(at)
        if np.any(leverage > 1.0 - 1e-9):
            break
        error = penalty(n, m) * float(np.mean((left / (1.0 - leverage)) ** 2))
        if error < smallest:
            best, smallest = m, error
    return chosen[:best], smallest
