"""When a memory is reached: the time at which creep under other inputs has come as far.

    t*:  t* exp(g(t*)) = e

of `core.surrogate.history`, for strains that grow. The curve g goes on beyond the last instant of
the runs with the slope that it has there, up to `BEYOND` times that instant. Where strain is less
in the end than what is asked for, it is reached at the first instant at which there was as much.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from core.errors import RangeError
from core.surrogate.followed import Curves

Array = NDArray[np.float64]
BEYOND = 3.0
EARLIEST_H = 1e-6
STEPS = 60
CLOSE = 1e-7  # last step of log t by Newton: what it leaves goes with its square
HALVED = 1e-11  # last by halves
AT_END = 10.0 * CLOSE
WIDE = 1000  # columns: a whole field, of which each is a row of its own


def clock(
    curve: Curves, weights: Array, strain: Array, late: bool = False, near: Array | None = None
) -> Array:
    """log t* (n, R) at which t exp(g(t)) reaches `strain` (n, R), for it grows.

    By Newton's steps from where it may be, else from the far end, where creep is slow and log E
    nearly straight over log t; by halves where one would leave what is known to hold it, or shrinks
    less than the step before last by half (Press et al., Numerical Recipes, 9.4). A row that has
    arrived rests, so that it depends on no other.

    weights  of the curves (n, A, R)
    late     where it is reached only after `BEYOND`, or never: that time, in place of a RangeError
    near     log times (n, R) about there
    """
    if strain.shape[1] > WIDE:
        return _each(curve, weights, strain, late, near)
    found = np.full(strain.shape, np.log(EARLIEST_H))
    rows = np.flatnonzero(np.any(strain > 0, axis=1))
    if not rows.size:
        return found
    w, grown = weights[rows], strain[rows] > 0
    wanted = np.log(np.maximum(strain[rows], 1e-300))
    low = np.full(wanted.shape, found.flat[0])
    high = np.full(wanted.shape, curve.last + np.log(BEYOND))
    at = high.copy() if near is None else np.clip(near[rows], low, high)
    g, slope = curve.with_slope(w, at)
    short = at + g - wanted
    behind = short < 0
    if (far := np.flatnonzero(np.any(behind, axis=1))).size:
        behind[far] &= wanted[far] > high[far] + curve(w[far], high[far])
    if (back := np.flatnonzero(np.any(behind, axis=1))).size:
        there = _first(curve, w[back], wanted[back])
        never = behind[back] & np.isnan(there)
        if not late and np.any(never):
            raise RangeError(
                "creep strain",
                float(strain.max()),
                f"is not reached within {BEYOND:g} times the horizon under the inputs that follow",
                "train on longer runs",
            )
        end = high[back]
        low[back] = np.where(never, end, low[back])
        high[back] = np.where(behind[back] & ~never, there, end)
        wanted[back] = np.where(never, end + curve(w[back], end), wanted[back])
        then = np.clip(at[back], low[back], high[back])
        again = curve.with_slope(w[back], then)
        at[back], g[back], slope[back] = (
            np.where(behind[back], new, one[back])
            for new, one in zip((then, *again), (at, g, slope), strict=True)
        )
        short = at + g - wanted
    moved = before = high - low
    for _ in range(STEPS):
        low, high = np.where(short < 0, at, low), np.where(short < 0, high, at)
        slope = 1.0 + slope
        newton = at - short / np.where(slope > 0, slope, 1.0)
        shrinks = 2.0 * np.abs(short) <= np.abs(before * slope)
        good = (slope > 0) & (newton >= low) & (newton <= high) & shrinks
        following = np.where(good, newton, 0.5 * (low + high))
        before, moved, at = moved, np.abs(following - at), following
        left = np.any((moved >= np.where(good, CLOSE, HALVED)) & grown, axis=1)
        found[rows[~left]] = np.where(grown, at, found.flat[0])[~left]
        if not left.any():
            return found
        rows, grown = rows[left], grown[left]
        w, wanted, low, high = (one[left] for one in (w, wanted, low, high))
        at, moved, before = (one[left] for one in (at, moved, before))
        g, slope = curve.with_slope(w, at)
        short = at + g - wanted
    found[rows] = np.where(grown, at, found.flat[0])
    return found


def unreached(curve: Curves, log_t: Array) -> NDArray[np.bool_]:
    """Where `clock` came to the far end, if late: what is asked for is reached there, or later."""
    return np.asarray(log_t > curve.last + np.log(BEYOND) - AT_END)


def _each(curve: Curves, weights: Array, strain: Array, late: bool, near: Array | None) -> Array:
    """`clock` of each node by itself: of thousands some take ten times the steps of most."""
    flat = np.ascontiguousarray(np.swapaxes(weights, 1, 2)).reshape(-1, weights.shape[1], 1)
    about = None if near is None else near.reshape(-1, 1)
    return clock(curve, flat, strain.reshape(-1, 1), late, about).reshape(strain.shape)


def _first(curve: Curves, weights: Array, wanted: Array) -> Array:
    """Of rows (n, R) the first instant of the runs, as log t, at which a log strain is reached; NaN
    for none.

    Strain of what hardly creeps a surrogate follows to a few per cent, up and down: it may be less
    at the far end than in between.
    """
    first = np.full(wanted.shape, np.nan)
    for instant in curve.spline.x[::-1]:
        then = np.full(wanted.shape, instant)
        first = np.where(then + curve(weights, then) >= wanted, then, first)
    return first
