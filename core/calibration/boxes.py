"""Boxes on which rows of a closed form are polynomials, in the layout of the kernels.

A window (`windows`) is halved until, on each box, every row is a·exp(b) with polynomials of degree
5. What they miss is measured, as a share of noise and misfit together,

    e_r = max over a box of |polynomial − y_r| / sqrt(var_r + (y_r − y_obs)²),

must stay below `TOLERANCE` (log L is then known to `TOLERANCE` times its own depth), and widens the
noise: var_r (1 + e_r²). Boxes that the readings exclude are dropped on the way. The integral over
the window is the sum over the boxes, and draws come from the boxes in proportion to their shares of
it (`picked`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from core.calibration.vector import LANES
from core.calibration.windows import MOST, NEGLIGIBLE, Readings, narrowed
from core.errors import CalibrationError
from core.monomials import monomials, multi_indices

Array = NDArray[np.float64]
Index = NDArray[np.int64]
DEGREE = 5
TOLERANCE = 2e-4
DESIGN, CHECKS = {1: 7, 2: 7, 3: 6}, {1: 9, 2: 6, 3: 5}  # points along each coordinate


@dataclass(frozen=True, slots=True)
class Boxes:
    """B boxes of D local parameters, each at one of K nodes, with the R rows on them.

    node (B,) in rising order; low, high (B, D) natural units; a, b (B, R, M) coefficients on the
    box scaled to [-1, 1]; error (B, R), e_r of the module's text.
    """

    node: Index
    low: Array
    high: Array
    a: Array
    b: Array
    error: Array


@dataclass(frozen=True, slots=True)
class Pieces:
    """A column in pieces: the boxes of all nodes, log ∫ L dl over each, and (y, s2, rest)."""

    boxes: Boxes
    sums: Array
    y: Array
    s2: Array
    rest: Array

    @property
    def nbytes(self) -> int:
        """Of its arrays."""
        own = self.boxes
        boxes = (own.node, own.low, own.high, own.a, own.b, own.error)
        return sum(one.nbytes for one in (*boxes, self.sums, self.y, self.s2, self.rest))


@lru_cache(maxsize=8)
def _tools(d: int) -> tuple[Array, Array, Array]:
    """Design points (n, D), the map from values there to coefficients (M, n), checks (c, D)."""
    n, c = DESIGN[d], CHECKS[d]
    design = np.array(list(product(np.cos(np.pi * (np.arange(n) + 0.5) / n), repeat=d)))
    checks = np.array(list(product(np.cos(np.pi * np.arange(c) / (c - 1)), repeat=d)))
    turn = np.asarray(np.linalg.pinv(monomials(design, DEGREE)), np.float64)
    return design, turn, checks


def _fitted(readings: Readings, node: Index, low: Array, high: Array) -> tuple[Array, Array, Array]:
    """Coefficients a, b (B, R, M) on boxes (B, D), and what they miss, e (B, R)."""
    d = low.shape[1]
    design, turn, checks = _tools(d)
    points = np.concatenate([design, checks])
    at = low[:, None, :] + 0.5 * (points[None] + 1.0) * (high - low)[:, None, :]
    rows = readings.answer(np.repeat(node, len(points)), at.reshape(-1, d))
    rows = rows.reshape(len(node), len(points), -1)
    fit, exact = rows[:, : len(design)], rows[:, len(design) :]
    basis = monomials(checks, DEGREE)
    scale = np.sqrt(readings.s2[node, None] + (exact - readings.y[node, None]) ** 2)

    def missed(found: Array) -> Array:
        return np.asarray(np.max(np.abs(found - exact) / scale, axis=1), np.float64)

    plain = np.einsum("mn,bnr->brm", turn, fit)
    error = missed(np.einsum("cm,brm->bcr", basis, plain))
    positive = np.all(rows > 0.0, axis=1)
    logs = np.log(np.where(positive[:, None, :], fit, 1.0))
    powers = np.einsum("mn,bnr->brm", turn, logs)
    better: Array = missed(np.exp(np.minimum(np.einsum("cm,brm->bcr", basis, powers), 300.0)))
    as_log = positive & (better < error)
    one = np.zeros(plain.shape[2])
    one[0] = 1.0
    a: Array = np.where(as_log[:, :, None], one, plain)
    b: Array = np.where(as_log[:, :, None], powers, 0.0)
    return a, b, np.asarray(np.where(as_log, better, error), np.float64)


def boxes(readings: Readings, low: Array, high: Array) -> Boxes:
    """The boxes inside (D,) bounds on which the rows are polynomials, at every node.

    Raises CalibrationError where a node needs more than `MOST`, naming the row and the box.
    """
    node, lows, highs, floor = narrowed(readings, low, high)
    d = len(low)
    powers = multi_indices(d, DEGREE)
    found: list[tuple[Index, Array, Array, Array, Array, Array]] = []
    counts = np.zeros(len(floor), dtype=np.int64)
    while len(node):
        a, b, error = _fitted(readings, node, lows, highs)
        total = np.sqrt(np.sum(error**2, axis=1))
        done = total <= TOLERANCE
        found.append((node[done], lows[done], highs[done], a[done], b[done], error[done]))
        np.add.at(counts, node[done], 1)
        node, lows, highs, a, b, error = (v[~done] for v in (node, lows, highs, a, b, error))
        waiting = counts + np.bincount(node, minlength=len(counts))
        if len(node) and waiting.max() > MOST:
            worst = int(np.argmax(waiting[node]))
            row = int(np.argmax(error[worst]))
            raise CalibrationError(
                f"{readings.labels[row]} is no polynomial of degree {DEGREE} even on 1 of {MOST} "
                f"parts of its window: between {lows[worst].tolist()} and "
                f"{highs[worst].tolist()} it misses {error[worst, row]:.2g} of noise and misfit, "
                f"{TOLERANCE:g} is allowed. Narrow the priors of the local parameters, or check "
                "that the formula has no kinks."
            )
        # along the coordinate whose third and higher powers weigh most
        weight = np.einsum("brm,mj->bj", np.abs(a) + np.abs(b), powers * (powers >= 3))
        along = np.eye(d, dtype=bool)[np.argmax(weight, axis=1)]
        middle = 0.5 * (lows + highs)
        node = np.concatenate([node, node])
        lows, highs = (
            np.concatenate([lows, np.where(along, middle, lows)]),
            np.concatenate([np.where(along, middle, highs), highs]),
        )
        if len(node):
            upper, _ = readings.bounds(node, lows, highs)
            volume = np.sum(np.log(highs - lows), axis=1)
            kept = upper + volume >= floor[node] - NEGLIGIBLE
            node, lows, highs = node[kept], lows[kept], highs[kept]
    parts = [np.concatenate(v) for v in zip(*found, strict=True)]
    order = np.lexsort((*parts[1].T, parts[0]))
    return Boxes(*(v[order] for v in parts))


def picked(found: Pieces, u: Array) -> tuple[Index, Array, Array]:
    """For points u (n, m): the box of each, the place inside its share, its log share; (n, m)."""
    node, sums = found.boxes.node, found.sums
    n = len(u)
    first = np.searchsorted(node, np.arange(n + 1))
    box, inside, log_share = np.empty(u.shape, dtype=np.int64), np.empty(u.shape), np.empty(u.shape)
    for k in range(n):
        own = sums[first[k] : first[k + 1]]
        share = np.exp(own - own.max())
        share /= share.sum()
        edge = np.concatenate([[0.0], np.cumsum(share)])
        at = np.clip(np.searchsorted(edge, u[k], side="right") - 1, 0, len(own) - 1)
        box[k] = first[k] + at
        inside[k] = np.clip((u[k] - edge[at]) / share[at], 0.0, 1.0 - 1e-12)
        log_share[k] = np.log(share[at])
    return box, inside, log_share


def laid_out(made: Boxes, which: Index, y: Array, s2: Array) -> tuple[Array, ...]:
    """What the kernels take of `LANES` boxes; those beyond the last repeat it."""
    which = np.minimum(which, len(made.node) - 1)
    node, d = made.node[which], made.low.shape[1]
    table = multi_indices(d, DEGREE)
    exponents = np.zeros((len(table), 3), dtype=np.int64)
    exponents[:, 3 - d :] = table
    a, b = (v[which].transpose(1, 2, 0).reshape(v.shape[1], -1) for v in (made.a, made.b))
    rows = np.ascontiguousarray(y[node].T)[None]
    noise = np.ascontiguousarray((s2[node] * (1.0 + made.error[which] ** 2)).T)[None]
    factors = np.tile(np.eye(LANES), (len(table), 1))[None]
    none = np.zeros(len(a))
    return (
        np.ascontiguousarray(a),
        np.ascontiguousarray(b),
        np.zeros_like(a),
        np.repeat(exponents, LANES, axis=0),
        factors,
        rows,
        noise,
        none,
        none.copy(),
    )
