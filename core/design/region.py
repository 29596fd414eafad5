"""Where a surrogate has to be accurate: weighted points of the inputs.

The points are draws of a posterior, of all blades side by side: a run that serves one blade of a
hot rotor serves its neighbours. A posterior that rests on a poor surrogate may lie beside the true
one, so a share of the weight is spread over the whole box (`Region.mixed`): the design never stops
to look elsewhere. A posterior in which the surrogate's own variance counts (`core.calibration`
does) is wide while the surrogate is poor, and needs no tempering besides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from core.errors import InputError

Array = NDArray[np.float64]


def sobol(count: int, low: Array, high: Array, seed: int) -> Array:
    """`count` points (count, d) of a scrambled Sobol sequence in the box low … high."""
    engine = qmc.Sobol(len(low), scramble=True, rng=np.random.default_rng(seed))
    unit = engine.random_base2(max(0, int(np.ceil(np.log2(count)))))[:count]
    return np.asarray(low + unit * (high - low))


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """Points x (n, d) in natural units, and weights (n,) that sum to one."""

    x: Array
    weight: Array

    @staticmethod
    def of(x: Array, weight: Array | None = None) -> Region:
        """Points with their weights, equal ones by default; any positive sum will do.

        Raises InputError for weights that are negative, not finite or nothing but zero.
        """
        given = np.ones(len(x)) if weight is None else np.asarray(weight, dtype=float)
        total = float(given.sum()) if len(given) else 0.0
        if given.shape != x.shape[:1] or not np.all(given >= 0) or not 0 < total < np.inf:
            raise InputError(
                "weight", total, "is no sum of weights", "give one weight, 0 or more, per point"
            )
        return Region(np.asarray(x, dtype=float), given / total)

    @staticmethod
    def box(low: Array, high: Array, count: int, seed: int) -> Region:
        """Even weight over a box."""
        return Region.of(sobol(count, low, high, seed))

    def mixed(self, low: Array, high: Array, share: float, count: int, seed: int) -> Region:
        """The same with `share` of its weight spread evenly over the box, on `count` points."""
        if not 0 <= share <= 1:
            raise InputError("share", share, "is no share of the weight", "give 0 … 1")
        if share == 0:
            return self
        even = Region.box(low, high, count, seed)
        return Region(
            np.vstack([self.x, even.x]),
            np.concatenate([(1 - share) * self.weight, share * even.weight]),
        )

    def mean_and_sd(self) -> tuple[Array, Array]:
        """Of each input, (d,)."""
        mean = self.weight @ self.x
        return mean, np.sqrt(np.maximum(self.weight @ (self.x - mean) ** 2, 0.0))
