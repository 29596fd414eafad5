"""Reduction of fields to a few coefficients by a randomised singular value decomposition.

The range of a matrix A (m, n) is sampled with a Gaussian test matrix Omega (n, r + p), sharpened
by q power iterations with a re-orthogonalisation at each,

    Q = orth( (A A^T)^q A Omega ),   B = Q^T A = W S V^T,   A ~ (Q W) S V^T,

(N. Halko, P. G. Martinsson, J. A. Tropp, "Finding structure with randomness", SIAM Review 53
(2011) 217-288, algorithms 4.4 and 5.1). A `Basis` keeps the r right vectors: rows of A are
snapshots, columns are node values, and only the columns asked for are decoded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError
from core.rng import stream

Floats = NDArray[np.floating[Any]]
OVERSAMPLE = 10
ITERATIONS = 2


def randomized_svd(
    matrix: Floats,
    rank: int,
    seed: int,
    *,
    oversample: int = OVERSAMPLE,
    iterations: int = ITERATIONS,
) -> tuple[Floats, Floats, Floats]:
    """U (m, r), s (r,), Vt (r, n) of a matrix (m, n); r = min(rank, m, n).

    >>> a = np.outer([3.0, 4.0], [1.0, 0.0, 0.0])
    >>> u, s, vt = randomized_svd(a, 1, seed=1)
    >>> s.round(12).tolist(), abs(vt).round(12).tolist()
    ([5.0], [[1.0, 0.0, 0.0]])
    """
    if matrix.ndim != 2 or rank < 1:
        raise InputError(
            "rank", rank, f"does not fit shape {matrix.shape}", "give a matrix, rank 1+"
        )
    m, n = matrix.shape
    width = min(rank + oversample, m, n)
    omega = stream(seed, "randomized-svd", n, width).standard_normal((n, width))
    q, _ = np.linalg.qr(matrix @ omega.astype(matrix.dtype))
    for _ in range(iterations):
        q, _ = np.linalg.qr(matrix.T @ q)
        q, _ = np.linalg.qr(matrix @ q)
    w, s, vt = np.linalg.svd(q.T @ matrix, full_matrices=False)
    keep = min(rank, m, n)
    return (q @ w)[:, :keep], s[:keep], vt[:keep]


@dataclass(frozen=True, slots=True)
class Basis:
    """Orthonormal modes of snapshots.

    modes     (n, r), orthonormal columns
    singular  (r,), descending
    total     squared Frobenius norm of the snapshots: the energy of all modes
    """

    modes: Floats
    singular: Floats
    total: float

    @classmethod
    def of(cls, snapshots: Floats, rank: int, seed: int) -> Basis:
        """The leading `rank` modes of snapshots (m, n)."""
        _, s, vt = randomized_svd(snapshots, rank, seed)
        return cls(np.ascontiguousarray(vt.T), s, float(np.sum(snapshots.astype(float) ** 2)))

    @property
    def energy(self) -> NDArray[np.float64]:
        """Share of the energy in the first 1, 2, … r modes, (r,)."""
        share = np.cumsum(self.singular.astype(float) ** 2) / self.total
        return np.asarray(np.minimum(share, 1.0))

    def residual(self) -> NDArray[np.float64]:
        """Norm of what the first 1, 2, … r modes leave of the snapshots, (r,)."""
        left = self.total - np.cumsum(self.singular.astype(float) ** 2)
        return np.asarray(np.sqrt(np.maximum(left, 0.0)))

    def head(self, rank: int) -> Basis:
        """The first `rank` modes alone."""
        return Basis(np.ascontiguousarray(self.modes[:, :rank]), self.singular[:rank], self.total)

    def encode(self, snapshots: Floats) -> Floats:
        """Coefficients (…, r) of snapshots (…, n)."""
        return np.asarray(snapshots @ self.modes)

    def decode(self, coefficients: Floats, rows: Sequence[int] | None = None) -> Floats:
        """Values (…, n) of coefficients (…, r), or only the `rows` asked for."""
        modes = self.modes if rows is None else self.modes[list(rows)]
        return np.asarray(coefficients @ modes.T)

    def held_out_error(self, snapshots: Floats) -> float:
        """Relative root-mean-square error of reconstructing snapshots the basis has not seen."""
        lost = snapshots - self.decode(self.encode(snapshots))
        return float(np.linalg.norm(lost) / np.linalg.norm(snapshots))
