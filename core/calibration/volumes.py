"""Outer integral of a blade's message, and draws from what was integrated.

The outermost local parameter (the coating, for a rotor blade) runs along the ridge on which
readings cannot tell the parameters apart. `volume_plan` scans the profile over it, zooms where
the support is narrow, and breaks the panels at the ends of the support and where the set of
active bounds changes; `volume_sum` puts Gauss–Legendre points on each panel and splits a panel
whose last Legendre coefficients are not small.

Arrays of coefficients have shape (R, P, P, P): powers of the outer, middle and inner parameter.
"""

from __future__ import annotations

import math

import numpy as np

from core.calibration.planes import insertion_sort, plane_bell, plane_mode, plane_sum
from core.compiled import compiled, contracted

N1 = 6
GL_X, GL_W = np.polynomial.legendre.leggauss(N1)
CELL = np.concatenate([[-1.0], np.cumsum(GL_W) - 1.0])  # cells that hold one point each
LEGENDRE = np.array(
    [
        [
            (2 * n + 1) / 2 * w * np.polynomial.legendre.Legendre.basis(n)(x)
            for x, w in zip(GL_X, GL_W, strict=True)
        ]
        for n in range(N1)
    ]
)
STATIONS = 17
DEPTH = 16.0  # nats below the profile's top that still count
SPLIT = 0.15
MAX_NODES = 512


@contracted
def collapse_volume(c, x, out):  # type: ignore[no-untyped-def]
    """Fix the outer parameter at x: (R, P, P, P) → out (R, P, P)."""
    rows, p = c.shape[0], c.shape[1]
    for r in range(rows):
        for j in range(p):
            for k in range(p - j):
                t = c[r, p - 1 - j - k, j, k]
                for i in range(p - 2 - j - k, -1, -1):
                    t = t * x + c[r, i, j, k]
                out[r, j, k] = t


@compiled
def station(a, b, v, y, s2, ka2, kb2, x, start, slopes, pa, pb, pv):  # type: ignore[no-untyped-def]
    """Profile at outer value x: (log L at the mode, active code); pa, pb, pv hold the plane."""
    collapse_volume(a, x, pa)
    collapse_volume(b, x, pb)
    collapse_volume(v, x, pv)
    return plane_mode(pa, pb, pv, y, s2, ka2, kb2, start, slopes)


