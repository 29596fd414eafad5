"""Where readings leave any likelihood, and boxes there on which rows are polynomials.

For rows that a closed form answers, at values of the shared parameters ("nodes"), the local ones
l (D of them) are narrowed to a window by bounds that hold everywhere, not at places that were
tried. As y_r(l) rises or falls with each coordinate, over a cell it lies between its values at two
corners, [y_r-, y_r+], and with d(a, [b, c]) the distance of a reading from that interval

    −½ Σ d(y_obs, [y-, y+])² / var  ≥  log L(l)  ≥  −½ Σ max(|y_obs − y-|, |y_obs − y+|)² / var.

Cells whose upper bound lies `NEGLIGIBLE` nats below a lower bound of the whole integral are left
out, the window becomes the hull of the others, and again, until it stays as it is. Where cells in
its middle are left out, or a single parameter's log L has a valley, it becomes two: the kernels
climb one summit. What is left out is less than e^−40 of the message.

The window is then halved until, on each box, every row is a·exp(b) with polynomials of degree 5.
What they miss is measured, as a share of noise and misfit together,

    e_r = max over a box of |polynomial − y_r| / sqrt(var_r + (y_r − y_obs)²),

must stay below `TOLERANCE` (log L is then known to `TOLERANCE` times its own depth), and widens the
noise: var_r (1 + e_r²). Boxes that the readings exclude are dropped on the way. The integral over
the window is the sum over the boxes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from core.errors import CalibrationError
from core.response import monomials, multi_indices

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Answer = Callable[[Index, Array], Array]
DEGREE = 5
NEGLIGIBLE = 48.0  # nats; at most e^7 cells are left out, so less than e^-40 of the message is
CELLS = {1: 16, 2: 8, 3: 5}  # of a window along each coordinate
STALLED = 0.85  # share of its width that a window keeps when it is not narrowed again
VALLEY = 1.0  # nats between two summits from which on they get windows of their own
TOLERANCE = 2e-4
MOST = 64  # boxes at one node
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


@dataclass(frozen=True)
class Readings:
    """What a window is found from.

    answer   (nodes (n,), local parameters (n, D)) → rows (n, R)
    y, s2    readings and noise variances at each node, (K, R)
    falling  local parameters with which rows fall, (D,); with the others they rise
    labels   of the rows, for errors
    """

    answer: Answer
    y: Array
    s2: Array
    falling: NDArray[np.bool_]
    labels: Sequence[str]

    def bounds(self, node: Index, low: Array, high: Array) -> tuple[Array, Array]:
        """Upper and lower bounds of Σ −½ (y − y_obs)² / var over boxes (B, D): (B,) each."""
        down = self.answer(node, np.where(self.falling, high, low))
        up = self.answer(node, np.where(self.falling, low, high))
        return between(down, up, self.y[node], self.s2[node])


def between(one: Array, other: Array, y: Array, s2: Array) -> tuple[Array, Array]:
    """Upper and lower bounds of the log likelihood of rows that lie between two values (…, R)."""
    least, most = np.minimum(one, other), np.maximum(one, other)
    near = np.clip(y, least, most) - y
    far = np.maximum(np.abs(y - least), np.abs(most - y))
    return -0.5 * np.sum(near**2 / s2, axis=-1), -0.5 * np.sum(far**2 / s2, axis=-1)


def _log_sum(values: Array) -> Array:
    top = values.max(axis=1)
    return np.asarray(top + np.log(np.sum(np.exp(values - top[:, None]), axis=1)))


@lru_cache(maxsize=8)
def _grid(d: int) -> tuple[Array, Index, Index]:
    """Corners (C, D) as shares of a window; the two end corners of each cell, by number."""
    n = CELLS[d]
    corners = np.array(list(product(range(n + 1), repeat=d)))
    place = (n + 1) ** np.arange(d - 1, -1, -1)
    first = np.array(list(product(range(n), repeat=d)))
    return corners / n, first @ place, (first + 1) @ place


def narrowed(readings: Readings, low: Array, high: Array) -> tuple[Index, Array, Array, Array]:
    """Windows inside a box (D,): node (W,), low, high (W, D); lower bounds of log ∫ L dl, (K,).

    A window with a gap along a coordinate, or a valley between two summits, becomes two.
    """
    k, d = len(readings.y), len(low)
    floor, (shares, first, last) = np.full(k, -np.inf), _grid(d)
    cells, corners = CELLS[d], len(shares)
    starts = shares[first] * cells
    turned = np.where(readings.falling, 1.0 - shares, shares)
    node, lows, highs = np.arange(k), np.tile(low, (k, 1)), np.tile(high, (k, 1))
    found: list[tuple[Index, Array, Array]] = []
    while len(node):
        wide = highs - lows
        at = lows[:, None, :] + turned[None] * wide[:, None, :]
        rows = readings.answer(np.repeat(node, corners), at.reshape(-1, d))
        rows = rows.reshape(len(node), corners, -1)
        y, s2 = readings.y[node, None], readings.s2[node, None]
        upper, lower = between(rows[:, first], rows[:, last], y, s2)
        volume = np.sum(np.log(wide / cells), axis=1)
        np.maximum.at(floor, node, _log_sum(lower) + volume)
        kept = upper + volume[:, None] >= floor[node, None] - NEGLIGIBLE
        begin = np.where(kept[:, :, None], starts[None], cells).min(axis=1)
        end = np.where(kept[:, :, None], starts[None] + 1, 0).max(axis=1)
        cut = _gaps(kept, begin)
        if d == 1:
            log_l = -0.5 * np.sum((rows - y) ** 2 / s2, axis=2)
            valley = _valleys(log_l)[:, None]
            cut = np.where(cut == 0, np.where((valley > begin) & (valley < end), valley, 0), cut)
        along = np.where(cut.any(axis=1), np.argmax(cut > 0, axis=1), -1)[:, None] == np.arange(d)
        pieces = [(begin, np.where(along, cut, end)), (np.where(along, cut, begin), end)]
        two, stalled = along.any(axis=1), np.all(end - begin > STALLED * cells, axis=1)
        excluded = ~kept.any(axis=1)
        chosen = [~excluded & (two | ~stalled), two & ~excluded]
        done = ~excluded & stalled & ~two
        found.append((node[done], lows[done], highs[done]))
        following = []
        for (a, b), which in zip(pieces, chosen, strict=True):
            a, b = (
                np.where(readings.falling, cells - b, a),
                np.where(readings.falling, cells - a, b),
            )
            parts = (node, lows + a / cells * wide, lows + b / cells * wide)
            following.append([v[which] for v in parts])
        node, lows, highs = (np.concatenate(v) for v in zip(*following, strict=True))
        if len(node) and np.bincount(node).max() > MOST:
            raise CalibrationError(
                f"the likelihood of {len(readings.labels)} rows ({readings.labels[0]} …) has more "
                f"than {MOST} summits in the local parameters: check the readings"
            )
    n, a, b = (np.concatenate(v) for v in zip(*found, strict=True))
    return n, a, b, floor


def _gaps(kept: NDArray[np.bool_], begin: Array) -> Array:
    """Along each coordinate of each window the end of its first run of cells, 0 if the last one."""
    windows, d = begin.shape
    kept = kept.reshape(windows, *(CELLS[d],) * d)
    out, number = np.zeros(begin.shape), np.arange(CELLS[d])
    for j in range(d):
        seen = kept.any(axis=tuple(k + 1 for k in range(d) if k != j))
        after = ~seen & (number > begin[:, [j]])
        gap = np.argmax(after, axis=1)
        more = (seen & (number > gap[:, None])).any(axis=1)
        out[:, j] = np.where(after.any(axis=1) & more, gap, 0)
    return out


def _valleys(log_l: Array) -> Array:
    """The number of the edge at the deepest valley of log L along windows (W, C), 0 for none."""
    left = np.maximum.accumulate(log_l, axis=1)
    right = np.maximum.accumulate(log_l[:, ::-1], axis=1)[:, ::-1]
    depth = np.minimum(left, right) - log_l
    return np.where(depth.max(axis=1) > VALLEY, np.argmax(depth, axis=1), 0)


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
