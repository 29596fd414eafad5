"""Middle integral of a blade's message: two parameters free, the outer one fixed; 16 at a time.

For each value of the middle parameter, `line_integrals` gives the inner integral I. Over the middle
parameter I is a bell, or a plateau that falls off where the inner mode runs into a bound of the
box: the width of that fall is the bell's own width, often a thousandth of the box. ``scan`` looks
at the profile (the mode's log L along the way) at even places over the support and
``first_panels`` breaks it where the set of active bounds changes; the integral goes panel by panel
(`panels`).

A block holds `LANES` planes, of one blade at as many values of the shared parameters, each with
its own places: they go through the same steps together, and a plane that needs fewer of them
waits. Coefficients are laid out as `modes` says.
"""

from __future__ import annotations

import math

import numpy as np

from core.calibration import modes
from core.calibration.line_integrals import line_sums
from core.calibration.lines import SIDE, SUM, B, G, S, V, X, line_modes, line_ranges
from core.calibration.panels import GL_X, POINTS, laid_out, next_panels, take
from core.calibration.vector import LANES
from core.compiled import compiled, contracted

STATIONS = 10
EDGE = 11.5  # nats below the top where the support ends
SPLIT = 0.05  # nat, times a panel's share, that its last coefficient may be
THIN = 0.004  # share of the support that is no panel of its own
EDGES = (-1.0, 1.0)  # breaks about a meeting with a bound, in its half widths
REACH = 5.2  # half width of a first scan in widths of the bell
PM, PG, PV = modes.M, modes.G, modes.V
HXX, HXG, HGG = modes.HXX, modes.HXG, modes.HGG
# a scan's numbers by station: place, profile, inner mode, its curvature, active bound and slope
AT, TOP, MODE, BEND, BOUND, STEEP = range(6)
FIELDS = 6
LOW, HIGH, X0, G0, TILT, BEST = range(6)


@contracted
def collapse_planes(c, marks, w, out):  # type: ignore[no-untyped-def]
    """Fix the middle parameter at w[X]: a block of planes → a block of lines, out (6 R LANES,).

    Rows whose mark (R,) is negative are left out (`lines`).
    """
    n = 6 * LANES  # from one power of the middle parameter to the next
    for r in range(len(marks)):
        if marks[r] < 0.0:
            continue
        o, q = 6 * r * LANES, 36 * r * LANES
        for i in range(LANES):
            x, p = w[X + i], q + i
            t = (((c[p + 5 * n] * x + c[p + 4 * n]) * x + c[p + 3 * n]) * x + c[p + 2 * n]) * x
            out[o + i] = (t + c[p + n]) * x + c[p]
            p += LANES
            t = ((c[p + 4 * n] * x + c[p + 3 * n]) * x + c[p + 2 * n]) * x + c[p + n]
            out[o + LANES + i] = t * x + c[p]
            p += LANES
            t = (c[p + 3 * n] * x + c[p + 2 * n]) * x + c[p + n]
            out[o + 2 * LANES + i] = t * x + c[p]
            p += LANES
            out[o + 3 * LANES + i] = (c[p + 2 * n] * x + c[p + n]) * x + c[p]
            p += LANES
            out[o + 4 * LANES + i] = c[p + n] * x + c[p]
            out[o + 5 * LANES + i] = c[p + LANES]


@compiled
def profile(pa, pb, pv, y, s2, ka2, kb2, w, la, lb, lv):  # type: ignore[no-untyped-def]
    """Modes of the lines at w[X], from the starts in w[G]."""
    collapse_planes(pa, ka2, w, la)
    collapse_planes(pb, kb2, w, lb)
    collapse_planes(pv, kb2, w, lv)
    line_modes(la, lb, lv, y, s2, ka2, kb2, w)


