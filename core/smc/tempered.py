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

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from core.smc.particles import weighted_quantile
from core.smc.placement import sobol

Array = NDArray[np.float64]
FLOOR = 0.1
CELLS = 96  # of each coordinate
NARROWER = (1.0, 0.5, 0.25, 0.125, 0.0625)
LEAST = 0.125  # share of the points that stay effective in each target
ROUNDS = 12


@dataclass(frozen=True, slots=True)
class Kernels:
    """Mixture of J normal kernels with independent coordinates on the box [−1, 1]^d, in cells.

    Every coordinate has its own C cells; a kernel is constant inside a cell and has the normal's
    mass there. So the distribution of a coordinate given those before it is a table, and points of
    the cube are carried to the box by inverting d such tables (Rosenblatt 1952): a map without
    jumps, which keeps what quasi-random points are good for.

    weight (J,) sums to one; edges (d, C + 1); mass (d, J, C), each row sums to one.
    """

    weight: Array
    edges: Array
    mass: Array

    @property
    def nbytes(self) -> int:
        return self.weight.nbytes + self.edges.nbytes + self.mass.nbytes

    @staticmethod
    def uniform(d: int) -> Kernels:
        return Kernels(np.ones(1), np.tile([-1.0, 1.0], (d, 1)), np.ones((d, 1, 1)))

    @staticmethod
    def around(x: Array, weight: Array) -> Kernels:
        """Kernels at points x (n, d): Silverman's widths, narrowed as far as the points want it.

        Among halvings of the widths the one wins under which the points, each left out in turn,
        are most likely: pieces far apart are not smeared into each other. Half of the cells hold
        equal shares of the points, half are even.
        """
        d = x.shape[1]
        size = 1.0 / np.sum(weight**2)
        spread = np.sqrt(weight @ (x - weight @ x) ** 2)
        width = np.maximum(spread, 1e-6) * (4.0 / ((d + 2) * size)) ** (1.0 / (d + 4))
        kept = np.flatnonzero(weight > 1e-6 * weight.max())
        x, weight = x[kept], weight[kept] / weight[kept].sum()
        width = width * _narrowing(x, weight, width)
        edges = np.empty((d, CELLS + 1))
        mass = np.empty((d, len(x) + 1, CELLS))
        for j in range(d):
            shares = np.linspace(0.0, 1.0, CELLS // 2 + 1)[1:-1]
            inner = weighted_quantile(x[:, j], weight, shares)
            reach = np.sort(np.clip(inner + 1e-9 * np.arange(len(inner)), -1.0, 1.0))
            even = np.linspace(-1.0, 1.0, CELLS // 2 + 2)
            edges[j] = np.sort(np.concatenate([even, reach]))
            f = ndtr((edges[j] - x[:, j, None]) / width[j])
            own = np.maximum(np.diff(f, axis=1), 0.0)
            mass[j, 1:] = own / np.maximum(own.sum(axis=1, keepdims=True), 1e-300)
            mass[j, 0] = 0.5 * np.diff(edges[j])
        return Kernels(np.concatenate([[FLOOR], (1.0 - FLOOR) * weight]), edges, mass)

    def points(self, base: Array) -> tuple[Array, Array]:
        """Points (n, d) from points of the unit cube (n, d), and log q at each, a density."""
        n, d = base.shape
        x, log_q = np.empty((n, d)), np.zeros(n)
        share = np.repeat(self.weight[None], n, axis=0)
        row = np.arange(n)
        for j in range(d):
            up = np.cumsum(share @ self.mass[j], axis=1)
            aim = base[:, j] * up[:, -1]
            cell = np.minimum(np.sum(up <= aim[:, None], axis=1), up.shape[1] - 1)
            below = np.where(cell > 0, up[row, cell - 1], 0.0)
            here = np.maximum(up[row, cell] - below, 1e-300)
            low, wide = self.edges[j, cell], np.diff(self.edges[j])[cell]
            x[:, j] = low + np.clip((aim - below) / here, 0.0, 1.0) * wide
            log_q += np.log(here / up[:, -1]) - np.log(np.maximum(wide, 1e-300))
            share = share * self.mass[j][:, cell].T
            share /= share.sum(axis=1, keepdims=True)
        return np.clip(x, -1.0, 1.0), log_q


def _narrowing(x: Array, weight: Array, width: Array) -> float:
    """The factor on the widths with the best likelihood of the points, each left out in turn."""
    square = np.zeros((len(x), len(x)))
    for j in range(x.shape[1]):
        square += ((x[:, j, None] - x[:, j]) / width[j]) ** 2
    np.fill_diagonal(square, np.inf)

    def likelihood(factor: float) -> float:
        others = np.exp(-0.5 * square / factor**2) @ weight
        return float(weight @ np.log(others + 1e-12) - x.shape[1] * np.log(factor))

    return max(NARROWER, key=likelihood)


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
        x, log_q = proposal.points(sobol(n, d, seed + turn))
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
