"""Outer integral of a blade's message, and a rough look at it; 16 shared values at once.

The outermost local parameter (the coating, for a rotor blade) runs along the ridge on which
readings cannot tell the parameters apart. ``survey`` looks at the profile over it (the height of
the mode, `modes`) at even stations over the support, which it narrows where hardly a station lies
inside. A plane may have a second summit at one of its sides, which holds a climb where the noise is
small; so every fifth station is climbed from five places, and its mode is handed on from station
to station along the ridge. Panels break at the ends of the support and where the set of active
bounds changes; ``volume_sums`` goes panel by panel (`panels`).

Coefficients of a block of volumes are flat: ``a[(((6 r + d) 6 + j) 6 + k) LANES + i]`` belongs to
the powers d, j, k of the outer, middle and inner parameter of row r at the i-th shared value.
"""

from __future__ import annotations

import math

import numpy as np

from core.calibration import lines
from core.calibration.modes import (
    CODE,
    HGG,
    HXG,
    HXX,
    SCRATCH,
    TG,
    TM,
    G,
    M,
    V,
    X,
    codes,
    collapse_volumes,
    plane_modes,
)
from core.calibration.panels import GL_X, MOST, POINTS, laid_out, next_panels, take
from core.calibration.planes import FIELDS as PLANE_FIELDS
from core.calibration.planes import STATIONS as PLANE_STATIONS
from core.calibration.planes import plane_sums
from core.calibration.vector import LANES
from core.compiled import compiled

STATIONS = 16
STARTS = ((0.0, 0.0), (0.7, 0.7), (-0.7, -0.7), (0.7, -0.7), (-0.7, 0.7))
DEPTH = 11.5  # nats below the profile's top that still count
SPLIT = 0.025  # nat, times a panel's share, that its last coefficient may be
WIDER = 0.25  # of its width, at each end: the range that is taken over from a block near by
GAP = 0.3  # of the box's 2: further from station to station, a ridge may have two summits
THIN = 0.01  # share of the support that is no panel of its own
EDGES = (-1.0, 0.0, 1.0)  # breaks about a meeting with a bound, in its half widths
# a survey's numbers by station: place, profile, middle and inner mode, information, active bounds
AT, TOP, MID, INN, IXX, IXG, IGG, ACTIVE = range(8)
FIELDS = 8
LOW, HIGH, BEST = range(3)


@compiled
def look(a, b, v, y, s2, ka2, kb2, w, pa, pb, pv, seen, plan, s, start):  # type: ignore[no-untyped-def]
    """Climb at station s from the mode at station `start` (−1 − q: from the q-th of `STARTS`).

    From another station also with the step that led there from the one behind it: a narrow ridge
    leaves the mode of one station far below the ridge at the next.
    """
    for i in range(LANES):
        w[X + i] = plan[LOW, i] + s * (plan[HIGH, i] - plan[LOW, i]) / (STATIONS - 1)
        w[V + i] = -math.inf
        if start >= 0:
            w[TM + i], w[TG + i] = seen[MID, start, i], seen[INN, start, i]
        else:
            w[TM + i], w[TG + i] = STARTS[-1 - start]
    collapse_volumes(a, ka2, w, pa)
    collapse_volumes(b, kb2, w, pb)
    collapse_volumes(v, kb2, w, pv)
    plane_modes(pa, pb, pv, y, s2, ka2, kb2, w)
    behind = 2 * start - s if start != s else -1
    if start >= 0 and 0 <= behind < STATIONS:
        for i in range(LANES):
            m, g = 2.0 * seen[MID, start, i], 2.0 * seen[INN, start, i]
            w[TM + i] = min(max(m - seen[MID, behind, i], -1.0), 1.0)
            w[TG + i] = min(max(g - seen[INN, behind, i], -1.0), 1.0)
        plane_modes(pa, pb, pv, y, s2, ka2, kb2, w)
    codes(w)
    for i in range(LANES):
        if w[V + i] > seen[TOP, s, i] + 1e-6:
            seen[AT, s, i], seen[TOP, s, i] = w[X + i], w[V + i]
            seen[MID, s, i], seen[INN, s, i], seen[ACTIVE, s, i] = w[M + i], w[G + i], w[CODE + i]
            seen[IXX, s, i], seen[IXG, s, i], seen[IGG, s, i] = w[HXX + i], w[HXG + i], w[HGG + i]