@compiled
def scan(pa, pb, pv, y, s2, ka2, kb2, wp, w, la, lb, lv, seen, plan):  # type: ignore[no-untyped-def]
    """Profiles over the supports around the modes in wp; fills seen (6, STATIONS, LANES), plan.

    Each plane's range widens until the profile has fallen at both ends or the box ends, and
    narrows while hardly a station lies inside.
    """
    for i in range(LANES):
        x, g = wp[PM + i], wp[PG + i]
        hxx, hxg, hgg = wp[HXX + i], wp[HXG + i], wp[HGG + i]
        tilt = 0.0 if (g >= 1.0 or g <= -1.0) else -hxg / (hgg + 1e-12)
        reach = REACH / math.sqrt(max(hxx + tilt * hxg, 1e-3))
        plan[LOW, i], plan[HIGH, i] = max(x - reach, -1.0), min(x + reach, 1.0)
        plan[X0, i], plan[G0, i], plan[TILT, i], plan[BEST, i] = x, g, tilt, wp[PV + i]
    for _ in range(24):
        for s in range(STATIONS):
            for i in range(LANES):
                x = plan[LOW, i] + s * (plan[HIGH, i] - plan[LOW, i]) / (STATIONS - 1)
                w[X + i] = x
                w[G + i] = plan[G0, i] + plan[TILT, i] * (x - plan[X0, i])
            profile(pa, pb, pv, y, s2, ka2, kb2, w, la, lb, lv)
            for i in range(LANES):
                seen[AT, s, i], seen[TOP, s, i], seen[MODE, s, i] = w[X + i], w[V + i], w[G + i]
                seen[BEND, s, i], seen[BOUND, s, i] = w[B + i], w[SIDE + i]
                seen[STEEP, s, i] = w[S + i]
        done = True
        for i in range(LANES):
            done = within(seen, plan, i) and done
        if done:
            break


@compiled
def within(seen, plan, i):  # type: ignore[no-untyped-def]
    """True where the scan fits the support of plane i; else its next range goes into `plan`."""
    low, high = plan[LOW, i], plan[HIGH, i]
    best = 0
    for s in range(STATIONS):
        if seen[TOP, s, i] > seen[TOP, best, i]:
            best = s
    top = max(plan[BEST, i], seen[TOP, best, i])
    inside = 0
    for s in range(STATIONS):
        if seen[TOP, s, i] > top - EDGE:
            inside += 1
    if seen[TOP, best, i] >= plan[BEST, i]:
        plan[X0, i], plan[G0, i] = seen[AT, best, i], seen[MODE, best, i]
        plan[BEST, i] = top
    if inside < 5 and high - low > 1e-9:
        narrow = max(inside + 1, 2) * (high - low) / (STATIONS - 1)
        plan[LOW, i] = max(plan[X0, i] - narrow, low)
        plan[HIGH, i] = min(plan[X0, i] + narrow, high)
        return False
    fits = True
    if low > -1.0 and seen[TOP, 0, i] > top - EDGE:
        plan[LOW, i], fits = max(low - 0.6 * (high - low), -1.0), False
    if high < 1.0 and seen[TOP, STATIONS - 1, i] > top - EDGE:
        plan[HIGH, i], fits = min(high + 0.6 * (high - low), 1.0), False
    return fits


@compiled
def fall(seen, i, s, t, top):  # type: ignore[no-untyped-def]
    """Where the profile crosses `top` − EDGE between station s (above) and station t (below)."""
    high = math.sqrt(max(top - seen[TOP, s, i], 0.0))
    low = math.sqrt(max(top - seen[TOP, t, i], 0.0))
    part = (math.sqrt(EDGE) - high) / (low - high + 1e-12)
    return seen[AT, s, i] + min(max(part, 0.0), 1.0) * (seen[AT, t, i] - seen[AT, s, i])