@compiled
def volume_plan(a, b, v, y, s2, ka2, kb2, breaks, modes):  # type: ignore[no-untyped-def]
    """Panel borders over the outer parameter; `modes` (n, 3) keeps (x, mode) as warm starts.

    Returns (number of borders, number of modes, log L at the top of the profile).
    """
    rows, p = a.shape[0], a.shape[1]
    pa, pb, pv = np.empty((rows, p, p)), np.empty((rows, p, p)), np.empty((rows, p, p))
    slopes = np.empty(5)
    xs, phi = np.empty(STATIONS), np.empty(STATIONS)
    code = np.empty(STATIONS, dtype=np.int64)
    at = np.zeros((STATIONS, 2))
    width = np.empty((STATIONS, 2))
    low, high = -1.0, 1.0
    start = np.zeros(2)
    first, last = 0, STATIONS - 1
    for zoom in range(14):
        best = 0
        for i in range(STATIONS):
            xs[i] = low + (high - low) * i / (STATIONS - 1)
            phi[i], code[i] = station(a, b, v, y, s2, ka2, kb2, xs[i], start, slopes, pa, pb, pv)
            at[i, 0], at[i, 1] = start[0], start[1]
            det = slopes[2] * slopes[4] - slopes[3] * slopes[3] + 1e-9
            width[i, 0] = math.sqrt((slopes[4] + 1e-9) / det)
            width[i, 1] = math.sqrt((slopes[2] + 1e-9) / det)
            if phi[i] > phi[best]:
                best = i
        # a start from the neighbour can stall: sweep back once where that finds more
        start[0], start[1] = at[best, 0], at[best, 1]
        for i in range(best - 1, -1, -1):
            value, active = station(a, b, v, y, s2, ka2, kb2, xs[i], start, slopes, pa, pb, pv)
            if value > phi[i] + 1e-6:
                phi[i], code[i] = value, active
                at[i, 0], at[i, 1] = start[0], start[1]
            else:
                start[0], start[1] = at[i, 0], at[i, 1]
        first = last = best
        while first > 0 and phi[first - 1] > phi[best] - DEPTH:
            first -= 1
        while last < STATIONS - 1 and phi[last + 1] > phi[best] - DEPTH:
            last += 1
        if last - first >= 5 or zoom == 13:
            break
        new_low, new_high = xs[max(first - 1, 0)], xs[min(last + 1, STATIONS - 1)]
        low, high = new_low, new_high
        start[0], start[1] = at[best, 0], at[best, 1]
    top = phi[best]
    n_modes = 0
    for i in range(first, last + 1):
        modes[n_modes, 0], modes[n_modes, 1], modes[n_modes, 2] = xs[i], at[i, 0], at[i, 1]
        n_modes += 1
    n = 0
    for end in range(2):
        i = first if end == 0 else last
        j = i - 1 if end == 0 else i + 1
        inside = xs[i]
        if 0 <= j < STATIONS:
            outside = xs[j]
            start[0], start[1] = at[i, 0], at[i, 1]
            for _ in range(7):
                mid = 0.5 * (inside + outside)
                keep0, keep1 = start[0], start[1]
                value, _ = station(a, b, v, y, s2, ka2, kb2, mid, start, slopes, pa, pb, pv)
                if value > top - DEPTH:
                    inside = mid
                else:
                    outside = mid
                    start[0], start[1] = keep0, keep1
            inside = outside
        breaks[n] = inside
        n += 1
    support_low, support_high = breaks[0], breaks[1]
    length = support_high - support_low
    for i in range(first, last):
        if code[i] == code[i + 1] or n + 3 > breaks.shape[0]:
            continue
        x0, x1 = xs[i], xs[i + 1]
        c0 = code[i]
        start[0], start[1] = at[i, 0], at[i, 1]
        for _ in range(7):
            mid = 0.5 * (x0 + x1)
            _, active = station(a, b, v, y, s2, ka2, kb2, mid, start, slopes, pa, pb, pv)
            if active == c0:
                x0 = mid
            else:
                x1 = mid
        place = 0.5 * (x0 + x1)
        which = 0 if code[i] // 3 != code[i + 1] // 3 else 1
        free = i if (c0 // 3 == 1 if which == 0 else c0 % 3 == 1) else i + 1
        run = abs(place - xs[free])
        rise = abs(start[which] - at[free, which])
        delta = width[free, which] * run / max(rise, 1e-6 * width[free, which] + 1e-12)
        delta = min(delta, 0.25 * length)
        for edge in (place - 4.0 * delta, place, place + 4.0 * delta):
            if support_low + 0.01 * length < edge < support_high - 0.01 * length:
                breaks[n] = edge
                n += 1
    insertion_sort(breaks[:n])
    m = 1
    for i in range(1, n):
        if breaks[i] - breaks[m - 1] > 0.01 * length or i == n - 1:
            breaks[m] = breaks[i]
            m += 1
    return m, n_modes, top


@compiled
def log_sum(nodes, count):  # type: ignore[no-untyped-def]
    """log Σ weight · exp(log value) over the first `count` points."""
    peak = -1e300
    for i in range(count):
        peak = max(peak, nodes[i, 2])
    total = 0.0
    for i in range(count):
        total += nodes[i, 1] * math.exp(nodes[i, 2] - peak)
    return peak + math.log(total)


@compiled
def volume_glance(a, b, v, y, s2, ka2, kb2, nodes):  # type: ignore[no-untyped-def]
    """A rough log of the triple integral: Laplace in the inner two, sums over stations outside.

    Ten to thirty times cheaper than the integral and off by tenths of a nat: it tells where the
    shared parameters' nodes should stand, and where draws should fall. `nodes` (STATIONS, 4)
    receives for each station its place, the length of its cell, the rough log value and the left
    border of the cell.
    """
    rows, p = a.shape[0], a.shape[1]
    pa, pb, pv = np.empty((rows, p, p)), np.empty((rows, p, p)), np.empty((rows, p, p))
    slopes, start = np.empty(5), np.zeros(2)
    phi, area = np.empty(STATIONS), np.empty(STATIONS)
    low, high = -1.0, 1.0
    for _ in range(8):
        best = 0
        h = (high - low) / STATIONS
        for i in range(STATIONS):
            x = low + (i + 0.5) * h
            phi[i], _ = station(a, b, v, y, s2, ka2, kb2, x, start, slopes, pa, pb, pv)
            det = (slopes[2] + 1.0) * (slopes[4] + 1.0) - slopes[3] * slopes[3]
            area[i] = min(math.log(2.0 * math.pi) - 0.5 * math.log(max(det, 1e-9)), math.log(4.0))
            if phi[i] > phi[best]:
                best = i
        first = last = best
        while first > 0 and phi[first - 1] > phi[best] - DEPTH:
            first -= 1
        while last < STATIONS - 1 and phi[last + 1] > phi[best] - DEPTH:
            last += 1
        if last - first >= 3:
            break
        low, high = max(low + (first - 1.0) * h, -1.0), min(low + (last + 2.0) * h, 1.0)
    for i in range(STATIONS):
        nodes[i, 0], nodes[i, 1] = low + (i + 0.5) * h, h
        nodes[i, 2], nodes[i, 3] = phi[i] + area[i], low + i * h
    return log_sum(nodes, nodes.shape[0])


@compiled
def volume_nodes(a, b, v, y, s2, ka2, kb2, out):  # type: ignore[no-untyped-def]
    """Points of the outer integral.

    `out` (MAX_NODES, 4) receives for each point its place, its weight and the log of the inner
    double integral, and the left border of its cell (the cell's length is the weight). Returns
    their number.
    """
    rows, p = a.shape[0], a.shape[1]
    pa, pb, pv = np.empty((rows, p, p)), np.empty((rows, p, p)), np.empty((rows, p, p))
    slopes, start = np.empty(5), np.zeros(2)
    nodes = np.empty((96, 4))
    breaks, modes = np.empty(32), np.empty((STATIONS, 3))
    n, n_modes, _ = volume_plan(a, b, v, y, s2, ka2, kb2, breaks, modes)
    stack = np.empty((96, 4))
    depth = 0
    for i in range(n - 1, 0, -1):
        stack[depth, 0], stack[depth, 1], stack[depth, 2] = breaks[i - 1], breaks[i], 0.0
        depth += 1
    count = 0
    f = np.empty(N1)
    peak = -1e300
    while depth > 0:
        depth -= 1
        low, high, level = stack[depth, 0], stack[depth, 1], stack[depth, 2]
        half, mid = 0.5 * (high - low), 0.5 * (high + low)
        if half <= 0.0:
            continue
        for i in range(N1):
            x = mid + half * GL_X[i]
            near = 0
            for j in range(1, n_modes):
                if abs(modes[j, 0] - x) < abs(modes[near, 0] - x):
                    near = j
            start[0], start[1] = modes[near, 1], modes[near, 2]
            top, _ = station(a, b, v, y, s2, ka2, kb2, x, start, slopes, pa, pb, pv)
            bell, f[i] = plane_bell(pa, pb, pv, y, s2, ka2, kb2, start, slopes, top)
            if not bell:
                f[i], _ = plane_sum(pa, pb, pv, y, s2, ka2, kb2, start, slopes, top, nodes)
            peak = max(peak, f[i])
        tail = size = 0.0
        for k in range(N1):
            c = 0.0
            for i in range(N1):
                c += LEGENDRE[k, i] * math.exp(f[i] - peak)
            size = max(size, abs(c))
            if k >= N1 - 2:
                tail += abs(c)
        if (
            tail > SPLIT * size
            and tail * half > 1e-3 * SPLIT
            and level < 4.0
            and count < MAX_NODES - 6 * N1
            and depth < 60
        ):
            for side in range(2):
                stack[depth, 0] = mid if side == 0 else low
                stack[depth, 1] = high if side == 0 else mid
                stack[depth, 2] = level + 1.0
                depth += 1
            continue
        for i in range(N1):
            out[count, 0], out[count, 1] = mid + half * GL_X[i], half * GL_W[i]
            out[count, 2], out[count, 3] = f[i], mid + half * CELL[i]
            count += 1
    return count
