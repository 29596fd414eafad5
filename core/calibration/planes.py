"""Middle integral of a blade's message: two parameters free, the outer one fixed.

For each value of the middle parameter, `lines` gives the inner integral I. Over the middle
parameter I is a bell, or a plateau that falls off where the inner mode runs into a bound of the
box: the width of that fall is the bell's own width, often a thousandth of the box. `plane_sum`
therefore looks at the profile (the mode's log L along the way), finds by bisection where the set
of active bounds changes, and breaks the panels there.

Arrays of coefficients have shape (R, P, P): powers of the middle, then of the inner parameter.
"""

from __future__ import annotations

import math

import numpy as np

from core.calibration.lines import GH_W, GH_X, OFF_BELL, line_mode, line_sum
from core.compiled import compiled, contracted

POINTS = 6
GL_X, GL_W = np.polynomial.legendre.leggauss(POINTS)
CELL = np.concatenate([[-1.0], np.cumsum(GL_W) - 1.0])  # cells that hold one point each
N_TRAPEZOID = 9


@contracted
def collapse_plane(c, x, out):  # type: ignore[no-untyped-def]
    """Fix the middle parameter at x: (R, P, P) → out (R, P)."""
    rows, p = c.shape[0], c.shape[1]
    for r in range(rows):
        for k in range(p):
            t = c[r, p - 1 - k, k]
            for j in range(p - 2 - k, -1, -1):
                t = t * x + c[r, j, k]
            out[r, k] = t


@contracted
def plane_slopes(a, b, v, y, s2, ka2, kb2, x, g, out):  # type: ignore[no-untyped-def]
    """log L at (x, g); out = slopes and Gauss–Newton curvatures (sx, sg, hxx, hxg, hgg)."""
    rows, p = a.shape[0], a.shape[1]
    value = sx = sg = hxx = hxg = hgg = 0.0
    for r in range(rows):
        va = vax = vag = vb = vbx = vbg = lv = 0.0
        for j in range(p - 1, -1, -1):
            qa = qb = qv = qag = qbg = 0.0
            for k in range(p - 1 - j, -1, -1):
                qag = qag * g + qa
                qbg = qbg * g + qb
                qa = qa * g + a[r, j, k]
                qb = qb * g + b[r, j, k]
                qv = qv * g + v[r, j, k]
            vax = vax * x + va
            vbx = vbx * x + vb
            va = va * x + qa
            vb = vb * x + qb
            vag = vag * x + qag
            vbg = vbg * x + qbg
            lv = lv * x + qv
        e = math.exp(vb)
        var = s2[r] + e * e * math.exp(min(lv, 50.0)) * (ka2[r] + va * va * kb2[r])
        iv = 1.0 / var
        d = va * e - y[r]
        mx = (vax + va * vbx) * e
        mg = (vag + va * vbg) * e
        value -= 0.5 * (d * d * iv + math.log(var))
        sx -= d * mx * iv
        sg -= d * mg * iv
        hxx += mx * mx * iv
        hxg += mx * mg * iv
        hgg += mg * mg * iv
    out[0], out[1], out[2], out[3], out[4] = sx, sg, hxx, hxg, hgg
    return value


