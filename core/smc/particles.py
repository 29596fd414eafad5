"""A weighted sample, and what is done with one.

A particle set approximates a distribution by points psi_i with weights w_i,

    E f ≈ Σ_i w_i f(psi_i),   w_i ∝ exp(log_w_i),   ESS = (Σ w_i)² / Σ w_i²,

where ESS, the effective sample size, is the number of equally weighted points of the same
Monte-Carlo error (Chopin & Papaspiliopoulos, *An Introduction to Sequential Monte Carlo*, 2020,
ch. 8 and 9). The set is a value: every function returns a new one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def log_sum_exp(log_w: Array) -> float:
    """log Σ exp(log_w), safe for any range; −inf where every weight is zero."""
    top = float(np.max(log_w))
    if top == -np.inf:
        return -np.inf
    return top + float(np.log(np.exp(log_w - top).sum()))


def normalised(log_w: Array) -> Array:
    """Weights that sum to one."""
    w = np.exp(log_w - log_sum_exp(log_w))
    return np.asarray(w / w.sum())


def ess(log_w: Array) -> float:
    """Effective sample size of unnormalised log weights.

    >>> round(ess(np.zeros(50)), 9)
    50.0
    """
    w = np.exp(log_w - np.max(log_w))
    total = w.sum()
    return float(total * total / (w @ w))


def tempering_exponent(log_ratio: Array, target_ess: float) -> float:
    """Largest beta in [0, 1] for which weights exp(beta · log_ratio) keep `target_ess`.

    Bisection on the monotone ESS(beta) (Del Moral, Doucet & Jasra, 2012).
    """
    finite = np.where(np.isfinite(log_ratio), log_ratio, -1e300)
    if ess(finite) >= target_ess:
        return 1.0
    below, low, high = finite - np.max(finite), 0.0, 1.0
    for _ in range(60):
        mid = 0.5 * (low + high)
        w = np.exp(mid * below)
        if float(w.sum()) ** 2 >= target_ess * float(w @ w):
            low = mid
        else:
            high = mid
    return low


def weighted_quantile(x: Array, w: Array, p: Array) -> Array:
    """Quantiles of a weighted sample by the mid-point distribution function.

    >>> weighted_quantile(np.array([3.0, 1.0, 2.0]), np.ones(3) / 3, np.array([0.5])).tolist()
    [2.0]
    """
    order = np.argsort(x, kind="stable")
    f = np.cumsum(w[order])
    return np.interp(p, f - 0.5 * w[order], x[order])


@dataclass(frozen=True, slots=True)
class Particles:
    """Weighted points psi (N, P) with log weights log_w (N,); both read-only."""

    psi: Array
    log_w: Array

    def __post_init__(self) -> None:
        if self.psi.ndim != 2 or self.log_w.shape != (self.psi.shape[0],):
            raise ValueError(f"psi {self.psi.shape} and log_w {self.log_w.shape} do not fit")
        for name in ("psi", "log_w"):
            value = np.array(getattr(self, name), dtype=np.float64)
            value.flags.writeable = False
            object.__setattr__(self, name, value)

    @property
    def w(self) -> Array:
        return normalised(self.log_w)

    @property
    def ess(self) -> float:
        return ess(self.log_w)

    @property
    def mean(self) -> Array:
        return self.w @ self.psi

    @property
    def covariance(self) -> Array:
        """Weighted covariance, shape (P, P)."""
        d = self.psi - self.mean
        return np.asarray((d * self.w[:, None]).T @ d)

    def reweighted(self, log_likelihood: Array) -> tuple[Particles, float]:
        """The set after a Bayes step, and the log evidence log Σ w_i L_i of the data.

        >>> before = Particles(np.array([[0.0], [1.0]]), np.zeros(2))
        >>> after, log_evidence = before.reweighted(np.log([0.2, 0.6]))
        >>> after.w.round(3).tolist(), round(float(np.exp(log_evidence)), 3)
        ([0.25, 0.75], 0.4)
        """
        log_w = self.log_w + log_likelihood
        return Particles(self.psi, log_w), log_sum_exp(log_w) - log_sum_exp(self.log_w)

    def resampled(self, n: int, rng: np.random.Generator) -> Particles:
        """`n` equally weighted particles by systematic resampling."""
        places = (np.arange(n) + rng.random()) / n
        index = np.searchsorted(np.cumsum(self.w), places)
        return Particles(self.psi[np.minimum(index, len(self.psi) - 1)], np.zeros(n))

    def quantile(self, p: Array) -> Array:
        """Quantiles of each coordinate, shape (len(p), P)."""
        w = self.w
        return np.stack(
            [weighted_quantile(self.psi[:, j], w, p) for j in range(self.psi.shape[1])], axis=1
        )
