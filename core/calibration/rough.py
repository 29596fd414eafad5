"""Rough log densities over one parameter of a blade, as chords between places: where draws fall.

Over the outer parameter the value at a place is Laplace's approximation of the plane's integral
(`volumes`), over the middle one that of a bell on the inner line. Both are smooth but where a ridge
leaves the box: there the density is a plateau with an edge as sharp as the ridge is thin, a
thousandth of the box with one reading and a small noise, and the chord over the edge lies nats
below the plateau. Draws would hardly ever fall there, and then with twenty times the weight of all
others together. So more places are put where a chord falls steeply: about kinks of the middle
profile by halving (`bent`), and wherever most may be hidden of the outer one (`refined`).
"""

from __future__ import annotations

import math

import numpy as np

from core.calibration import modes
from core.calibration.lines import SIDE, B, G, S, V, X
from core.calibration.planes import AT, BEND, BOUND, MODE, STEEP, TOP, profile
from core.calibration.planes import STATIONS as PLANE_STATIONS
from core.calibration.survey import IXX, STATIONS
from core.calibration.vector import LANES
from core.calibration.volumes import laplace, near
from core.compiled import compiled

FALL = 2.0  # nats from place to place, above which another one is put between
MOST = STATIONS + 6  # places over the outer parameter
KINKS = 6  # places at most that are put about kinks of a plane's profile
PLACES = PLANE_STATIONS + KINKS
FLOOR = 9.0  # nats below the whole: a thin floor under the rough values, so that no place is missed


@compiled
def rough_inner(top, g, bend, bound, steep):  # type: ignore[no-untyped-def]
    """log of a bell's integral inside the box, from its mode, slope and curvature."""
    bend = bend + 1e-12
    if bound != 0.0:  # falls off from the bound: an approximate Mills ratio
        steep = abs(steep)
        mills = 2.0 / (steep + math.sqrt(steep * steep + 2.5 * bend))
        return top + math.log(min(mills, 2.0))  # the box is no wider
    root = math.sqrt(0.5 * bend)
    inside = math.erf((1.0 - g) * root) + math.erf((1.0 + g) * root)
    return top + math.log(math.sqrt(0.5 * math.pi / bend) * inside)


@compiled
def kinked(rough, bound, count, i):  # type: ignore[no-untyped-def]
    """The cell of lane i in which the inner mode meets a bound and the profile falls; −1: none."""
    peak = -math.inf
    for s in range(count[i]):
        peak = max(peak, rough[s, i])
    best, most = -1, peak - FLOOR
    for s in range(count[i] - 1):
        high, low = max(rough[s, i], rough[s + 1, i]), min(rough[s, i], rough[s + 1, i])
        if bound[s, i] != bound[s + 1, i] and high - low > FALL and high > most:
            best, most = s, high
    return best


@compiled
def bent(  # type: ignore[no-untyped-def]
    pa, pb, pv, y, s2, ka2, kb2, w, la, lb, lv, seen, at, rough, mode, bound, count
):
    """The scan's rough log density over the middle parameter, and more places about its kinks:
    at, rough, mode and bound (PLACES, LANES), of which each lane has `count`.

    A ridge that leaves the box by the inner parameter's end is a plateau with an edge as sharp as
    the ridge is thin. The chord over that edge lies nats below it, and draws there had weights of
    twenty and more.
    """
    cell = np.empty(LANES, np.int64)
    for i in range(LANES):
        count[i] = PLANE_STATIONS
        for s in range(PLANE_STATIONS):
            at[s, i], mode[s, i], bound[s, i] = seen[AT, s, i], seen[MODE, s, i], seen[BOUND, s, i]
            rough[s, i] = rough_inner(
                seen[TOP, s, i], mode[s, i], seen[BEND, s, i], bound[s, i], seen[STEEP, s, i]
            )
    for _ in range(KINKS):
        some = False
        for i in range(LANES):
            cell[i] = kinked(rough, bound, count, i)
            s = max(cell[i], 0)
            w[X + i], w[G + i] = (
                0.5 * (at[s, i] + at[s + 1, i]),
                0.5 * (mode[s, i] + mode[s + 1, i]),
            )
            some = some or cell[i] >= 0
        if not some:
            break
        profile(pa, pb, pv, y, s2, ka2, kb2, w, la, lb, lv)
        for i in range(LANES):
            if cell[i] < 0:
                continue
            for s in range(count[i], cell[i] + 1, -1):
                at[s, i], rough[s, i] = at[s - 1, i], rough[s - 1, i]
                mode[s, i], bound[s, i] = mode[s - 1, i], bound[s - 1, i]
            s = cell[i] + 1
            at[s, i], mode[s, i], bound[s, i] = w[X + i], w[G + i], w[SIDE + i]
            rough[s, i] = rough_inner(w[V + i], w[G + i], w[B + i], w[SIDE + i], w[S + i])
            count[i] += 1


@compiled
def steepest(at, rough, count, i):  # type: ignore[no-untyped-def]
    """The cell of lane i where most may lie above a chord that falls by nats; −1 for none."""
    best, most, peak = -1, -math.inf, -math.inf
    for q in range(count[i]):
        peak = max(peak, rough[q, i])
    for q in range(count[i] - 1):
        high, low = max(rough[q, i], rough[q + 1, i]), min(rough[q, i], rough[q + 1, i])
        if high - low > FALL and high > peak - FLOOR:
            score = high + math.log(at[q + 1, i] - at[q, i])
            if score > most:
                best, most = q, score
    return best


@compiled
def refined(  # type: ignore[no-untyped-def]
    a, b, v, y, s2, ka2, kb2, w, pa, pb, pv, seen, plan, total, at, rough, count
):
    """The glance's rough log density over the outer parameter, and more places where it falls
    steeply: at and rough (MOST, LANES), of which each lane has its own count.

    A profile that runs into a bound is a plateau with an edge, far above the chord that hides it.
    """
    cell = np.empty(LANES, np.int64)
    for i in range(LANES):
        count[i] = STATIONS
        for s in range(STATIONS):
            at[s, i], rough[s, i] = seen[AT, s, i], max(seen[IXX, s, i] - total[i], -FLOOR)
    for _ in range(MOST - STATIONS):
        some = False
        for i in range(LANES):
            cell[i] = steepest(at, rough, count, i)
            q = max(cell[i], 0)
            w[modes.X + i] = 0.5 * (at[q, i] + at[q + 1, i])
            some = some or cell[i] >= 0
        if not some:
            break
        near(a, b, v, y, s2, ka2, kb2, w, pa, pb, pv, seen, plan)
        for i in range(LANES):
            if cell[i] < 0:
                continue
            for q in range(count[i], cell[i] + 1, -1):
                at[q, i], rough[q, i] = at[q - 1, i], rough[q - 1, i]
            at[cell[i] + 1, i] = w[modes.X + i]
            value = laplace(w[modes.V + i], w[modes.HXX + i], w[modes.HXG + i], w[modes.HGG + i])
            rough[cell[i] + 1, i] = max(value - total[i], -FLOOR)
            count[i] += 1