@compiled
def plane_mode(a, b, v, y, s2, ka2, kb2, start, out):  # type: ignore[no-untyped-def]
    """Mode in the box from `start` (2,), which is updated: (log L, active code).

    The code is 3 (side_x + 1) + (side_g + 1): 4 where no bound is active. `out` (5,) holds the
    slopes and curvatures at the mode.
    """
    trial = np.empty(5)
    x, g = start[0], start[1]
    value = plane_slopes(a, b, v, y, s2, ka2, kb2, x, g, out)
    for _ in range(30):
        sx, sg = out[0], out[1]
        ridge = 1e-9 * (out[2] + out[4]) + 1e-12
        hxx, hxg, hgg = out[2] + ridge, out[3], out[4] + ridge
        free_x = not ((x >= 1.0 and sx > 0.0) or (x <= -1.0 and sx < 0.0))
        free_g = not ((g >= 1.0 and sg > 0.0) or (g <= -1.0 and sg < 0.0))
        dx = dg = 0.0
        if free_x and free_g:
            det = hxx * hgg - hxg * hxg
            dx, dg = (hgg * sx - hxg * sg) / det, (hxx * sg - hxg * sx) / det
            out_x = (x >= 1.0 and dx > 0.0) or (x <= -1.0 and dx < 0.0)
            out_g = (g >= 1.0 and dg > 0.0) or (g <= -1.0 and dg < 0.0)
            if out_x:
                dx, dg = 0.0, sg / hgg
            elif out_g:
                dx, dg = sx / hxx, 0.0
        elif free_x:
            dx = sx / hxx
        elif free_g:
            dg = sg / hgg
        longest = max(abs(dx), abs(dg))
        if longest > 0.5:
            dx, dg = dx * 0.5 / longest, dg * 0.5 / longest
        gain = sx * dx + sg * dg
        if gain < 1e-4:
            break
        t = 1.0
        moved = False
        for _ in range(20):
            nx = min(max(x + t * dx, -1.0), 1.0)
            ng = min(max(g + t * dg, -1.0), 1.0)
            nv = plane_slopes(a, b, v, y, s2, ka2, kb2, nx, ng, trial)
            if nv > value - 1e-3:
                moved = True
                break
            t *= 0.4
        if not moved:
            break
        small = gain < 1e-3
        x, g, value = nx, ng, nv
        for i in range(5):
            out[i] = trial[i]
        if small:
            break
    start[0], start[1] = x, g
    side_x = 1 if (x >= 1.0 and out[0] > 0.0) else (-1 if (x <= -1.0 and out[0] < 0.0) else 0)
    side_g = 1 if (g >= 1.0 and out[1] > 0.0) else (-1 if (g <= -1.0 and out[1] < 0.0) else 0)
    return value, 3 * (side_x + 1) + side_g + 1


@compiled
def insertion_sort(x):  # type: ignore[no-untyped-def]
    """Sort a dozen values in place; numpy's sort costs seconds to compile."""
    for i in range(1, len(x)):
        value, j = x[i], i
        while j > 0 and x[j - 1] > value:
            x[j] = x[j - 1]
            j -= 1
        x[j] = value


@compiled
def reach(a, b, v, y, s2, ka2, kb2, x, g, top, w, direction, la, lb, lv, iv):  # type: ignore[no-untyped-def]
    """Half width towards `direction` at which the profile has dropped by 8.5 … 17.

    Returns (width, side of the inner mode there, inner mode there, cut by the box).
    """
    room = 1.0 - direction * x
    near, far = 0.0, -1.0
    side, mode = 0, g
    w = min(w, room)
    for _ in range(30):
        if w <= 0.0:
            return 0.0, side, mode, True
        at = x + direction * w
        collapse_plane(a, at, la)
        collapse_plane(b, at, lb)
        value, mode, _, _, side = line_mode(la, lb, lv, y, s2, ka2, kb2, mode, iv)
        drop = top - value
        if drop > 17.0:
            far = w
            guess = w * math.sqrt(11.5 / drop)
            w = guess if near == 0.0 and guess > 0.3 * w else 0.5 * (near + far)
        elif drop < 8.5:
            if w >= room:
                return room, side, mode, True
            near = w
            w = min(1.6 * w, room) if far < 0.0 else 0.5 * (near + far)
        else:
            return w, side, mode, w >= room
        if far > 0.0 and far - near < 1e-7:
            break
    return w, side, mode, w >= room


