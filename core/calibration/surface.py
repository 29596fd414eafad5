"""The log density between the shared nodes, and weights of the nodes that agree with it.

The nodes hold log p(s | D) exactly at K places u_k of the unit box. A surface through them,

    log p(u) ≈ quadratic(z) + Σ_k alpha_k exp(−|z − z_k|² / 2 l²),    z = whitened u,

is universal kriging; beyond the outermost node it goes on as steeply as the normal of the nodes'
moments falls there: the tails of a posterior are longer than a normal's. What it may be off is
known beforehand: the weighted root mean square of its leave-one-out errors (Dubrule, Math. Geology
15, 1983). Length and nugget are those of the least errors where second moments in natural units
come from: a noise that few readings tell has much of its variance at nodes of hardly any weight.
They are chosen at `CHOOSING` nodes, evenly taken, where there are more (of several placements).

Sixty-four weighted nodes know a mean to some hundredths of a standard deviation, but a standard
deviation to some hundredths of itself only, and worse where a tail is long. The surface integrates
at thousands of points for nothing; the nodes' weights are tilted until mean and covariance are the
surface's,

    log w'_k = log w_k + lambda · f(x_k),    f = (z, z z^T),

the change of least relative entropy (Csiszár 1975; as calibration of survey weights: Deville &
Särndal 1992). Every blade's particles hang on the nodes, so all that is published follows.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from core.calibration.message import POOL
from core.calibration.space import SharedSpace
from core.errors import InputError
from core.monomials import monomials
from core.smc.particles import ess, log_sum_exp, normalised
from core.smc.placement import moments, sobol
from core.smc.proposal import Proposal, rounded

Array = NDArray[np.float64]
DEPTH = 25.0  # nats below the best node that still shape the surface
LENGTHS = (1.0, 1.5, 2.0, 3.0, 4.5)
NUGGETS = (1e-8, 1e-5, 1e-2)
CHOOSING = 512  # nodes at most at which length and nugget are chosen
POINTS = 8192  # at which a surface is integrated; fewer in few dimensions
FORESEEN = 2.0  # nat of leave-one-out error up to which a surface tells where to go
KEPT = 0.6  # of the effective nodes: a tilt that costs more is not believed
TRUSTED = 0.5  # nat of leave-one-out error up to which a surface is
AT_ONCE = 1024  # points, whoever works beside whom
GRAIN = 2.0**-20  # nat: tilts are rounded, so that the last bits of a solver do not matter


@dataclass(frozen=True)
class Surface:
    """log p over the unit box by universal kriging through nodes; whitened z = turn (u − mean)."""

    mean: Array
    turn: Array
    nodes: Array
    length: float
    alpha: Array
    reach: float

    def __call__(self, unit: Array) -> Array:
        """log p at (n, d), (n,)."""
        parts = [unit[i : i + AT_ONCE] for i in range(0, len(unit), AT_ONCE)]
        return np.concatenate(list(POOL.map(self._at, parts)))

    def _at(self, unit: Array) -> Array:
        z = (unit - self.mean) @ self.turn.T
        r = np.sqrt(np.sum(z**2, axis=1))
        z = z * np.minimum(1.0, self.reach / np.maximum(r, 1e-300))[:, None]
        inside = np.hstack([_bells(z, self.nodes, self.length), monomials(z, 2)]) @ self.alpha
        return np.asarray(inside - self.reach * np.maximum(r - self.reach, 0.0))

    @staticmethod
    def through(
        unit: Array, log_p: Array, w: Array, x: Array | None = None
    ) -> tuple[Surface, float]:
        """The surface through log p at nodes (K, d) of weights w, and its error [nat].

        x   natural values (K, d) at the nodes, where their second moments matter
        """
        mean, cov = moments(unit, w)
        turn = np.linalg.inv(np.linalg.cholesky(cov + 1e-14 * np.eye(len(mean))))
        shapes = log_p > np.max(log_p) - DEPTH
        z, value = (unit[shapes] - mean) @ turn.T, log_p[shapes]
        matters = w if x is None else w * (1.0 + _distances(x, w))
        w, matters = (normalised(np.log(one[shapes])) for one in (w, matters))
        basis = monomials(z, 2)
        k, m = basis.shape
        if k < m + 2:
            raise InputError(
                "nodes of the state", k, f"cannot carry {m} coefficients", "calibrate anew"
            )
        some = slice(None, None, -(-k // CHOOSING))
        best, alpha, left_out = np.inf, np.empty(0), np.empty(0)
        length = nugget = 0.0
        bells = {length: _bells(z[some], z[some], length) for length in LENGTHS}
        for one in product(LENGTHS, NUGGETS):
            tried = _fitted(bells[one[0]], basis[some], value[some], one[1])
            if (judged := float(matters[some] @ tried[1] ** 2)) < best:
                best, (alpha, left_out), (length, nugget) = judged, tried, one
        if not np.isfinite(best):
            raise InputError("surface", best, "goes through no nodes", "use the nodes alone")
        if k > CHOOSING:
            alpha, left_out = _fitted(_bells(z, z, length), basis, value, nugget)
        reach = float(np.sqrt(np.max(np.sum(z**2, axis=1))))
        error = float(np.sqrt(w @ left_out**2))
        return Surface(mean, turn, z, length, alpha, reach), error


def _fitted(bells: Array, basis: Array, value: Array, nugget: float) -> tuple[Array, Array]:
    """Coefficients (k + m,) of the surface through values (k,), and its leave-one-out errors.

    bells  (k, k) between the nodes; basis (k, m)
    """
    k, m = basis.shape
    system = np.zeros((k + m, k + m))
    system[:k, :k] = bells + nugget * np.eye(k)
    system[:k, k:], system[k:, :k] = basis, basis.T
    inverse = np.linalg.inv(system)
    alpha = inverse[:, :k] @ value
    return alpha, alpha[:k] / np.diag(inverse)[:k]


def _distances(x: Array, w: Array) -> Array:
    """Squares of x's distances from its mean in sds, summed over the parameters, (K,)."""
    mean = w @ x
    return np.asarray(np.sum((x - mean) ** 2 / (w @ (x - mean) ** 2 + 1e-300), axis=1))


