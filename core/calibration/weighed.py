"""The shared nodes with their weights: what the rotor knows of its shared parameters.

At K nodes s_k of the unit box, drawn from a proposal q (`core.smc.proposal`), a blade says log m_b
(a column), and

    log p(s_k, D) = log p(s_k) + Σ_b log m_b(s_k),      log w_k = log p(s_k, D) − log q(s_k).

The mean of the w_k is the evidence. How even they are is told by the share of effective nodes.

What a blade says may be bounded from below, max(log m_b, f_b): where its readings cannot be the
model's, at f_b, they say nothing about the shared parameters (`bounded`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from core.smc.particles import ess, log_sum_exp
from core.smc.proposal import Proposal

Array = NDArray[np.float64]


def node_count(dim: int, heavy: bool = False) -> int:
    """Shared nodes for `dim` shared parameters; twice as many where one has long tails."""
    return (64 if dim <= 2 else 128 if dim <= 4 else 256) * (2 if heavy else 1)


def effective(nat: float, nodes: int) -> float:
    """The share of nodes that has to be effective for log p(D) to be known to so many nats.

    Of weights with mean 1 and variance 1/share − 1.

    >>> [round(effective(0.135, n), 2) for n in (64, 128, 256)]
    [0.46, 0.3, 0.18]
    """
    return 1.0 / (1.0 + nodes * nat**2)


def said(blade: str, column: Array, floors: Mapping[str, float]) -> Array:
    """What a blade says of the shared parameters, by its column (K,) and its floor if it has one.

    >>> said("b", np.array([-50.0, 3.0]), {"b": -9.0}).tolist()
    [-9.0, 3.0]
    """
    return np.maximum(column, floors[blade]) if blade in floors else column


@dataclass(frozen=True, slots=True)
class Weighed:
    """Shared nodes on the unit box with their weights.

    unit (K, d), log_q (K,), columns {blade: (K,)}, log_prior (K,).
    floors   f_b of the blades that have one
    """

    unit: Array
    log_q: Array
    log_prior: Array
    columns: Mapping[str, Array]
    proposal: Proposal
    floors: Mapping[str, float] = field(default_factory=dict)

    @property
    def key(self) -> bytes:
        return self.proposal.key

    @property
    def log_p(self) -> Array:
        total = self.log_prior.copy()
        for blade in sorted(self.columns):
            total = total + said(blade, self.columns[blade], self.floors)
        return total

    @property
    def log_w(self) -> Array:
        return self.log_p - self.log_q

    @property
    def log_evidence(self) -> float:
        """log of the mean of w_k: log p(D)."""
        return log_sum_exp(self.log_w) - float(np.log(len(self.unit)))

    @property
    def ess_ratio(self) -> float:
        return ess(self.log_w) / len(self.log_w)
