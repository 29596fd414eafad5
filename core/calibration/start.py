"""Where a posterior is expected: the first place at which its shared nodes are tried.

A posterior is found from nothing by a descent from the whole box (`smc.placement`), and has to be
where it is served: it must not depend on what was known before. A diagnosis calibrates one rotor a
dozen times, with one effect more or some readings fewer, and each of these posteriors is nearly
known from another. With s normal about (m, C), an effect of amplitude a ~ N(ā, A) that moves s by
T a, and a part of s held at given values,

    (s, a)       mean (m + T ā, ā),   covariance [[C + T A Tᵀ, T A], [A Tᵀ, A]]
    s_1 | s_2    mean m_1 + C_12 C_22⁻¹ (s_2 − m_2),   covariance C_11 − C_12 C_22⁻¹ C_21

Only the nodes' places follow from it. Their weights are exact wherever they stand, and where too
few of them carry the weight the descent is made after all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import truncnorm

from core.calibration.looked import Told, told_of
from core.calibration.space import SharedSpace, shared_prior
from core.calibration.state import RotorState
from core.model import Model
from core.smc.particles import normalised
from core.smc.placement import moments
from core.smc.proposal import Proposal, rounded

Array = NDArray[np.float64]
LEAST = 1e-6  # of the box: no spread is smaller
TAIL = 8.0  # sds
FAR = 4.0  # sds from a bound that is not felt


@dataclass(frozen=True, slots=True)
class Start:
    """Expected moments of shared parameters, each on its prior's working scale.

    names (d,), mean (d,), covariance (d, d)
    alone  a posterior that is not found from there is looked for nowhere else
    served  the state may be served: as many nodes have to carry it as one from nothing
    apart  blades that are `bounded` from the beginning
    told  what looks at all visits told (`looked`): of such a state as well
    """

    names: tuple[str, ...]
    mean: Array
    covariance: Array
    alone: bool = False
    served: bool = False
    apart: frozenset[str] = frozenset()
    told: Told = field(default_factory=dict)

    @staticmethod
    def of(model: Model, state: RotorState) -> Start:
        """The moments of a state's shared nodes."""
        names, x = tuple(state.meta["shared"]), state.arrays["shared/x"]
        u = [shared_prior(model, n).to_u(x[:, j]) for j, n in enumerate(names)]
        found = moments(np.stack(u, axis=1), normalised(state.arrays["shared/log_w"]))
        health = state.meta["health"]
        told = health.get("contradicted", ())
        apart = frozenset(one["blade"] for one in told if one.get("bounded"))
        return Start(names, *found, apart=apart, told=told_of(health))

    def joined(self, names: Sequence[str], turn: Array, mean: Array, covariance: Array) -> Start:
        """With amplitudes of these names, of N(mean (k,), covariance (k, k)).

        turn  (d, k): by how much the parameters move for an amplitude of one

        >>> one = Start(("T",), np.array([5.0]), np.array([[4.0]]))
        >>> two = one.joined(["a"], np.array([[-2.0]]), np.array([1.0]), np.array([[0.25]]))
        >>> two.mean.tolist(), two.covariance.tolist()
        ([3.0, 1.0], [[5.0, -0.5], [-0.5, 0.25]])
        """
        across = turn @ covariance
        whole = np.block(
            [[self.covariance + across @ turn.T, across], [across.T, np.asarray(covariance)]]
        )
        both = np.r_[self.mean + turn @ mean, mean]
        return replace(self, names=(*self.names, *names), mean=both, covariance=whole)

    def between(self, other: Start) -> Start:
        """Anywhere on the line to another one; of a parameter that one has not its amplitude is 0.

        >>> one = Start(("T", "a"), np.array([1.0, 2.0]), np.diag([1.0, 4.0]))
        >>> two = Start(("T", "b"), np.array([1.0, 6.0]), np.diag([3.0, 0.0]))
        >>> both = one.between(two)
        >>> both.names, both.mean.tolist()
        (('T', 'a', 'b'), [1.0, 1.0, 3.0])
        >>> both.covariance.round(3).tolist()
        [[2.0, 0.0, 0.0], [0.0, 2.333, -1.0], [0.0, -1.0, 3.0]]
        """
        names = (*self.names, *(n for n in other.names if n not in self.names))
        means, covariances = [], []
        for one in (self, other):
            at = [names.index(n) for n in one.names]
            mean, covariance = np.zeros(len(names)), np.zeros((len(names), len(names)))
            mean[at], covariance[np.ix_(at, at)] = one.mean, one.covariance
            means.append(mean)
            covariances.append(covariance)
        between = means[1] - means[0]
        spread = np.mean(covariances, axis=0) + np.outer(between, between) / 12.0
        apart = self.apart | other.apart
        return Start(names, np.mean(means, axis=0), spread, apart=apart, told=self.told)

    def held(self, values: Mapping[str, float]) -> Start:
        """Without these parameters, which have these values.

        >>> two = Start(("T", "a"), np.array([3.0, 1.0]), np.array([[5.0, -0.5], [-0.5, 0.25]]))
        >>> one = two.held({"a": 0.0})
        >>> one.names, one.mean.round(9).tolist(), one.covariance.round(9).tolist()
        (('T',), [5.0], [[4.0]])
        """
        out = [j for j, n in enumerate(self.names) if n in values]
        left = [j for j, n in enumerate(self.names) if n not in values]
        if not out:
            return self
        across, own = self.covariance[np.ix_(left, out)], self.covariance[np.ix_(out, out)]
        gain = np.linalg.solve(own + 1e-14 * np.trace(own) * np.eye(len(out)), across.T).T
        off = np.array([values[self.names[j]] for j in out]) - self.mean[out]
        return replace(
            self,
            names=tuple(self.names[j] for j in left),
            mean=self.mean[left] + gain @ off,
            covariance=self.covariance[np.ix_(left, left)] - gain @ across.T,
        )

    def on_log(self, values: Mapping[str, float]) -> Start:
        """With these parameters, so far as they are, by their logarithms about values > 0.

        >>> one = Start(("P",), np.array([0.8]), np.array([[0.04]])).on_log({"P": 0.8})
        >>> one.mean.round(3).tolist(), one.covariance.round(4).tolist()
        ([-0.223], [[0.0625]])
        """
        scale = np.array([1.0 / values.get(n, 1.0) for n in self.names])
        pairs = zip(self.names, self.mean, strict=True)
        mean = np.array([np.log(values[n]) if n in values else m for n, m in pairs])
        return replace(self, mean=mean, covariance=self.covariance * np.outer(scale, scale))

    def wider(self, factor: float) -> Start:
        """With `factor` times the variances, as of fewer readings."""
        return replace(self, covariance=factor * self.covariance)

    def on(self, space: SharedSpace) -> Proposal | None:
        """The proposal on the unit box of a space; None where it has other parameters."""
        if sorted(self.names) != sorted(space.names):
            return None
        order = [self.names.index(n) for n in space.names]
        low, high = np.array([prior.box for prior in space.priors]).T
        width = high - low
        mean = (self.mean[order] - low) / width
        covariance = self.covariance[np.ix_(order, order)] / np.outer(width, width)
        if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
            return None
        mean, covariance = cut(mean, covariance + LEAST**2 * np.eye(len(mean)))
        return rounded(np.clip(mean, 0.0, 1.0), covariance, space.heavy)


