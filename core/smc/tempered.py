"""Tempered particles: where several related targets on a box have their mass.

Targets pi_k on [−1, 1]^d, known up to a constant at any point, may be narrow, bounded or in several
pieces. A population of weighted points is led to all of them at once. On each round the points
x_i ~ q get the weights of every target, tempered on its own,

    w_ki ∝ (pi_k(x_i) / q(x_i))^beta_k,      beta_k: the largest that keeps `LEAST` of the points,

and the next proposal is the kernel mixture around the points, each with its weight averaged over
the targets: resampling and move in one step, the move being a new draw with a known density
(population Monte Carlo: Cappé et al., J. Comput. Graph. Stat. 13, 2004; adaptive temperatures:
Del Moral, Doucet & Jasra, Stat. Comput. 22, 2012). When every beta_k is 1 the proposal fits, and
importance sampling from it gives each evidence without bias,

    Z_k = E_q [pi_k(x) / q(x)].

No chain has to mix, points may be quasi-random, and one set of points serves every target, so that
ratios of evidences are better known than the evidences. A share `FLOOR` of q is uniform: no part of
the box is proposed never.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from core.smc.placement import sobol

Array = NDArray[np.float64]
FLOOR = 0.1
LEAST = 0.125  # share of the points that stay effective in each target
ROUNDS = 12


@dataclass(frozen=True, slots=True)
class Kernels:
    """Mixture of normal kernels with independent coordinates, each cut at the box [−1, 1]^d.

    centres (J, d), weight (J,) sums to one, width (d,). J = 0 stands for the uniform box.
    """

    centres: Array
    weight: Array
    width: Array

    @staticmethod
    def uniform(d: int) -> Kernels:
        return Kernels(np.empty((0, d)), np.empty(0), np.ones(d))

    @staticmethod
    def around(x: Array, weight: Array) -> Kernels:
        """Kernels at points x (n, d); the widths by Silverman's rule for their effective number."""
        d = x.shape[1]
        size = 1.0 / np.sum(weight**2)
        spread = np.sqrt(weight @ (x - weight @ x) ** 2)
        width = np.maximum(spread, 1e-9) * (4.0 / ((d + 2) * size)) ** (1.0 / (d + 4))
        kept = np.flatnonzero(weight > 1e-6 * weight.max())
        kept = kept[np.argsort(x[kept, 0], kind="stable")] if d else kept
        return Kernels(x[kept], weight[kept] / weight[kept].sum(), width)

    @property
    def dim(self) -> int:
        return self.centres.shape[1]

    def points(self, base: Array) -> tuple[Array, Array]:
        """Points (n, d) from points of the unit cube (n, 1 + d), and log q at each."""
        x = 2.0 * base[:, 1:] - 1.0
        if len(self.centres) and self.dim:
            mixed = base[:, 0] >= FLOOR
            place = (base[mixed, 0] - FLOOR) / (1.0 - FLOOR)
            of = np.minimum(
                np.searchsorted(np.cumsum(self.weight), place), len(self.weight) - 1
            )
            low, high = self._ends()
            f = low[of] + base[mixed, 1:] * (high[of] - low[of])
            x[mixed] = np.clip(self.centres[of] + self.width * ndtri(f), -1.0, 1.0)
        return x, self.log_density(x)

    def log_density(self, x: Array) -> Array:
        """log q at x (n, d), a density over the box."""
        flat = -self.dim * math.log(2.0)
        if not (len(self.centres) and self.dim):
            return np.full(len(x), flat)
        low, high = self._ends()
        scale = self.weight / np.prod((high - low) * self.width * math.sqrt(2 * math.pi), axis=1)
        square = np.zeros((len(x), len(self.centres)))
        for j in range(self.dim):
            square += ((x[:, j, None] - self.centres[:, j]) / self.width[j]) ** 2
        total: Array = np.exp(-0.5 * square) @ scale
        return np.asarray(np.log(FLOOR * math.exp(flat) + (1.0 - FLOOR) * total))

    def _ends(self) -> tuple[Array, Array]:
        return (
            np.asarray(ndtr((-1.0 - self.centres) / self.width)),
            np.asarray(ndtr((1.0 - self.centres) / self.width)),
        )


def effective(log_w: Array) -> Array:
    """Effective number of points in each row of log weights (K, n) → (K,)."""
    w = np.exp(log_w - log_w.max(axis=-1, keepdims=True))
    return np.asarray(w.sum(axis=-1) ** 2 / (w * w).sum(axis=-1))


def temperatures(log_w: Array, target: float) -> Array:
    """The largest beta in [0, 1] of each row that keeps `target` points effective, (K,)."""
    low, high = np.zeros(len(log_w)), np.ones(len(log_w))
    done = effective(log_w) >= target
    for _ in range(40):
        mid = 0.5 * (low + high)
        keeps = effective(mid[:, None] * log_w) >= target
        low, high = np.where(keeps, mid, low), np.where(keeps, high, mid)
    return np.where(done, 1.0, low)


def tempered(
    log_target: Callable[[Array], Array], d: int, n: int, seed: int, rounds: int = ROUNDS
) -> tuple[Kernels, bool]:
    """A proposal that fits every target, and whether all were reached at full temperature.

    log_target   log pi_k at points (n, d) of the box → (K, n); −inf where there is no mass
    n            points of each round, a power of two
    """
    proposal, reached = Kernels.uniform(d), 0
    for turn in range(rounds):
        x, log_q = proposal.points(sobol(n, 1 + d, seed + turn))
        log_w = log_target(x) - log_q
        log_w = np.maximum(log_w, log_w.max(axis=1, keepdims=True) - 1e7)
        beta = temperatures(log_w, LEAST * n)
        tempered_w = beta[:, None] * log_w
        w = np.exp(tempered_w - tempered_w.max(axis=1, keepdims=True))
        weight = (w / w.sum(axis=1, keepdims=True)).mean(axis=0)
        proposal = Kernels.around(x, weight / weight.sum())
        reached = reached + 1 if np.all(beta == 1.0) else 0
        if reached == 2:
            break
    return proposal, reached > 0


__all__ = ["Kernels", "effective", "temperatures", "tempered"]
