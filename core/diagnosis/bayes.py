"""Bayes factors of effects with standard-normal amplitudes, against none, to second order.

With score u, information I and scatter phi (`core.diagnosis.scatter`), both in expected sizes:

    log BF = ½ vᵀ (1 + J)⁻¹ v − ½ log |1 + J|,      v = u / phi,  J = I / √(phi phiᵀ)

of one amplitude or of several together. One with a known sign is half-normal: times 2 Φ(z), z the
amplitude over its standard deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

Array = NDArray[np.float64]


def one_by_one(u: Array, information: Array, phi: Array, signs: NDArray[np.int64]) -> Array:
    """log BF of each cell by itself, all arrays (C,); information: its own; signs: 1 where known.

    >>> one_by_one(np.array([3.0]), np.array([8.0]), np.ones(1), np.array([0])).round(3).tolist()
    [-0.599]
    """
    scaled: Array = np.asarray(information / phi)
    z = (u / phi) / np.sqrt(1 + scaled)
    gains: Array = 0.5 * z**2 - 0.5 * np.log1p(scaled)
    return np.asarray(np.where(signs > 0, gains + np.log(2.0) + log_ndtr(z), gains))


def together(u: Array, information: Array, phi: Array) -> float:
    """log BF of a set without signs: u, phi (k,), information (k, k).

    >>> round(together(np.array([3.0]), np.array([[8.0]]), np.ones(1)), 3)
    -0.599
    """
    root = np.sqrt(phi)
    a = information / np.outer(root, root) + np.eye(len(u))
    own = u / phi
    return float(0.5 * own @ np.linalg.solve(a, own) - 0.5 * np.linalg.slogdet(a)[1])


@dataclass(frozen=True, slots=True)
class Grouped:
    """Cells family by family: their places in that order, where each family begins, its size."""

    order: NDArray[np.int64]
    first: NDArray[np.int64]
    size: NDArray[np.int64]

    @staticmethod
    def of(families: Sequence[Sequence[int]]) -> Grouped:
        """From the places of each family's cells."""
        size = np.array([len(own) for own in families], dtype=np.int64)
        order = np.array([i for own in families for i in own], dtype=np.int64)
        return Grouped(order, np.cumsum(size) - size, size)

    def log_means(self, gains: Array) -> list[float]:
        """log of the mean Bayes factor of each family's cells, from those of all (C,).

        >>> [round(v, 3) for v in Grouped.of([[0, 2], [1]]).log_means(np.log([1.0, 5.0, 3.0]))]
        [0.693, 1.609]
        """
        if not len(self.size):
            return []
        own = gains[self.order]
        top = np.maximum.reduceat(own, self.first)
        total = np.add.reduceat(np.exp(own - np.repeat(top, self.size)), self.first)
        return list((top + np.log(total / self.size)).tolist())