def cut(mean: Array, covariance: Array) -> tuple[Array, Array]:
    """Moments (d,), (d, d) of a normal cut at the unit box, one coordinate after the other.

    Where one is cut, the others move with it as far as they go with it.

    >>> mean, covariance = cut(np.array([0.5, 3.0]), np.array([[0.02, 0.1], [0.1, 1.0]]))
    >>> mean.round(3).tolist(), covariance.round(4).tolist()
    ([0.269, 0.685], [[0.0106, 0.0061], [0.0061, 0.0614]])
    """
    mean, covariance = mean.copy(), covariance.copy()
    for j in range(len(mean)):
        sd = np.sqrt(covariance[j, j])
        ends = (0.0 - mean[j]) / sd, (1.0 - mean[j]) / sd
        if ends[0] < -FAR and ends[1] > FAR:
            continue
        middle, variance = _inside(*ends)
        gain = covariance[:, j] / sd**2
        mean = mean + gain * middle * sd
        covariance = covariance - np.outer(gain, gain) * sd**2 * (1.0 - variance)
    return mean, covariance


def _inside(low: float, high: float) -> tuple[float, float]:
    """Mean and variance of a standard normal cut to (low, high); beyond `TAIL`, as an exponential.

    >>> [round(v, 6) for v in _inside(9.0, 1e3)], [round(v, 3) for v in _inside(-1e3, -7.999)]
    ([9.111111, 0.012346], [-8.12, 0.014])
    """
    for near, sign in ((low, 1.0), (-high, -1.0)):
        if near > TAIL:
            return sign * (near + 1.0 / near), 1.0 / near**2
    mean, variance = truncnorm.stats(low, high, moments="mv")
    return float(mean), float(variance)
