"""Where readings leave any likelihood: windows of a blade's local parameters.

For rows that a closed form answers, at values of the shared parameters ("nodes"), the local ones
l (D of them) are narrowed to a window by bounds that hold everywhere, not at places that were
tried. As y_r(l) rises or falls with each coordinate, over a cell it lies between its values at two
corners, [y_r-, y_r+], and with d(a, [b, c]) the distance of a reading from that interval

    −½ Σ d(y_obs, [y-, y+])² / var  ≥  log L(l)  ≥  −½ Σ max(|y_obs − y-|, |y_obs − y+|)² / var.

Cells whose upper bound lies `NEGLIGIBLE` nats below a lower bound of the whole integral are left
out, the window becomes the hull of the others, and again, until it stays as it is. Where cells in
its middle are left out, or a single parameter's log L has a valley, it becomes two: the kernels
climb one summit. What is left out is less than e^−40 of the message.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from core.errors import CalibrationError

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Answer = Callable[[Index, Array], Array]
NEGLIGIBLE = 48.0  # nats; at most e^7 cells are left out, so less than e^-40 of the message is
CELLS = {1: 16, 2: 8, 3: 5}  # of a window along each coordinate
STALLED = 0.85  # share of its width that a window keeps when it is not narrowed again
VALLEY = 1.0  # nats between two summits from which on they get windows of their own
MOST = 64  # windows, and boxes, at one node


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
    Raises CalibrationError where a row is no number, naming it and the place, and for readings with
    more than `MOST` summits.
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
        _check_numbers(readings, rows, at)
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


def _check_numbers(readings: Readings, rows: Array, at: Array) -> None:
    """Rows (W, C, R) at local parameters (W, C, D) are numbers; an infinite one is excluded."""
    wrong = np.argwhere(np.isnan(rows))
    if not len(wrong):
        return
    window, corner, row = wrong[0].tolist()
    raise CalibrationError(
        f"{readings.labels[row]} is not a number where the local parameters are "
        f"{at[window, corner].tolist()} (at {len(wrong)} of {rows.size} values that were asked). "
        "Correct the formula, or narrow the priors: it needs a value at their bounds, too."
    )


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
