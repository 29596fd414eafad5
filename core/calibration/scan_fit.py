"""The best fit of a scan: the model's inputs, and its discrepancy with them.

In the space of its modes (`scans`) a scan reads z (J,), and the discrepancy is a gain or an offset
in standard-normal eta,

    z = g(eta) Y_m(x) + o(eta) + error,      error_j ~ N(0, sigma² + S_jj).

What the remainder says of the offset, told eta − miss ~ N(0, sigma² I), counts as well, so that the
best fit (x*, eta*) is where

    Σ_j (g Y_m,j + o_j − z_j)² / (sigma² + S_jj) + |eta|² + |told eta − miss|² / sigma²

is least: by least squares from the best of `STARTS` even points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import ndtri
from scipy.stats import qmc

from core.response import Response

Array = NDArray[np.float64]
STARTS = 4096


@dataclass(frozen=True, slots=True)
class Shift:
    """The discrepancy of z in standard-normal eta: z = gain(eta) Y_m + offset(eta).

    gain          mean and sd of the gain under the priors; sd 0: no gain
    mean, column  of the offset, (J,) and (J, 0 or 3)
    told, miss    what the remainder says of eta: told @ eta − miss ~ N(0, noise² I)
    """

    gain: tuple[float, float]
    mean: Array
    column: Array
    told: Array
    miss: Array

    @property
    def dim(self) -> int:
        return int(self.gain[1] > 0) + int(self.column.shape[1])

    def at(self, eta: Array) -> tuple[Array, Array]:
        """Gain (n, 1) and offset (n, J) at eta (n, dim)."""
        free = eta[:, : int(self.gain[1] > 0)].sum(axis=1, keepdims=True)
        offset = eta[:, eta.shape[1] - self.column.shape[1] :]
        return self.gain[0] + self.gain[1] * free, self.mean + offset @ self.column.T


def best_fit(
    response: Response, shift: Shift, y: Array, noise: float, unknown: Array
) -> tuple[Array, Array]:
    """Inputs, and eta of the discrepancy, that fit best: least squares from the best of many."""
    d = len(response.names)
    start = qmc.Sobol(d + shift.dim, scramble=True, rng=np.random.default_rng(0)).random(STARTS)
    x = response.low + start[:, :d] * (response.high - response.low)
    eta = ndtri(np.clip(start[:, d:], 1e-6, 1 - 1e-6))
    mean, sd = response.evaluate(x)
    gain, offset = shift.at(eta)
    variance = noise**2 + unknown + sd**2
    score = np.sum((gain * mean + offset - y) ** 2 / variance + np.log(variance), axis=1)
    weights = 1.0 / np.sqrt(noise**2 + unknown)

    def miss(at: Array) -> Array:
        x, eta = response.low + at[:d] * (response.high - response.low), at[d:]
        gain, offset = shift.at(eta[None])
        fit = (gain[0] * response.evaluate(x[None])[0][0] + offset[0] - y) * weights
        told = eta[len(eta) - shift.column.shape[1] :]
        return np.concatenate([fit, eta, (shift.told @ told - shift.miss) / noise])

    low, high = np.r_[np.zeros(d), np.full(shift.dim, -6.0)], np.r_[np.ones(d), [6.0] * shift.dim]
    begin = np.hstack([np.clip(start[:, :d], 1e-6, 1 - 1e-6), eta])
    fits = [
        least_squares(miss, begin[i], bounds=(low, high), max_nfev=40)
        for i in np.argsort(score)[:3]
    ]
    best = min(fits, key=lambda f: f.cost).x
    return np.asarray(response.low + best[:d] * (response.high - response.low)), best[d:]
