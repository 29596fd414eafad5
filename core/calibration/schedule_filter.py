"""The particle filter of the paper's schedule: beliefs, and one step.

A belief is a cloud of particles u on the unit box of some parameters' priors and the log density
that it stands for. One Bayes step carries it from its density p to q = p · L by the path

    log p_beta = (1 − beta) log p + beta log q,   beta = 0 … 1,

each stretch as long as half of the particles stay effective; then systematic resampling and
random-walk Metropolis moves on p_beta (Del Moral, Doucet & Jasra 2006). The paper says no more than
"particle filter"; weighting 10,000 draws of a uniform prior once, as its words can be taken, leaves
a handful of distinct values where a hundred blades speak. The moves make the Monte-Carlo error
small, so that what differs from the joint posterior is the schedule. The effective sample size that
the plain filter would have been left with is reported beside it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.calibration.space import SharedSpace
from core.errors import CalibrationError
from core.prior import Prior
from core.smc.particles import Particles, ess, tempering_exponent

Array = NDArray[np.float64]
LogDensity = Callable[[Array], Array]
EFFECTIVE = 0.5  # share of particles that stay effective over one stretch of the path
MOVED = 0.5  # accepted moves of a particle after each stretch, on average
MOST_MOVES = 12


@dataclass(frozen=True, slots=True)
class Belief:
    """Particles u (N, d) on the unit box of `space`, and the log density they stand for."""

    space: SharedSpace
    u: Array
    log_density: LogDensity

    @staticmethod
    def prior(
        names: Sequence[str], priors: Sequence[Prior], n: int, rng: np.random.Generator
    ) -> Belief:
        """`n` independent draws of the priors."""
        u = np.empty((n, len(names)))
        for j, prior in enumerate(priors):
            low, high = prior.box
            u[:, j] = (prior.to_u(prior.quantile(rng.random(n))) - low) / (high - low)
        space = SharedSpace(tuple(names), tuple(priors))
        return Belief(space, np.clip(u, 0.0, 1.0), space.log_prior)

    @staticmethod
    def fitted(space: SharedSpace, u: Array) -> Belief:
        """What a joint step leaves of some parameters, a cloud: a normal density on the box."""
        mean = u.mean(axis=0)
        root = _root(np.atleast_2d(np.cov(u.T)) if u.shape[1] else np.zeros((0, 0)))

        def log_density(at: Array) -> Array:
            inside = np.all((at >= 0) & (at <= 1), axis=1)
            z = np.linalg.solve(root, (at - mean).T)
            return np.where(inside, -0.5 * np.sum(z * z, axis=0), -np.inf)

        return Belief(space, u, log_density)

    def beside(self, other: Belief, rng: np.random.Generator) -> Belief:
        """Both as one, independent: any particle of this one with any of the other."""
        d = self.space.dim
        space = SharedSpace(
            (*self.space.names, *other.space.names), (*self.space.priors, *other.space.priors)
        )
        return Belief(
            space,
            np.hstack([self.u, other.u[rng.permutation(len(other.u))]]),
            lambda u: self.log_density(u[:, :d]) + other.log_density(u[:, d:]),
        )

    @property
    def x(self) -> Array:
        """Particles in natural units (N, d)."""
        return self.space.to_x(self.u)

    @property
    def moments(self) -> tuple[Array, Array]:
        """Mean and variance on the unit box."""
        return self.u.mean(axis=0), self.u.var(axis=0)

    def held(self, draws: int | None, rng: np.random.Generator) -> dict[str, Array]:
        """Values (M,) to hold these parameters at: their mean (M = 1), or M of the particles.

        The mean is that of the logarithm where the prior is log-uniform.
        """
        if draws is None:
            x = self.space.to_x(self.u.mean(axis=0)[None])
        else:
            x = self.space.to_x(self.u[rng.choice(len(self.u), draws, replace=False)])
        return {name: x[:, j] for j, name in enumerate(self.space.names)}


def _root(covariance: Array) -> Array:
    """Cholesky factor, also where a direction has no spread."""
    d = len(covariance)
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-24))
    correlation = covariance / np.outer(scale, scale)
    return np.asarray(scale[:, None] * np.linalg.cholesky(correlation + 1e-9 * np.eye(d)))


@dataclass(frozen=True, slots=True)
class Step:
    """A belief after a Bayes step.

    plain_ess   effective particles that one plain weighting would have left
    acceptance  share of Metropolis moves accepted
    """

    belief: Belief
    plain_ess: float
    acceptance: float


def carried(belief: Belief, target: LogDensity, rng: np.random.Generator) -> Step:
    """The belief carried to the log density `target`; the particles leave equally weighted.

    Raises CalibrationError where no particle explains the readings.
    """
    u, n, d = belief.u, *belief.u.shape
    if d == 0:
        return Step(Belief(belief.space, u, target), float(n), 1.0)
    p, q = belief.log_density(u), target(u)
    ratio = q - p
    if np.isnan(ratio).any() or not ratio.max() > -np.inf:
        raise CalibrationError(
            f"no particle of {', '.join(belief.space.names)} has a weight "
            f"({int(np.isnan(ratio).sum())} of {n} not a number); look at readings and priors"
        )
    plain = ess(ratio)
    beta, scale, tried, accepted = 0.0, 2.38 / math.sqrt(d), 0, 0.0
    while beta < 1.0:
        ratio = q - p
        stretch = tempering_exponent((1.0 - beta) * ratio, EFFECTIVE * n) * (1.0 - beta)
        beta = min(1.0, beta + max(stretch, 1e-12))
        weighted = Particles(np.column_stack([u, p, q]), stretch * ratio)
        root = _root(weighted.covariance[:d, :d])
        even = weighted.resampled(n, rng).psi
        u, p, q = even[:, :d].copy(), even[:, d].copy(), even[:, d + 1].copy()
        moved = 0.0
        for _ in range(MOST_MOVES):
            new = u + scale * rng.standard_normal((n, d)) @ root.T
            inside = np.all((new >= 0) & (new <= 1), axis=1)
            kept = np.where(inside[:, None], new, u)
            new_p = belief.log_density(kept) if beta < 1.0 else p
            new_q = target(kept)
            gain = beta * (new_q - q) + (0.0 if beta == 1.0 else (1.0 - beta) * (new_p - p))
            take = inside & (np.log(rng.random(n)) < gain)
            u[take], p[take], q[take] = kept[take], new_p[take], new_q[take]
            share = float(take.mean())
            scale *= math.exp(share - 0.3)
            tried, accepted, moved = tried + 1, accepted + share, moved + share
            if moved >= MOVED:
                break
    return Step(Belief(belief.space, u, target), plain, accepted / tried)
