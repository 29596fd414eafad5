"""Have the chains converged: rank-normalised split R-hat and effective sample sizes.

Of C chains of N draws of one scalar (Vehtari, Gelman, Simpson, Carpenter & Bürkner 2021): R-hat is
the worse of that of the ranks' normal scores and of the folded draws; bulk and tail effective
sample sizes use Geyer's initial monotone sequence. The Monte-Carlo errors of mean and standard
deviation follow from the effective sizes of x and of (x − mean)², that of a correlation r of x and
y, standardised, from that of x y − r (x² + y²) / 2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, rankdata

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Convergence of one scalar: R-hat, effective sample sizes, Monte-Carlo errors in sd."""

    r_hat: float
    ess_bulk: float
    ess_tail: float
    error_mean: float
    error_sd: float


def diagnosed(x: Array) -> Diagnosis:
    """Of draws (C, N) of one scalar; errors are in units of its standard deviation.

    >>> ok = diagnosed(np.random.default_rng(0).standard_normal((4, 1000)))
    >>> ok.r_hat < 1.01, ok.ess_bulk > 3000, 0.014 < ok.error_mean < 0.018
    (True, True, True)
    """
    low, high = np.quantile(x, [0.05, 0.95])
    z, folded = _ranks(x), _ranks(np.abs(x - np.median(x)))
    d2 = (x - x.mean()) ** 2
    return Diagnosis(
        max(_r_hat(z), _r_hat(folded)),
        effective(z),
        min(effective((x <= low).astype(float)), effective((x <= high).astype(float))),
        1 / math.sqrt(effective(x)),
        float(d2.std() / d2.mean() / 2 / math.sqrt(effective(d2))),
    )


def error_of_correlation(x: Array, y: Array) -> float:
    """Monte-Carlo error of the correlation of two scalars, draws (C, N) each.

    >>> x, y = np.random.default_rng(0).standard_normal((2, 4, 1000))
    >>> 0.014 < error_of_correlation(x, y) < 0.018
    True
    """
    x, y = ((v - v.mean()) / v.std() for v in (x, y))
    moved = x * y - np.mean(x * y) * (x**2 + y**2) / 2
    return float(moved.std() / math.sqrt(effective(moved)))


def _ranks(x: Array) -> Array:
    """Normal scores of the ranks, chains pooled."""
    ranks = rankdata(x).reshape(x.shape)
    return np.asarray(norm.ppf((ranks - 0.375) / (x.size + 0.25)))


def _halves(x: Array) -> Array:
    n = x.shape[1] // 2
    return np.concatenate([x[:, :n], x[:, -n:]])


def _r_hat(x: Array) -> float:
    x = _halves(x)
    n = x.shape[1]
    within = x.var(axis=1, ddof=1).mean()
    between = x.mean(axis=1).var(ddof=1)
    return float(math.sqrt((n - 1) / n + between / within))


def effective(x: Array) -> float:
    """Effective sample size of split chains (C, N)."""
    x = _halves(x)
    c, n = x.shape
    d = x - x.mean(axis=1, keepdims=True)
    size = 2 ** math.ceil(math.log2(2 * n))
    power = np.abs(np.fft.rfft(d, size, axis=1)) ** 2
    cov = np.fft.irfft(power, size, axis=1)[:, :n].mean(axis=0) / n
    within = cov[0] * n / (n - 1)
    total = within * (n - 1) / n + x.mean(axis=1).var(ddof=1)
    rho = 1 - (within - cov * n / (n - 1)) / total
    pairs = rho[: n - n % 2].reshape(-1, 2).sum(axis=1)
    pairs[0] = 1 + rho[1]
    below = np.flatnonzero(pairs < 0)
    pairs = np.minimum.accumulate(pairs[: below[0] if below.size else len(pairs)])
    most = c * n * math.log10(c * n)
    return float(min(c * n / max(2 * pairs.sum() - 1, 1 / math.log10(c * n)), most))
