"""Where the shared level's particles stand: placement as a function of the target alone.

The shared parameters u (on the unit box) have a posterior that shrinks by orders of magnitude as
readings arrive. Its particles are nodes drawn from a proposal q and weighted exactly,

    w_k ∝ p(u_k | D) / q(u_k),      evidence = mean of p(u_k, D) / q(u_k),

so q (`proposal`) decides only how evenly the weights fall, never what is right. q is found by a
descent that starts from the whole box and looks at nothing but the target itself: on each level the
target is known at a few nodes; where their weights collapse, a quadratic through them gives the
next centre and spread, in steps bounded in every direction of its own, and where no quadratic fits,
the spread shrinks about the best node (a trust region: Powell, Acta Numerica 15, 2006). Centres and
spreads are rounded to a coarse lattice, so that one more reading mostly leaves the nodes where they
are and the work done at them stays valid. Two event sets that are equal give bit-identical nodes,
whatever the order of arrival; no earlier state is looked at.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from core.smc.particles import ess, normalised, tempering_exponent
from core.smc.proposal import WIDEN, Proposal, finely_rounded, rounded

Array = NDArray[np.float64]
EXPLAINED = 0.3  # of log p's spread that a quadratic may miss and still be followed
STEP, SCALES, SHRINK = 2.0, (0.15, 2.0), 0.55  # of a proposal's spread, from level to level


def sobol(n: int, d: int, seed: int) -> Array:
    """Scrambled Sobol points, strictly inside the unit cube; n a power of two."""
    return _sobol(n, d, seed).copy()


@lru_cache(maxsize=64)
def _sobol(n: int, d: int, seed: int) -> Array:
    points = qmc.Sobol(d, scramble=True, rng=np.random.default_rng(seed)).random(n)
    return np.asarray(np.clip(points, 1e-9, 1 - 1e-9))


def moments(u: Array, w: Array) -> tuple[Array, Array]:
    """Weighted mean (d,) and covariance (d, d) of nodes u (n, d)."""
    mean = w @ u
    d = u - mean
    return mean, (d * w[:, None]).T @ d


def _quadratic(u: Array, log_p: Array, w: Array, proposal: Proposal) -> tuple[Array, Array] | None:
    """Centre and covariance of the quadratic through log_p at weighted nodes, in small steps.

    In the proposal's own coordinates no direction moves by more than `STEP`, or shrinks or grows
    by more than `SCALES`; where it bends the wrong way it goes uphill and grows. None where the
    quadratic explains too little of log_p: there it is of no use.
    """
    assert proposal.chol is not None
    n, d = u.shape
    z = np.linalg.solve(proposal.chol, (u - proposal.mean).T).T
    pairs = [(i, j) for i in range(d) for j in range(i, d)]
    basis = np.column_stack([np.ones(n), z, *[z[:, i] * z[:, j] for i, j in pairs]])
    y, root = log_p - log_p.max(), np.sqrt(w)
    freedom = n / max(n - basis.shape[1], 1)
    coefficients = np.linalg.lstsq(basis * root[:, None], y * root, rcond=1e-10)[0]
    missed = float(np.sqrt(w @ (y - basis @ coefficients) ** 2 * freedom))
    if missed > EXPLAINED * float(np.sqrt(w @ (y - w @ y) ** 2)):
        return None
    slope, bend = coefficients[1 : d + 1], np.zeros((d, d))
    for c, (i, j) in zip(coefficients[d + 1 :], pairs, strict=True):
        bend[i, j] -= c
        bend[j, i] -= c
    values, vectors = np.linalg.eigh(bend)
    up = vectors.T @ slope
    step = np.where(values > 0.1, up / np.maximum(values, 0.1), np.sign(up) * STEP)
    doubt = 1.0 + 2.0 * missed  # nats the quadratic cannot tell apart
    sd = np.clip(np.sqrt(doubt / np.maximum(values, 1e-3)), *SCALES)
    centre = proposal.mean + proposal.chol @ (vectors @ np.clip(step, -STEP, STEP))
    spread = proposal.chol @ vectors * sd
    return centre, spread @ spread.T


def descend(
    target: Callable[[Array], Array],
    start: Proposal,
    base: Array,
    *,
    max_levels: int = 24,
    enough: float = 0.3,
) -> Proposal:
    """Find a proposal that fits `target`.

    target   log p(u, D) at nodes u (n, d)
    start    where the descent begins
    base     points of the unit cube (scouts, d) that become the nodes of each level
    """
    proposal, seen = start, set[bytes]()
    for _ in range(max_levels):
        u, log_q = proposal.nodes(base)
        log_p = target(u)
        fits = ess(floored(log_p) - log_q) >= enough * len(base)
        seen.add(proposal.key)
        proposal = improved(proposal, u, log_p, log_q, enough)
        if fits or proposal.key in seen:
            break
    return proposal


def floored(log_p: Array) -> Array:
    """Log densities with everything hopeless (−inf, too) at ten million nats below the best.

    >>> floored(np.array([3.0, -np.inf])).tolist()
    [3.0, -9999997.0]
    """
    return np.asarray(np.maximum(log_p, np.max(log_p) - 1e7))


def improved(proposal: Proposal, u: Array, log_p: Array, log_q: Array, enough: float) -> Proposal:
    """The next proposal from a target known at this one's nodes u (n, d).

    Where the weights keep `enough` of the nodes, their moments; else the quadratic through the
    tempered nodes; where that explains too little, a smaller one about the best node.
    """
    n, d = u.shape
    log_p = floored(log_p)
    log_w = log_p - log_q
    if ess(log_w) >= enough * n or proposal.chol is None:
        return rounded(*moments(u, normalised(log_w)), proposal.heavy)
    coefficients = (d + 1) * (d + 2) // 2
    w = normalised(tempering_exponent(log_w, min(1.6 * coefficients, 0.5 * n)) * log_w)
    fit = _quadratic(u, log_p, w, proposal)
    mean, cov = fit or (u[np.argmax(log_p)], SHRINK**2 * proposal.chol @ proposal.chol.T)
    inside = 1.0 / np.maximum(np.sqrt(np.diag(cov)), 1.0)
    cov = cov * np.outer(inside, inside) / WIDEN**2
    return rounded(np.clip(mean, 0.0, 1.0), cov, proposal.heavy)


def pooled(
    target: Callable[[Array], Array],
    start: Proposal,
    base: Array,
    nodes: int,
    *,
    enough: float = 0.4,
    most: int = 10,
) -> Proposal:
    """A proposal with the moments of all nodes met on the way, where the target is cheap.

    Each round adds nodes of its own proposal; all that were met are weighted anew against the
    mixture of the proposals so far, and their moments are the next one (adaptive multiple
    importance sampling: Cornuet, Marin, Mira & Robert, Scand. J. Stat. 39, 2012). Moments of one
    round's nodes alone, and those of a coarse lattice, never settled on a ridge of seven shared
    parameters whose correlations are 0.97: 3–8 % of the nodes effective, with these 54 %.

    base    points of the unit cube (n, d) of each round; n several times d²
    nodes   so many of them, the first ones, will be the nodes in the end
    enough  share of these that is effective at which it ends, once as many nodes as a round has are
            effective over all rounds (fewer know no tails, and flatter the moments fitted to
            them); after `most` rounds the best of them counts
    """
    n, d = base.shape
    proposals, units, log_ps, shares = [start], list[Array](), list[Array](), list[float]()
    while True:
        unit, log_q = proposals[-1].nodes(base)
        units.append(unit)
        log_ps.append(target(unit))
        shares.append(ess((floored(log_ps[-1]) - log_q)[:nodes]) / nodes)
        every, log_p = np.concatenate(units), floored(np.concatenate(log_ps))
        densities = np.array([one.log_density(every) for one in proposals])
        log_w = log_p - (np.logaddexp.reduce(densities, axis=0) - np.log(len(proposals)))
        effective, wanted = ess(log_w), min(float(d * d + 16), 0.5 * n)
        if shares[-1] >= enough and effective >= n:
            return proposals[-1]
        if len(shares) == most:
            return proposals[int(np.argmax(shares))]
        if effective < wanted:
            log_w = tempering_exponent(log_w, wanted) * log_w
        proposals.append(finely_rounded(*moments(every, normalised(log_w)), start.heavy))