def _bells(a: Array, b: Array, length: float) -> Array:
    """exp(−|a − b|² / 2 l²) between points (n, d) and (m, d), (n, m)."""
    square = np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1) - 2 * a @ b.T
    return np.asarray(np.exp(np.maximum(square, 0.0) / (-2 * length**2)))


def foreseen(proposal: Proposal, unit: Array, log_p: Array, log_q: Array) -> tuple[float, Proposal]:
    """The share of effective nodes by a surface through log p that looks beyond them, and the
    proposal that has its moments.

    A proposal may sit aside of the posterior where log p is nearly flat over it: its weights are
    even, and nothing at its own nodes tells. The surface is integrated over a proposal twice as
    wide; with p normalised there, the share is 1 / ∫ p² / q. Raises InputError and LinAlgError
    where no surface goes through.
    """
    w = normalised(log_p - log_q)
    surface, error = Surface.through(unit, log_p, w)
    if not error < FORESEEN:
        raise InputError("surface", error, "nat off", "use the nodes alone")
    d = unit.shape[1]
    points = POINTS // (4 if d <= 2 else 2 if d <= 4 else 1)
    dense, log_dense_q = proposal.spread(2.0).nodes(sobol(points, d, points))
    log_dense_p = surface(dense)
    log_w = log_dense_p - log_dense_q
    total = log_sum_exp(log_w)
    log_ratio = log_dense_p - total + np.log(points) - proposal.log_density(dense)  # of p to q
    share = np.exp(-log_sum_exp(log_w - total + log_ratio))
    return float(share), rounded(*moments(dense, normalised(log_w)), proposal.heavy)


def evening(
    space: SharedSpace, proposal: Proposal, unit: Array, log_p: Array, log_q: Array
) -> tuple[Array, float | None]:
    """What to add to log weights of nodes (K, d) for the surface's mean and covariance; its error.

    Zero, and None, where no surface can be trusted or no gentle tilt leads there. The weights' sum
    stays what it was: the evidence.
    """
    log_w, none = log_p - log_q, np.zeros(len(unit))
    x = space.to_x(unit)
    try:
        surface, error = Surface.through(unit, log_p, normalised(log_w), x)
        if not error < TRUSTED:
            return none, None
        points = POINTS // (2 if space.dim <= 2 else 1)
        dense, log_dense_q = proposal.nodes(sobol(points, space.dim, points))
        log_dense_w = surface(dense) - log_dense_q
        if ess(log_dense_w) / points < KEPT * ess(log_w) / len(log_w):  # it rises between nodes
            return none, None
        mean, cov = moments(space.to_x(dense), normalised(log_dense_w))
        z = np.linalg.solve(np.linalg.cholesky(cov), (x - mean).T).T
    except (InputError, np.linalg.LinAlgError):
        return none, None
    i, j = np.triu_indices(space.dim)
    found = tilt(np.hstack([z, z[:, i] * z[:, j] - (i == j)]), log_w)
    if found is None or ess(log_w + found) < KEPT * ess(log_w):
        return none, None
    found -= log_sum_exp(log_w + found) - log_sum_exp(log_w)
    return np.round(found / GRAIN) * GRAIN, error


def tilt(features: Array, log_w: Array) -> Array | None:
    """lambda · f at each node (K,) with which features (K, m) average to zero; None: no such.

    Newton's method on the convex log Σ w exp(lambda · f).

    >>> f = np.array([[-1.0], [0.0], [2.0]])
    >>> w = normalised(np.zeros(3) + tilt(f, np.zeros(3)))
    >>> abs(float(w @ f[:, 0])) < 1e-9
    True
    """
    lam = np.zeros(features.shape[1])
    value = log_sum_exp(log_w)
    for _ in range(60):
        w = normalised(log_w + features @ lam)
        slope = w @ features
        if np.max(np.abs(slope)) < 1e-9:
            return np.asarray(features @ lam)
        bend = (features * w[:, None]).T @ features - np.outer(slope, slope)
        try:
            step = np.linalg.solve(bend + 1e-10 * np.eye(len(lam)), -slope)
        except np.linalg.LinAlgError:
            return None
        size = 1.0
        while (
            trial := log_sum_exp(log_w + features @ (lam + size * step))
        ) > value + 1e-4 * size * float(slope @ step):
            size *= 0.5
            if size < 1e-6:
                return None
        lam, value = lam + size * step, trial
    return None
