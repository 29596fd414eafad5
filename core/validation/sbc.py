"""Where truths fall in their posteriors: ranks, their distribution, and a verdict.

If truths come from the prior and data from the likelihood, the posterior probability below the
truth (PIT) is uniform (Cook, Gelman & Rubin 2006; Talts et al. 2018).

**Ranks of weighted particles.** A posterior of K particles s_k of a proposal q with weights
w = p/q is a discrete distribution, and the sum of the weights below the truth s_0 is not uniform,
however right the weights are. But s_0 ~ p and s_1 … s_K ~ q have the joint density
w(s_0) Π q(s_j): given the set of all K + 1, each is the truth with a probability in proportion to
its weight. With U uniform,

    u = (Σ_{s_k < s_0} w_k + U (w_0 + Σ_{s_k = s_0} w_k)) / (w_0 + Σ_k w_k)

is therefore uniform exactly, for any K. The truth's own weight w_0 is not known to a particle set;
its mean over the posterior is Σ w² / Σ w, which stands for it (exact for equal weights; else off
by the order of 1/K). This tests the target; what K nodes do to a published interval is seen by its
coverage, which uses the distribution function that published quantiles use (`published_cdf`).

The argument needs independent particles. The 64 or 128 nodes of the shared level are Sobol points,
which stand in their strata whatever the truth: given the set of all, the truth is the one between
two strata, and counting its own weight in empties half of both outer hundredths (of a normal known
exactly, F − z is −0.005 … −0.008 at 0.01 and 0.005 … 0.007 at 0.99; `node_pit` leaves 0.002 there).
Their ranks are those of the published distribution function, which is what Sobol points converge
to; beyond the outer nodes, where it is 0 or 1, u shares out half of an outer node's weight.

**The band.** The share F(z) of N independent uniforms below z is binomial; a band of pointwise
level gamma holds F at all of 99 places with probability 0.95, gamma found by simulation
(Säilynoja, Bürkner & Vehtari 2022). Blades of one rotor share its posterior and are not
independent: where truths come in clusters, N is divided at each z by the design effect, the
variance of F between clusters over the binomial one (Kish 1965; smoothed over a fifth of the range,
at least that of the whole range, at least 1). As that is estimated from R clusters, it grows by
R / (R − 4) and by the square of the ratio of Student's to normal quantiles; the band is the wider
one at each z, with and without that growth (fewer truths would be a narrower band near 0 and 1,
where one cluster is a large step). False alarms, simulated: 4 – 6 % for independent uniforms, at
most 4 % for 7, 24 or 60 clusters of 3 to 20 with correlations from 0 to 0.95.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr
from scipy.stats import binom, norm, t

from core.rng import stream

Array = NDArray[np.float64]
Clusters = NDArray[np.int64]
PROBABILITIES = (0.5, 0.68, 0.9, 0.95)
PLACES = np.arange(1, 100) / 100
SIMULATED = 4000
WINDOW = 21  # places over which the design effect is smoothed
FEWEST = 6  # clusters of several truths each that a band needs
NARROW, SHIFT = 0.7, 0.5
CONTROLS = ("narrow", "shifted", "laplace")


def randomised_pit(values: Array, w: Array, truth: float, u: float) -> float:
    """PIT of a truth in weighted particles (N,); u uniform decides ties. See the module's text.

    >>> randomised_pit(np.array([1.0, 2.0, 3.0]), np.ones(3) / 3, 2.5, 0.0)
    0.5
    """
    total = float(w.sum())
    own = float(w @ w) / total
    below, tied = float(w @ (values < truth)), float(w @ (values == truth))
    return (below + u * (own + tied)) / (own + total)


def published_cdf(values: Array, w: Array, truth: float) -> float:
    """The inverse of `core.smc.particles.weighted_quantile`; 0 and 1 beyond the particles."""
    order = np.argsort(values, kind="stable")
    middle = np.cumsum(w[order]) - 0.5 * w[order]
    return float(np.interp(truth, values[order], middle / w.sum(), left=0.0, right=1.0))


def node_pit(values: Array, w: Array, truth: float, u: float) -> float:
    """PIT of a truth among weighted Sobol nodes (N,); u uniform decides beyond the outer ones.

    >>> [node_pit(np.arange(4.0), np.ones(4) / 4, truth, 0.5) for truth in (-1.0, 1.5, 9.0)]
    [0.0625, 0.5, 0.9375]
    """
    lowest, highest = int(np.argmin(values)), int(np.argmax(values))
    if truth < values[lowest]:
        return float(0.5 * u * w[lowest] / w.sum())
    if truth > values[highest]:
        return float(1.0 - 0.5 * u * w[highest] / w.sum())
    return published_cdf(values, w, truth)


Rank = Callable[[Array, Array, float, float], float]


def wrong_pits(
    values: Array, w: Array, truth: float, u: float, rank: Rank = randomised_pit
) -> dict[str, float]:
    """PITs in deliberately wrong posteriors, made of the right one.

    narrow   spread times 0.7 about the mean
    shifted  by half a standard deviation
    laplace  a normal with the posterior's mean and standard deviation, bounds and bends forgotten
             (kinder than Laplace's own, which takes both from the mode)
    """
    mean = float(w @ values) / float(w.sum())
    sd = float(np.sqrt(w @ (values - mean) ** 2 / w.sum()))
    return {
        "narrow": rank(mean + NARROW * (values - mean), w, truth, u),
        "shifted": rank(values + SHIFT * sd, w, truth, u),
        "laplace": float(ndtr((truth - mean) / sd)),
    }


def level(n: int, probability: float = 0.95) -> float:
    """Pointwise level gamma of a band that holds all places with this probability, n uniforms.

    It falls slowly with n, which is rounded to a power of the square root of two.
    """
    return _level(round(2 ** (round(2 * np.log2(n)) / 2)), probability)


@cache
def _level(n: int, probability: float) -> float:
    rng = stream(0, "simultaneous-band", n)
    cells = np.full(len(PLACES) + 1, 1 / (len(PLACES) + 1))
    counts = rng.multinomial(n, cells, size=SIMULATED).cumsum(axis=1)[:, :-1]
    tails = np.minimum(binom.cdf(counts, n, PLACES), binom.sf(counts - 1, n, PLACES))
    return float(np.quantile(2 * tails.min(axis=1), 1 - probability))


@dataclass(frozen=True, slots=True)
class Ecdf:
    """Distribution of PITs against its band at `PLACES`.

    share, lower, upper (99,); truths and clusters: their numbers; design: largest design
    effect, infinite where clusters are too few for a band
    """

    share: Array
    lower: Array
    upper: Array
    truths: int
    clusters: int
    design: float

    @property
    def inside(self) -> bool:
        return bool(np.all((self.share >= self.lower) & (self.share <= self.upper)))

    @property
    def claims(self) -> bool:
        """Whether any distribution would be outside."""
        return bool(np.any((self.lower > 0) | (self.upper < 1)))


def ecdf(pit: Array, cluster: Clusters, probability: float = 0.95) -> Ecdf:
    """PITs (N,) and the number of the cluster each belongs to (N,)."""
    n = len(pit)
    below = pit[:, None] <= PLACES
    share = below.mean(axis=0)
    _, index = np.unique(cluster, return_inverse=True)
    clusters = int(index.max()) + 1
    sizes = np.full((1, len(PLACES)), n)
    design = np.ones(len(PLACES))
    if clusters < FEWEST < n:  # too few to know how alike the truths of one are: nothing is claimed
        return Ecdf(share, 0 * share, 1 + 0 * share, n, clusters, float("inf"))
    if clusters < n:
        sums = np.zeros((clusters, len(PLACES)))
        np.add.at(sums, index, below - share)
        between = (sums**2).sum(axis=0) * clusters / (clusters - 1)
        window = np.ones(WINDOW)
        alone = n * PLACES * (1 - PLACES)
        ratio = np.convolve(between, window, "same") / np.convolve(alone, window, "same")
        gamma = level(n, probability)
        wider = t.ppf(gamma / 2, clusters - 1) / norm.ppf(gamma / 2)
        found = np.maximum(np.maximum(ratio, between.sum() / alone.sum()), 1.0)
        design = found * wider**2 * clusters / (clusters - 4)
        sizes = np.maximum(np.round(n / np.stack([found, design])), 1).astype(np.int64)
    gamma = level(int(np.median(sizes[0])), probability)
    lower = (binom.ppf(gamma / 2, sizes, PLACES) / sizes).min(axis=0)
    upper = (binom.isf(gamma / 2, sizes, PLACES) / sizes).max(axis=0)
    return Ecdf(share, lower, upper, n, clusters, float(design.max()))


def coverage(cdf: Array, cluster: Clusters, probability: float) -> tuple[float, float]:
    """Share of truths inside the central interval, and its standard error between clusters."""
    tail = (1 - probability) / 2
    inside = (cdf >= tail) & (cdf <= 1 - tail)
    return mean_and_error(inside.astype(float), cluster)


def mean_and_error(values: Array, cluster: Clusters) -> tuple[float, float]:
    """Mean of clustered values, and its standard error from sums of clusters."""
    mean = float(values.mean())
    _, index = np.unique(cluster, return_inverse=True)
    sums = np.bincount(index, values - mean)
    count = len(sums)
    if count < 2:
        return mean, float("inf")
    return mean, float(np.sqrt((sums**2).sum() * count / (count - 1))) / len(values)