@compiled
def survey(a, b, v, y, s2, ka2, kb2, w, pa, pb, pv, seen, plan, led):  # type: ignore[no-untyped-def]
    """Profiles over the outer parameter: seen (8, STATIONS, LANES), ranges in plan (3, LANES).

    `led`: seen and plan are those of a block near by, whose ranges, a little wider, and modes it
    starts from; a summit is then handed on only over gaps of the ridge. Where the profile has not
    fallen off at an end of such a range, the survey begins anew.
    """
    for i in range(LANES):
        if led:
            more = WIDER * (plan[HIGH, i] - plan[LOW, i])
            moved(seen, plan, i, max(plan[LOW, i] - more, -1.0), min(plan[HIGH, i] + more, 1.0))
        else:
            plan[LOW, i], plan[HIGH, i] = -1.0, 1.0
        plan[BEST, i] = -math.inf
    for _ in range(15):
        climbs(a, b, v, y, s2, ka2, kb2, w, pa, pb, pv, seen, plan, led)
        done, covered = True, True
        for i in range(LANES):
            first, last = support(seen, plan, i)
            low, high = plan[LOW, i], plan[HIGH, i]
            covered = covered and (first > 0 or low == -1.0)
            covered = covered and (last < STATIONS - 1 or high == 1.0)
            if last - first < 4 and high - low > 1e-7:
                h = (high - low) / (STATIONS - 1)
                low, high = max(seen[AT, first, i] - h, low), min(seen[AT, last, i] + h, high)
                moved(seen, plan, i, low, high)
                done = False
        if led and not covered:
            led = done = False
            for i in range(LANES):
                plan[LOW, i], plan[HIGH, i], plan[BEST, i] = -1.0, 1.0, -math.inf
        if done:
            break


@compiled
def climbs(a, b, v, y, s2, ka2, kb2, w, pa, pb, pv, seen, plan, led):  # type: ignore[no-untyped-def]
    """The mode at each station: from five places at every fifth of them, then handed on up and
    down; `led`, from the one that is known there, and handed on over gaps only.
    """
    for s in range(STATIONS):
        for i in range(LANES):
            seen[TOP, s, i] = -math.inf
    if led:
        for s in range(STATIONS):
            look(a, b, v, y, s2, ka2, kb2, w, pa, pb, pv, seen, plan, s, s)
    else:
        for s in range(0, STATIONS, STATIONS // 3):
            for start in range(-1, -1 - len(STARTS), -1):
                look(a, b, v, y, s2, ka2, kb2, w, pa, pb, pv, seen, plan, s, start)
    for s in range(1, STATIONS):
        if not led or gap(seen, s - 1, s):
            look(a, b, v, y, s2, ka2, kb2, w, pa, pb, pv, seen, plan, s, s - 1)
    for s in range(STATIONS - 2, -1, -1):
        if not led or gap(seen, s, s + 1):
            look(a, b, v, y, s2, ka2, kb2, w, pa, pb, pv, seen, plan, s, s + 1)


@compiled
def moved(seen, plan, i, low, high):  # type: ignore[no-untyped-def]
    """Set the range of lane i, and its modes to what is known of them at the new stations."""
    width = plan[HIGH, i] - plan[LOW, i]
    own = np.empty((2, STATIONS))
    for s in range(STATIONS):
        own[0, s], own[1, s] = seen[MID, s, i], seen[INN, s, i]
    for s in range(STATIONS):
        x = low + s * (high - low) / (STATIONS - 1)
        place = (x - plan[LOW, i]) / width * (STATIONS - 1)
        q = min(max(int(place), 0), STATIONS - 2)
        for k in range(2):
            mode = own[k, q] + (place - q) * (own[k, q + 1] - own[k, q])
            seen[MID + k, s, i] = min(max(mode, -1.0), 1.0)
    plan[LOW, i], plan[HIGH, i] = low, high


@compiled
def gap(seen, s, t):  # type: ignore[no-untyped-def]
    """Whether the modes of stations s and t lie further apart than a ridge leads, in any lane."""
    for i in range(LANES):
        for k in (MID, INN):
            if abs(seen[k, s, i] - seen[k, t, i]) > GAP:
                return True
    return False


@compiled
def support(seen, plan, i):  # type: ignore[no-untyped-def]
    """First and last station within DEPTH of the best place known."""
    best = 0
    for s in range(STATIONS):
        if seen[TOP, s, i] > seen[TOP, best, i]:
            best = s
    plan[BEST, i] = max(plan[BEST, i], seen[TOP, best, i])
    first = last = best
    for s in range(STATIONS):
        if seen[TOP, s, i] > plan[BEST, i] - DEPTH:
            first, last = min(first, s), max(last, s)
    return first, last


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
