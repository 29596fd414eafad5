"""How a column of a blade with many local parameters was integrated, and how well: its replicates.

The points of a column come in R = `REPLICATES` independently scrambled sets. With the averages
m_kr of the weights L / q at node k over each of them,

    m_k = Σ_r m_kr / R,      scatter_kr = m_kr / m_k − 1,

and the scatter's standard deviation over sqrt(R) is the error of log m_k. Points are common to the
nodes, so most of it is too; less each replicate's mean over the nodes, the scatter tells the error
of differences between nodes, which is all that the posterior feels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.calibration.collapsed_split import Split
from core.smc.tempered import Kernels

Array = NDArray[np.float64]
Index = NDArray[np.int64]
REPLICATES = 8


@dataclass(frozen=True, slots=True)
class Plan:
    """How the nodes `members` of a column are integrated."""

    members: Index
    split: Split
    proposal: Kernels


@dataclass(frozen=True, slots=True)
class Fit:
    """A column (K,), the scatter of its replicates, relative, (K, REPLICATES), and the plans."""

    column: Array
    scatter: Array
    plans: tuple[Plan, ...]

    @property
    def error(self) -> tuple[float, float]:
        """Root mean square error of the column, and of its differences between nodes [nat]."""
        own = self.scatter - self.scatter.mean(axis=0)
        return _of_mean(self.scatter), _of_mean(own)

    @property
    def nbytes(self) -> int:
        """Of its arrays, nearly all of them the proposals'."""
        plans = sum(one.members.nbytes + one.proposal.nbytes for one in self.plans)
        return self.column.nbytes + self.scatter.nbytes + plans


def _of_mean(scatter: Array) -> float:
    return float(np.sqrt(np.mean(scatter.var(axis=1, ddof=1)) / scatter.shape[1]))


def average(log_w: Array) -> tuple[Array, Array]:
    """log of the mean of weights (K, n), and each replicate's share of it less one."""
    top = log_w.max(axis=1, keepdims=True)
    parts = np.exp(log_w - top).reshape(len(log_w), REPLICATES, -1).mean(axis=2)
    mean = parts.mean(axis=1)
    return top[:, 0] + np.log(mean), parts / mean[:, None] - 1.0
