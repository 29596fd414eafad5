"""Outer integral of a blade's message, and a rough look at it; 16 shared values at once.

The profile over the outermost local parameter is known at the stations of a `survey`. Panels break
at the ends of its support and where the set of active bounds changes; ``volume_sums`` goes panel by
panel (`panels`), with `planes` for the inner two parameters. ``volume_glances`` takes Laplace's
approximation of a plane's integral, from the height V and the information H of its mode,

    log ∫∫ L ≈ V + log 2π − ½ log det(H + 1),      log 4 above V at most, the box's own size,

and sums over the stations.

Coefficients of a block of volumes are flat: ``a[(((6 r + d) 6 + j) 6 + k) LANES + i]`` belongs to
the powers d, j, k of the outer, middle and inner parameter of row r at the i-th shared value.
"""

from __future__ import annotations

import math

import numpy as np

from core.calibration import lines
from core.calibration.modes import SCRATCH, TG, TM, V, X, collapse_volumes, plane_modes
from core.calibration.panels import GL_X, MOST, POINTS, laid_out, next_panels, take
from core.calibration.planes import FIELDS as PLANE_FIELDS
from core.calibration.planes import STATIONS as PLANE_STATIONS
from core.calibration.planes import plane_sums
from core.calibration.survey import (
    ACTIVE,
    AT,
    BEST,
    DEPTH,
    FIELDS,
    HIGH,
    IGG,
    INN,
    IXG,
    IXX,
    LOW,
    MID,
    STATIONS,
    TOP,
    support,
    survey,
)
from core.calibration.vector import LANES
from core.compiled import compiled

SPLIT = 0.025  # nat, times a panel's share, that its last coefficient may be
THIN = 0.01  # share of the support that is no panel of its own
EDGES = (-1.0, 0.0, 1.0)  # breaks about a meeting with a bound, in its half widths


@compiled
def cross(seen, i, s, t, top):  # type: ignore[no-untyped-def]
    """Where the profile falls to top − DEPTH between station s (above) and station t (below)."""
    high = math.sqrt(max(top - seen[TOP, s, i], 0.0))
    low = math.sqrt(max(top - seen[TOP, t, i], 0.0))
    part = min(max((math.sqrt(DEPTH) - high) / (low - high + 1e-12), 0.0), 1.0) * 0.9 + 0.1
    return seen[AT, s, i] + part * (seen[AT, t, i] - seen[AT, s, i])


@compiled
def meeting(seen, i, s, width):  # type: ignore[no-untyped-def]
    """Where a mode meets its bound between stations s and s + 1: (place, half width)."""
    here, there = seen[ACTIVE, s, i], seen[ACTIVE, s + 1, i]
    middle = here // 3.0 != there // 3.0  # which of the two meets its bound
    own = MID if middle else INN
    side = here // 3.0 - 1.0 if middle else here % 3.0 - 1.0
    free, held = (s, s + 1) if side == 0.0 else (s + 1, s)
    code = seen[ACTIVE, held, i]
    bound = code // 3.0 - 1.0 if middle else code % 3.0 - 1.0
    xx, xg, gg = seen[IXX, free, i], seen[IXG, free, i], seen[IGG, free, i]
    sd = math.sqrt(((gg if middle else xx) + 1e-9) / (xx * gg - xg * xg + 1e-9))
    run = seen[AT, held, i] - seen[AT, free, i]
    slope = (bound - seen[own, free, i]) / run
    behind = 2 * free - held
    if 0 <= behind < STATIONS and seen[ACTIVE, behind, i] == seen[ACTIVE, free, i]:
        other = seen[own, free, i] - seen[own, behind, i]
        other = other / (seen[AT, free, i] - seen[AT, behind, i])
        slope = other if abs(other) > abs(slope) else slope
    part = min(max((bound - seen[own, free, i]) / (slope + 1e-300) / run, 0.0), 1.0)
    half = min(4.0 * sd / (abs(slope) + 1e-12), 0.25 * width)
    return seen[AT, free, i] + part * run, half


@compiled
def first_panels(seen, plan, i, breaks, panels):  # type: ignore[no-untyped-def]
    """Panels over the support of lane i into panels (MOST, 3, LANES); their number."""
    first, last = support(seen, plan, i)
    top = plan[BEST, i]
    low = seen[AT, 0, i] if first == 0 else cross(seen, i, first, first - 1, top)
    high = seen[AT, STATIONS - 1, i]
    if last < STATIONS - 1:
        high = cross(seen, i, last, last + 1, top)
    breaks[0], breaks[1], n = low, high, 2
    for s in range(max(first - 1, 0), min(last + 1, STATIONS - 1)):
        if seen[ACTIVE, s, i] == seen[ACTIVE, s + 1, i]:
            continue
        place, half = meeting(seen, i, s, high - low)
        for t in EDGES:
            edge = place + t * half
            if low + 0.01 * (high - low) < edge < high - 0.01 * (high - low) and n < len(breaks):
                breaks[n] = edge
                n += 1
    return laid_out(breaks, n, THIN, panels, i)


