"""Maximin Latin hypercube designs.

A Latin hypercube of n points divides each axis into n equal cells and puts exactly one point in
the middle of each. Among hypercubes the one whose points keep furthest apart is sought by
minimising Morris and Mitchell's criterion

    phi_p(X) = ( sum_{i<j} |x_i - x_j|^-p )^(1/p),    p = 15,

which tends to 1 / min distance as p grows (M. D. Morris, T. J. Mitchell, "Exploratory designs
for computational experiments", J. Stat. Plan. Inference 43 (1995) 381-402). Exchanges of two
coordinates within one column keep the Latin property; they are accepted by simulated annealing
with a geometric cooling. The result depends on the arguments alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from core.errors import InputError
from core.rng import stream

Array = NDArray[np.float64]
POWER = 15
SWEEPS = 40
EDGE = 0.5  # a point lies in the middle of its cell


def criterion(points: Array, power: int = POWER) -> float:
    """Morris and Mitchell's phi_p of points (n, d); smaller is better.

    >>> float(round(criterion(np.array([[0.0, 0.0], [3.0, 4.0]])), 12))
    0.2
    """
    distance = pdist(points)
    nearest = float(distance.min())
    return float(np.sum((nearest / distance) ** power) ** (1.0 / power) / nearest)


def maximin_lhs(
    n: int, low: Sequence[float] | Array, high: Sequence[float] | Array, seed: int
) -> Array:
    """n points (n, d) in the box low … high: a Latin hypercube with a small `criterion`.

    >>> x = maximin_lhs(5, [0.0], [10.0], seed=3)
    >>> sorted(float(v) for v in x[:, 0])
    [1.0, 3.0, 5.0, 7.0, 9.0]
    """
    lower, upper = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    if n < 2:
        raise InputError("n", n, "is fewer than two points", "ask for two points or more")
    if lower.ndim != 1 or lower.shape != upper.shape or not np.all(lower < upper):
        raise InputError(
            "low, high", (low, high), "are not the corners of a box", "give low < high per input"
        )
    rng = stream(seed, "maximin-lhs", n, len(lower))
    cells = np.column_stack([rng.permutation(n) for _ in lower])
    best = _anneal((cells + EDGE) / n, rng) if len(lower) > 1 else (cells + EDGE) / n
    return np.asarray(lower + best * (upper - lower))


def _anneal(unit: Array, rng: np.random.Generator) -> Array:
    """Exchange coordinates within columns; phi^p is updated by the two rows that change."""
    n, d = unit.shape
    scale = 1.0 / n  # distances in cells: keeps the p-th powers near 1
    distance = np.linalg.norm((unit[:, None] - unit[None]) / scale, axis=2)
    np.fill_diagonal(distance, np.inf)
    total = float(np.sum(distance**-POWER)) / 2
    best, best_total = unit.copy(), total
    steps = SWEEPS * n * d
    temperature = 0.05
    cooling = (1e-3) ** (1.0 / steps)
    for _ in range(steps):
        column = int(rng.integers(d))
        i, j = (int(k) for k in rng.choice(n, 2, replace=False))
        trial = unit[[i, j]].copy()
        trial[:, column] = trial[::-1, column]
        rows = np.linalg.norm((trial[:, None] - unit[None]) / scale, axis=2)
        rows[0, i], rows[1, j] = np.inf, np.inf
        rows[0, j] = rows[1, i] = np.inf  # the exchange keeps the distance of the pair
        change = float(np.sum(rows**-POWER))
        old = distance[[i, j]].copy()
        old[0, j] = old[1, i] = np.inf
        change -= float(np.sum(old**-POWER))
        # phi is 1/p-th power of the sum: compare relative changes of phi
        ratio = max(total + change, 0.0) / total
        if ratio <= 1 or rng.random() < np.exp(-(ratio ** (1 / POWER) - 1) / temperature):
            pair = distance[i, j]
            distance[[i, j]] = rows
            distance[i, j] = distance[j, i] = pair
            distance[:, [i, j]] = distance[[i, j]].T
            unit[[i, j]] = trial
            total = max(total + change, np.finfo(float).tiny)
            if total < best_total:
                best, best_total = unit.copy(), total
        temperature *= cooling
    return best
