"""Placements of the shared nodes that were tried, and what they tell together.

Even weights at the nodes prove nothing: beside a posterior that is nearly flat there they are even,
too. A surface through log p (`core.calibration.surface`) looks beyond, and what it believes of a
place without nodes can be wrong. So it goes through the nodes of several placements, weighed
against the mixture of their proposals,

    log q(u) = log mean_j q_j(u)

(deterministic mixture weights: Owen & Zhou, J. Amer. Statist. Assoc. 95, 2000), and a place that
one surface believed in is known to the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.calibration.surface import foreseen
from core.errors import InputError
from core.smc.particles import ess, normalised, tempering_exponent
from core.smc.placement import floored, moments
from core.smc.proposal import Proposal, finely_rounded

Array = NDArray[np.float64]
DOUBTED = 0.02  # share that a surface has to believe in, or it is taken for none


@dataclass(frozen=True, slots=True)
class Tried:
    """A placement that was tried: its nodes (n, d), log p and log q there."""

    proposal: Proposal
    unit: Array
    log_p: Array
    log_q: Array

    @property
    def share(self) -> float:
        """Of effective nodes."""
        return ess(self.log_p - self.log_q) / len(self.unit)


def pool(tried: Sequence[Tried]) -> tuple[Array, Array, Array]:
    """Nodes of several placements (n, d), log p there, and log q of the mixture of them."""
    unit = np.concatenate([one.unit for one in tried])
    densities = np.array([one.proposal.log_density(unit) for one in tried])
    log_q = np.logaddexp.reduce(densities, axis=0) - np.log(len(tried))
    return unit, np.concatenate([one.log_p for one in tried]), log_q


def of_all(tried: Sequence[Tried], wanted: float) -> Proposal:
    """The placement of the moments of all that was tried, tempered until `wanted` nodes count.

    Where nothing fits, each placement follows from the one before it, and may keep what is wrong
    with that: a correlation that a dozen effective nodes made up, a spread that halves from turn to
    turn. Together they know the posterior better than any one of them.
    """
    unit, log_p, log_q = pool(tried)
    log_w = floored(log_p) - log_q
    w = normalised(tempering_exponent(log_w, wanted) * log_w)
    return finely_rounded(*moments(unit, w), tried[-1].proposal.heavy)


def judged(one: Tried, circle: Sequence[Tried]) -> tuple[float, Proposal | None]:
    """The share of effective nodes that a surface through what was tried agrees with, and the
    placement of that surface's moments.

    No more than `DOUBTED` is none; where no surface goes through, the nodes alone tell.
    """
    try:
        beyond, further = foreseen(one.proposal, *pool(circle))
    except (InputError, np.linalg.LinAlgError):
        return one.share, None
    share = min(one.share, beyond)
    return share if share > DOUBTED else 0.0, further