@compiled
def near(a, b, v, y, s2, ka2, kb2, w, pa, pb, pv, seen, plan):  # type: ignore[no-untyped-def]
    """Modes on the planes at w[X], from the stations on either side."""
    collapse_volumes(a, ka2, w, pa)
    collapse_volumes(b, kb2, w, pb)
    collapse_volumes(v, kb2, w, pv)
    for i in range(LANES):
        w[V + i] = -math.inf
    for side in range(2):
        for i in range(LANES):
            h = (plan[HIGH, i] - plan[LOW, i]) / (STATIONS - 1)
            s = min(max(int((w[X + i] - plan[LOW, i]) / (h + 1e-300)), 0), STATIONS - 2) + side
            w[TM + i], w[TG + i] = seen[MID, s, i], seen[INN, s, i]
        plane_modes(pa, pb, pv, y, s2, ka2, kb2, w)


@compiled
def volume_sums(a, b, v, y, s2, ka2, kb2, out):  # type: ignore[no-untyped-def]
    """log ∫∫∫ L over the box of the three local parameters at 16 shared values, out (LANES,)."""
    rows = len(ka2)
    w, wl = np.empty(SCRATCH), np.empty(lines.SCRATCH)
    la, lb, lv = np.empty(6 * rows * LANES), np.empty(6 * rows * LANES), np.empty(6 * rows * LANES)
    pa, pb = np.empty(36 * rows * LANES), np.empty(36 * rows * LANES)
    pv = np.empty(36 * rows * LANES)
    seen, plan = np.empty((FIELDS, STATIONS, LANES)), np.empty((3, LANES))
    seen2, plan2 = np.empty((PLANE_FIELDS, PLANE_STATIONS, LANES)), np.empty((7, LANES))
    panels, waiting = np.empty((MOST, 3, LANES)), np.empty(LANES, dtype=np.int64)
    panels2, waiting2 = np.empty((MOST, 3, LANES)), np.empty(LANES, dtype=np.int64)
    breaks, half, mid = np.empty(24), np.empty(LANES), np.empty(LANES)
    f, value, peak = np.empty((POINTS, LANES)), np.empty(LANES), np.empty(LANES)
    # a single row leaves a thin sheet through the box, whose profile bends where it meets a side
    split = SPLIT if rows > 1 else 0.4 * SPLIT
    survey(a, b, v, y, s2, ka2, kb2, w, pa, pb, pv, seen, plan, False)
    for i in range(LANES):
        waiting[i] = first_panels(seen, plan, i, breaks, panels)
        out[i], peak[i] = 0.0, -math.inf
    while next_panels(panels, waiting, half, mid) > 0:
        for n in range(POINTS):
            for i in range(LANES):
                w[X + i] = mid[i] + half[i] * GL_X[n]
            near(a, b, v, y, s2, ka2, kb2, w, pa, pb, pv, seen, plan)
            plane_sums(
                pa, pb, pv, y, s2, ka2, kb2, w, wl, la, lb, lv, seen2, plan2, panels2, waiting2,
                value
            )  # fmt: skip
            for i in range(LANES):
                f[n, i] = value[i]
        take(f, half, mid, split, panels, waiting, out, peak)
    for i in range(LANES):
        out[i] = peak[i] + math.log(out[i])


@compiled
def laplace(top, xx, xg, gg):  # type: ignore[no-untyped-def]
    """log of a plane's integral from the height and the information of its mode."""
    det = (xx + 1.0) * (gg + 1.0) - xg * xg
    return top + min(math.log(2.0 * math.pi) - 0.5 * math.log(max(det, 1e-9)), math.log(4.0))


@compiled
def volume_glances(a, b, v, y, s2, ka2, kb2, seen, plan, led, out):  # type: ignore[no-untyped-def]
    """A rough log of the triple integral: Laplace in the inner two, a sum over stations outside.

    A tenth of the integral's work and off by tenths of a nat: it tells where the shared
    parameters' nodes should stand, and where draws should fall. `seen` and `plan` as `survey`
    leaves them, and seen[IXX] replaced by the rough log value of each station's plane.
    """
    rows = len(ka2)
    w = np.empty(SCRATCH)
    pa, pb = np.empty(36 * rows * LANES), np.empty(36 * rows * LANES)
    pv = np.empty(36 * rows * LANES)
    survey(a, b, v, y, s2, ka2, kb2, w, pa, pb, pv, seen, plan, led)
    for i in range(LANES):
        peak = -math.inf
        for s in range(STATIONS):
            xx, xg, gg = seen[IXX, s, i], seen[IXG, s, i], seen[IGG, s, i]
            seen[IXX, s, i] = laplace(seen[TOP, s, i], xx, xg, gg)
            peak = max(peak, seen[IXX, s, i])
        total = 0.0
        for s in range(STATIONS):
            total += math.exp(seen[IXX, s, i] - peak)
        out[i] = peak + math.log(total * (plan[HIGH, i] - plan[LOW, i]) / (STATIONS - 1))
