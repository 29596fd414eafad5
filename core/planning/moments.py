"""A campaign's readings as a calibrated model expects them: normal, with few common directions.

With f the rows of a blade, s the shared parameters and S what noise and surrogate add,

    y ~ N(m, diag_b(W_b) + U Uᵀ),     m_b = E f_b,     W_b = E Cov[f_b | s] + E S_b,
    U_b = E[f_b | s] − m_b  over the weighted nodes of s

which holds of the particles' moments whatever the number of blades: U has few columns. With
W = L Lᵀ blade by blade and A = L⁻¹ U

    (y − m)ᵀ (W + U Uᵀ)⁻¹ (y − m) = |u|² − uᵀ A (1 + Aᵀ A)⁻¹ Aᵀ u,     u = L⁻¹ (y − m)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Awaited:
    """What a model expects of B blades' c rows; see the module's text.

    mean (B, c); own W (B, c, c); common U (B, c, r)
    """

    mean: Array
    own: Array
    common: Array

    @cached_property
    def _root(self) -> Array:
        """Of W by Cholesky, (B, c, c)."""
        return np.asarray(np.linalg.cholesky(self.own))

    @cached_property
    def _whitened(self) -> tuple[Array, Array, Array]:
        """Its inverse R, R U (B, c, r) and the inverse of 1 + (R U)ᵀ R U."""
        inverse = np.asarray(np.linalg.inv(self._root))
        a = inverse @ self.common
        inner = np.eye(a.shape[2]) + np.tensordot(a, a, axes=([0, 1], [0, 1]))
        return inverse, a, np.asarray(np.linalg.inv(inner))

    def drawn(self, count: int, rng: np.random.Generator) -> Array:
        """Readings, (count, B, c)."""
        own = rng.standard_normal((count, *self.mean.shape)).transpose(1, 2, 0)
        shared = rng.standard_normal((count, self.common.shape[2]))
        of_all = np.tensordot(shared, self.common, axes=([1], [2]))
        return np.asarray(self.mean + (self._root @ own).transpose(2, 0, 1) + of_all)

    def log_density(self, y: Array) -> Array:
        """Of readings (k, B, c), less what is the same for all: (k,)."""
        inverse, a, within = self._whitened
        u = inverse @ (y - self.mean).transpose(1, 2, 0)  # (B, c, k)
        across = np.tensordot(a, u, axes=([0, 1], [0, 1]))  # (r, k)
        square = np.sum(u**2, axis=(0, 1)) - np.sum(across * (within @ across), axis=0)
        log_det = 2.0 * np.log(np.einsum("bii->bi", self._root)).sum()
        return np.asarray(-0.5 * (square + log_det - np.linalg.slogdet(within)[1]))
