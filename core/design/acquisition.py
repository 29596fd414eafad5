"""Further runs, where they take most of the variance that matters.

A Gaussian process that is conditioned on runs has the error covariance c(z, z') and the variance of
a further run v(z) = c(z, z) + nugget. A run at z* leaves, whatever it will say,

    c'(z, z') = c(z, z') - c(z, z*) c(z*, z') / v(z*),

so that the variance over a region, points z_r with weights a_r, falls by exactly

    G(z*) = sum_r a_r c(z_r, z*)^2 / v(z*).

That is active learning by Cohn's criterion (D. A. Cohn, "Neural network exploration using optimal
experiment design", Neural Networks 9 (1996) 1071-1083), the weighted integrated variance reduction
(R. B. Gramacy, "Surrogates", 2020, ch. 6.2). The weights are posterior mass times what a unit of v
costs there: a run is made where posterior mass and surrogate error meet. A point without error is
worth nothing, nor is one that tells nothing of any place with weight.

A batch is chosen greedily: after each choice c is updated by that rank-one term, and v with it. The
variance does not depend on the outcome, so that this equals the kriging believer (D. Ginsbourger,
R. Le Riche, L. Carraro, 2010) without its belief. Trends with unknown coefficients change c, not
the update. A process is any object with `cross_covariance` and `mean_and_variance`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError

Array = NDArray[np.float64]


class Process(Protocol):
    """A conditioned Gaussian process over inputs z (n, d)."""

    def cross_covariance(self, z: Array, other: Array) -> Array:
        """c(z_i, z'_j), (n, m), without a nugget."""
        ...

    def mean_and_variance(self, z: Array, columns: Sequence[slice] = ...) -> tuple[Any, Array]:
        """The means of each set of columns, and v (n,), the nugget in it."""
        ...


def _check(candidates: Array, reference: Array, weight: Array) -> None:
    if candidates.ndim != 2 or reference.ndim != 2 or candidates.shape[1] != reference.shape[1]:
        shapes = (candidates.shape, reference.shape)
        raise InputError("points", shapes, "have not the same inputs", "give (m, d) and (n, d)")
    if weight.shape != reference.shape[:1] or not np.all(weight >= 0) or not weight.sum() > 0:
        raise InputError(
            "weight", weight.shape, "is no weight per point", "give (n,), 0 or more, not all zero"
        )


def reductions(process: Process, candidates: Array, reference: Array, weight: Array) -> Array:
    """G of each candidate (m, d) over the reference points (n, d) with weights a (n,): (m,)."""
    _check(candidates, reference, weight)
    _, v = process.mean_and_variance(candidates, ())
    return np.asarray(process.cross_covariance(candidates, reference) ** 2 @ weight / v)


def choose(
    process: Process,
    candidates: Array,
    reference: Array,
    weight: Array,
    count: int,
    pending: Array | None = None,
) -> tuple[NDArray[np.int64], Array]:
    """Which `count` of the candidates (m, d) to run, in greedy order, and G of each in its turn.

    pending   points (k, d) that count as run: under way, or failed

    Equal gains are decided by the coordinates, so that the order of candidates and reference points
    does not matter. Raises InputError where there are fewer candidates than runs.
    """
    _check(candidates, reference, weight)
    if not 1 <= count <= len(candidates):
        raise InputError("count", count, f"is not 1 … {len(candidates)}", "give more candidates")
    order = np.lexsort(candidates.T[::-1])
    taken = np.zeros((0, candidates.shape[1])) if pending is None else pending
    points = np.vstack([candidates[order], taken])
    c = process.cross_covariance(points, reference)
    v = process.mean_and_variance(points, ())[1].copy()
    least = v * 1e-12
    terms: list[Array] = []

    def run_at(i: int) -> None:
        """The rank-one update of c and v by a run at point i."""
        column = process.cross_covariance(points, points[i : i + 1])[:, 0]
        for term in terms:
            column = column - term * term[i]
        terms.append(column / np.sqrt(v[i]))
        np.subtract(c, np.outer(terms[-1], c[i] / np.sqrt(v[i])), out=c)
        np.subtract(v, terms[-1] ** 2, out=v)
        np.maximum(v, least, out=v)

    m = len(candidates)
    for i in range(m, len(points)):
        run_at(i)
    chosen: list[int] = []
    gains: list[float] = []
    for _ in range(count):
        gain = c[:m] ** 2 @ weight / v[:m]
        gain[chosen] = -np.inf
        best = int(np.argmax(gain))
        chosen.append(best)
        gains.append(float(gain[best]))
        run_at(best)
    return order[chosen], np.array(gains)
