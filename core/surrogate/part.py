"""One part of the surrogate and the size of its error.

Row r of a part at time t is linear in its coefficients, g(t, r; x) = g0(t, r) + D(t, r) c(x).
Its error has the variance k(t, r)^2 v(x)^p, v the relative variance of the process
(`core.surrogate.kernel`), and

    k(t, r)^2 = f^2 v_typical^(1 - p) [ D C D^T + cut(t)^2 cut(r)^2 / v_typical ],
    C = 1/n sum_i e_i e_i^T / v_i,

with e_i, v_i the leave-one-out residuals of run i: an empirical covariance, so that errors of
neighbouring nodes and instants are correlated as they are seen to be. ``cut`` is the rms that
the truncated bases leave, f makes the 95 % intervals cover 95 % in cross-validation over the
training runs (`core.surrogate.held_out`).

The power p is 1 for what the process alone gets wrong. What truncated bases lose goes up more
slowly with v: where runs stand close it is more than in proportion to v, and less than what is lost
on average over a wide box. So p is what cross-validation finds, where it is surely less than 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.surrogate.targets import Form
from core.surrogate.tucker import Factors

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Part:
    """One target: how y comes of it, its factors, its columns of the process, its error.

    left_out  e_i / sqrt(n v_i), (J, n): C = left_out @ left_out^T
    cut_time, cut_space   rms left by the truncation, (T,) and (R,), their product is used
    inflation, power      f and p of the module's text
    """

    form: Form
    factors: Factors
    columns: slice
    left_out: Array
    cut_time: Array
    cut_space: NDArray[np.float32]
    inflation: float
    power: float = 1.0

    def forms(self, time_h: Array, rows: Rows) -> tuple[Array, Array]:
        """g0 (T', R') and D (J, T', R')."""
        modes = self.factors.modes(time_h)
        decoded = modes @ self.factors.space[rows].T.astype(float)
        return decoded[0], decoded[1:]

    def mode_covariance(self, time_h: Array) -> Array:
        """Covariance (T', B, B) of the spatial modes' coefficients, relative to v."""
        modes = self.factors.modes(time_h)[1:]
        half = np.tensordot(modes, self.left_out, axes=(0, 0))
        return np.asarray(self.inflation**2 * (half @ half.transpose(0, 2, 1)))

    def scale(self, time_h: Array, rows: Rows, v_typical: float) -> Array:
        """k (T', R') of the module's text."""
        space = self.factors.space[rows].astype(float)
        seen = np.einsum("trb,rb->tr", space @ self.mode_covariance(time_h), space)
        cut = np.outer(self._cut_at(time_h), self.cut_space[rows]) ** 2 / v_typical
        k = np.sqrt(np.maximum(seen, 0.0) + self.inflation**2 * cut)
        return np.asarray(k * v_typical ** (0.5 * (1.0 - self.power)))

    def relative(self, v: Array) -> Array:
        """v^p: what the squares of `scale` are multiplied by."""
        return v if self.power == 1.0 else np.asarray(v**self.power)

    def _cut_at(self, time_h: Array) -> Array:
        return np.asarray(np.interp(time_h, self.factors.time_h, self.cut_time))