@compiled
def kink(seen, i, s):  # type: ignore[no-untyped-def]
    """Where the inner mode meets a bound between stations s and s + 1: (place, half width)."""
    here, there = seen[BOUND, s, i], seen[BOUND, s + 1, i]
    if here != 0.0 and there != 0.0:
        place = 0.5 * (seen[AT, s, i] + seen[AT, s + 1, i])
        return place, 0.5 * (seen[AT, s + 1, i] - seen[AT, s, i])
    free, held = (s, s + 1) if here == 0.0 else (s + 1, s)
    behind = 2 * free - held
    rise = seen[BOUND, held, i] - seen[MODE, free, i]
    slope = rise / (seen[AT, held, i] - seen[AT, free, i])
    if 0 <= behind < STATIONS and seen[BOUND, behind, i] == 0.0:
        other = seen[MODE, free, i] - seen[MODE, behind, i]
        other = other / (seen[AT, free, i] - seen[AT, behind, i])
        slope = other if abs(other) > abs(slope) else slope
    place = seen[AT, free, i] + (rise / slope if abs(slope) > 1e-12 else 0.0)
    return place, 4.0 / math.sqrt(seen[BEND, free, i] + 1e-12) / (abs(slope) + 1e-12)


@compiled
def first_panels(seen, plan, i, breaks, panels):  # type: ignore[no-untyped-def]
    """Panels over the support of plane i into panels (MOST, 3, LANES); their number."""
    top = plan[BEST, i]
    first, last, best = STATIONS, -1, 0
    for s in range(STATIONS):
        if seen[TOP, s, i] > top - EDGE:
            first, last = min(first, s), max(last, s)
        if seen[TOP, s, i] > seen[TOP, best, i]:
            best = s
    if last < first:  # between two stations
        first = last = best
    left = seen[AT, 0, i] if first == 0 else fall(seen, i, first, first - 1, top)
    right = seen[AT, STATIONS - 1, i]
    if last < STATIONS - 1:
        right = fall(seen, i, last, last + 1, top)
    breaks[0], breaks[1] = left, max(right, left + 1e-15)
    n, width = 2, right - left
    for s in range(max(first - 1, 0), min(last + 1, STATIONS - 1)):
        if seen[BOUND, s, i] == seen[BOUND, s + 1, i]:
            continue
        place, half = kink(seen, i, s)
        for t in EDGES:
            edge = place + t * half
            if left + THIN * width < edge < right - THIN * width and n < len(breaks):
                breaks[n] = edge
                n += 1
    return laid_out(breaks, n, THIN, panels, i)


@compiled
def plane_sums(pa, pb, pv, y, s2, ka2, kb2, wp, w, la, lb, lv, seen, plan, panels, waiting, out):  # type: ignore[no-untyped-def]
    """log ∫∫ L over the box of the two inner parameters, out (LANES,).

    wp holds the modes as plane_modes left them; the rest is scratch.
    """
    breaks, ends = np.empty(24), np.empty((9, LANES))
    half, mid, peak = np.empty(LANES), np.empty(LANES), np.empty(LANES)
    f = np.empty((POINTS, LANES))
    scan(pa, pb, pv, y, s2, ka2, kb2, wp, w, la, lb, lv, seen, plan)
    for i in range(LANES):
        waiting[i] = first_panels(seen, plan, i, breaks, panels)
        out[i], peak[i] = 0.0, -math.inf
    while next_panels(panels, waiting, half, mid) > 0:
        for n in range(POINTS):
            for i in range(LANES):
                x = mid[i] + half[i] * GL_X[n]
                first, wide = seen[AT, 0, i], seen[AT, STATIONS - 1, i] - seen[AT, 0, i]
                at = (x - first) / (wide + 1e-300) * (STATIONS - 1)
                j = min(max(int(at), 0), STATIONS - 2)
                w[X + i] = x
                w[G + i] = seen[MODE, j, i] + (at - j) * (seen[MODE, j + 1, i] - seen[MODE, j, i])
            profile(pa, pb, pv, y, s2, ka2, kb2, w, la, lb, lv)
            line_ranges(la, lb, lv, y, s2, ka2, kb2, w, ends)
            line_sums(la, lb, lv, y, s2, ka2, kb2, w, ends)
            for i in range(LANES):
                f[n, i] = w[SUM + i]
        take(f, half, mid, SPLIT, panels, waiting, out, peak)
    for i in range(LANES):
        out[i] = peak[i] + math.log(out[i])
