"""A look at a blade's profile over its outer parameter, at even stations; 16 shared values at once.

The outermost local parameter (the coating, for a rotor blade) runs along the ridge on which
readings cannot tell the parameters apart. The profile over it is the height of the mode on the
plane of the inner two (`modes`). ``survey`` looks at it at even stations over the support, which it
narrows where hardly a station lies inside. A plane may have a second summit at one of its sides,
which holds a climb where the noise is small; so every fifth station is climbed from five places,
and its mode is handed on from station to station along the ridge.

Coefficients of a block of volumes are laid out as `volumes` says.
"""

from __future__ import annotations

import math

import numpy as np

from core.calibration.modes import (
    CODE,
    HGG,
    HXG,
    HXX,
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
from core.calibration.vector import LANES
from core.compiled import compiled

STATIONS = 16
STARTS = ((0.0, 0.0), (0.7, 0.7), (-0.7, -0.7), (0.7, -0.7), (-0.7, 0.7))
DEPTH = 11.5  # nats below the profile's top that still count
WIDER = 0.25  # of its width, at each end: the range that is taken over from a block near by
GAP = 0.3  # of the box's 2: further from station to station, a ridge may have two summits
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
