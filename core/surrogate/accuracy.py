"""How accurate a surrogate says it is where it matters.

A `Goal` names a quantity, the hours at which it is read, and the relative standard deviation that
is wanted of it. At inputs x the surrogate's relative error of the quantity is

    e(x)^2 = mean over hours and nodes of  sd(t; x)^2 / max(|y(t; x)|, m(t) / 10)^2,

y and sd from `Surrogate.predict`, m(t) the root mean square of y over the region: where a course
passes through zero, a tenth of its usual size is what errors are held against. A vector's size at
an instant is its root mean square over nodes and components. The goal is met where 95 % of the
region's weight has e <= wanted. The sd is calibrated: it has the scale of the leave-one-out
residuals and grows by what cross-validation finds missing (`core.surrogate.held_out`).

As sd^2 = v(x) k(t; x)^2 with one v for everything, a unit of v costs at x

    a(x) = mean over goals of (e(x) / wanted)^2 / v(x),

the weight, times posterior mass, of `core.design.acquisition`: goals that are far from met count
for more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.design import Region
from core.errors import InputError
from core.smc.particles import weighted_quantile
from core.surrogate.model import Surrogate

Array = NDArray[np.float64]
PROBABILITY = 0.95
LEAST = 0.1  # of the usual size: what a smaller value is held against
MOST_NODES = 12


@dataclass(frozen=True, slots=True)
class Goal:
    """What is read, and the relative standard deviation wanted of it.

    times_h  hours; empty: five from a tenth of the horizon to its end
    nodes    of a field or vector; empty: those with a name, or twelve evenly over the mesh
    """

    quantity: str
    wanted: float
    times_h: tuple[float, ...] = ()
    nodes: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if not 0 < self.wanted < np.inf:
            raise InputError(
                f"accuracy of {self.quantity}", self.wanted, "is not positive", "give 0.01, say"
            )

    def hours(self, surrogate: Surrogate) -> Array:
        """Hours at which the quantity is read [h], (T,)."""
        shares = np.array([0.1, 0.25, 0.5, 0.75, 1.0])
        return np.array(self.times_h) if self.times_h else surrogate.horizon_h * shares

    def places(self, surrogate: Surrogate) -> list[int] | None:
        """Nodes at which it is read; None for a scalar."""
        if surrogate.quantities[self.quantity].kind == "scalar":
            return None
        if self.nodes:
            return list(self.nodes)
        count = surrogate.node_count
        some = np.unique(np.linspace(0, count - 1, MOST_NODES).astype(int)).tolist()
        return sorted(set(surrogate.named.values())) or some


def relative_error(surrogate: Surrogate, region: Region, goal: Goal) -> Array:
    """e of the module's text at the region's points, (n,).

    Raises InputError for a quantity that the surrogate does not have, RangeError for hours beyond
    its runs.
    """
    surrogate.rows(goal.quantity, None)
    mean, sd = surrogate.predict(
        region.x, goal.quantity, goal.hours(surrogate), goal.places(surrogate)
    )
    n, t = mean.shape[:2]
    mean, sd = mean.reshape(n, t, -1), sd.reshape(n, t, -1)
    size = np.abs(mean)
    if surrogate.quantities[goal.quantity].kind == "vector field":
        size = np.sqrt(np.mean(mean**2, axis=2, keepdims=True))
    usual = np.sqrt(np.einsum("n,ntr->tr", region.weight, size**2))
    held = np.maximum(size, np.maximum(LEAST * usual, np.finfo(float).tiny))
    return np.asarray(np.sqrt(np.mean((sd / held) ** 2, axis=(1, 2))))


@dataclass(frozen=True, slots=True)
class Accuracy:
    """How far a goal is met over a region.

    p95, median  weighted quantiles of e
    wanted       what p95 is to be
    """

    quantity: str
    wanted: float
    p95: float
    median: float

    @property
    def met(self) -> bool:
        return self.p95 <= self.wanted

    def __str__(self) -> str:
        of = "of" if self.met else "instead of"
        return f"{self.quantity} {100 * self.p95:.3g} % {of} {100 * self.wanted:.3g} %"


def accuracy(surrogate: Surrogate, region: Region, goals: Sequence[Goal]) -> list[Accuracy]:
    """One for each goal."""
    found = []
    for goal in goals:
        e = relative_error(surrogate, region, goal)
        p95, median = weighted_quantile(e, region.weight, np.array([PROBABILITY, 0.5]))
        found.append(Accuracy(goal.quantity, goal.wanted, float(p95), float(median)))
    return found


def cost(surrogate: Surrogate, region: Region, goals: Sequence[Goal]) -> Array:
    """a of the module's text at the region's points, (n,)."""
    _, v = surrogate.process.mean_and_variance(surrogate.scaled(region.x), ())
    total = np.zeros(len(v))
    for goal in goals:
        total += (relative_error(surrogate, region, goal) / goal.wanted) ** 2 / len(goals)
    return np.asarray(total / v)