@compiled
def kink(a, b, v, y, s2, ka2, kb2, inside, outside, g, la, lb, lv, iv):  # type: ignore[no-untyped-def]
    """Where the inner mode meets its bound between `inside` (free) and `outside` (held).

    Returns the place and the width of the transition there.
    """
    g0, x0 = g, inside
    sd, mode = 1.0, g
    start, at0 = inside, g
    for _ in range(6):
        mid = 0.5 * (inside + outside)
        collapse_plane(a, mid, la)
        collapse_plane(b, mid, lb)
        _, found, _, bend, side = line_mode(la, lb, lv, y, s2, ka2, kb2, mode, iv)
        if side == 0:
            x0, g0 = inside, mode
            inside, mode = mid, found
            sd = 1.0 / math.sqrt(bend + 1e-12)
        else:
            outside = mid
    run = abs(inside - start)
    rise = abs(mode - at0)
    if run < 1e-12 or rise < 1e-12:
        run, rise = abs(inside - x0) + 1e-12, abs(mode - g0) + 1e-12
    return 0.5 * (inside + outside), sd * run / rise


@compiled
def plane_breaks(a, b, v, y, s2, ka2, kb2, start, slopes, top, breaks, la, lb, lv, iv):  # type: ignore[no-untyped-def]
    """Fill `breaks` with the panel borders around the mode: (count, bell inside the box)."""
    x, g = start[0], start[1]
    hxx, hxg, hgg = slopes[2], slopes[3], slopes[4]
    held = g >= 1.0 or g <= -1.0
    bend = hxx if held else hxx - hxg * hxg / (hgg + 1e-12)
    w0 = 4.8 / math.sqrt(max(bend, 1e-3))
    centre_side = 0
    if g >= 1.0 and slopes[1] > 0.0:
        centre_side = 1
    elif g <= -1.0 and slopes[1] < 0.0:
        centre_side = -1
    left, side_l, mode_l, cut_l = reach(
        a, b, v, y, s2, ka2, kb2, x, g, top, w0, -1.0, la, lb, lv, iv
    )
    right, side_r, mode_r, cut_r = reach(
        a, b, v, y, s2, ka2, kb2, x, g, top, w0, 1.0, la, lb, lv, iv
    )
    n = 0
    breaks[n] = x - left
    n += 1
    smooth = True
    for which in range(2):
        direction = -1.0 if which == 0 else 1.0
        w = left if which == 0 else right
        side = side_l if which == 0 else side_r
        mode = mode_l if which == 0 else mode_r
        if side == centre_side or w < 1e-9:
            continue
        smooth = False
        end = x + direction * w
        if centre_side == 0:
            place, delta = kink(a, b, v, y, s2, ka2, kb2, x, end, g, la, lb, lv, iv)
            inner, outer = place - 4.0 * direction * delta, place + 4.0 * direction * delta
        elif side == 0:
            place, delta = kink(a, b, v, y, s2, ka2, kb2, end, x, mode, la, lb, lv, iv)
            inner, outer = place - 4.0 * direction * delta, place + 4.0 * direction * delta
        else:
            inner, outer = x + direction * w / 3.0, x + direction * w * 2.0 / 3.0
        for at in (inner, outer):
            if (at - x) * direction > 0.02 * w and (end - at) * direction > 0.02 * w:
                breaks[n] = at
                n += 1
    if not (smooth and not cut_l and not cut_r) and left > 1e-9 and right > 1e-9:
        breaks[n] = x  # the two flanks may differ in steepness by an order
        n += 1
    breaks[n] = x + right
    n += 1
    insertion_sort(breaks[:n])
    return n, smooth and not cut_l and not cut_r


@contracted
def plane_value(a, b, v, y, s2, ka2, kb2, x, g):  # type: ignore[no-untyped-def]
    """log L at (x, g), with the variance there."""
    rows, p = a.shape[0], a.shape[1]
    value = 0.0
    for r in range(rows):
        va = vb = lv = 0.0
        for j in range(p - 1, -1, -1):
            qa = qb = qv = 0.0
            for k in range(p - 1 - j, -1, -1):
                qa = qa * g + a[r, j, k]
                qb = qb * g + b[r, j, k]
                qv = qv * g + v[r, j, k]
            va = va * x + qa
            vb = vb * x + qb
            lv = lv * x + qv
        e = math.exp(vb)
        var = s2[r] + e * e * math.exp(min(lv, 50.0)) * (ka2[r] + va * va * kb2[r])
        d = va * e - y[r]
        value -= 0.5 * (d * d / var + math.log(var))
    return value


@compiled
def plane_bell(a, b, v, y, s2, ka2, kb2, start, slopes, top):  # type: ignore[no-untyped-def]
    """log ∫∫ L by 5 × 5 Gauss–Hermite points where L is close to a bell inside the box.

    Returns (ok, value). The points lie along the bell's own axes: x, and g given x.
    """
    hxx, hxg, hgg = slopes[2], slopes[3], slopes[4]
    x0, g0 = start[0], start[1]
    schur = hxx - hxg * hxg / (hgg + 1e-12)
    if schur <= 0.0 or hgg <= 0.0:
        return False, 0.0
    sd_x, sd_g = 1.0 / math.sqrt(schur), 1.0 / math.sqrt(hgg)
    slope = -hxg / hgg
    marginal = math.sqrt(sd_g * sd_g + slope * slope * sd_x * sd_x)
    if 1.0 - abs(x0) < 4.5 * sd_x or 1.0 - abs(g0) < 4.5 * marginal:
        return False, 0.0
    total = 0.0
    for order in range(5):
        i = (0, 4, 2, 1, 3)[order]
        x = x0 + sd_x * GH_X[i]
        for j in (0, 4, 2, 1, 3):
            g = g0 + slope * (x - x0) + sd_g * GH_X[j]
            rise = plane_value(a, b, v, y, s2, ka2, kb2, x, g) - top
            rise += 0.5 * (GH_X[i] ** 2 + GH_X[j] ** 2)
            if (i == 2) != (j == 2) and abs(rise) > OFF_BELL:
                return False, 0.0
            if abs(rise) > 3.0 * OFF_BELL:
                return False, 0.0
            total += GH_W[i] * GH_W[j] * math.exp(rise)
    return True, top + math.log(2.0 * math.pi * sd_x * sd_g * total)


@compiled
def plane_sum(a, b, v, y, s2, ka2, kb2, start, slopes, top, nodes):  # type: ignore[no-untyped-def]
    """log ∫∫ L over the box of the two inner parameters, and the number of points used.

    `start`, `slopes`, `top` as plane_mode left them. `nodes` (96, 4) receives for each point
    of the middle parameter its place, its weight, the log of the inner integral and the left border
    of its cell, whose length is the weight.
    """
    rows, p = a.shape[0], a.shape[1]
    la, lb, lv, iv = np.empty((rows, p)), np.empty((rows, p)), np.empty((rows, p)), np.empty(rows)
    breaks = np.empty(12)
    collapse_plane(v, start[0], lv)  # varies little over a plane: taken at its mode
    n, bell = plane_breaks(a, b, v, y, s2, ka2, kb2, start, slopes, top, breaks, la, lb, lv, iv)
    count = 0
    if bell:
        h = (breaks[n - 1] - breaks[0]) / (N_TRAPEZOID - 1)
        for i in range(N_TRAPEZOID):
            nodes[count, 0], nodes[count, 1] = breaks[0] + i * h, h
            nodes[count, 3] = breaks[0] + (i - 0.5) * h
            count += 1
    else:
        for q in range(n - 1):
            half, mid = 0.5 * (breaks[q + 1] - breaks[q]), 0.5 * (breaks[q + 1] + breaks[q])
            if half <= 0.0:
                continue
            for i in range(POINTS):
                nodes[count, 0], nodes[count, 1] = mid + half * GL_X[i], half * GL_W[i]
                nodes[count, 3] = mid + half * CELL[i]
                count += 1
    g = start[1]
    peak = -1e300
    for i in range(count):
        x = nodes[i, 0]
        collapse_plane(a, x, la)
        collapse_plane(b, x, lb)
        value, g, slope, bend, _ = line_mode(la, lb, lv, y, s2, ka2, kb2, g, iv)
        nodes[i, 2], _, _ = line_sum(la, lb, y, iv, g, value, slope, bend)
        peak = max(peak, nodes[i, 2])
    total = 0.0
    for i in range(count):
        total += nodes[i, 1] * math.exp(nodes[i, 2] - peak)
    return peak + math.log(total), count
