"""Innermost integral of a blade's message: one parameter free, all others fixed.

Along a line the R rows of a blade are functions of one scaled parameter g in [-1, 1],

    y_r(g) = a_r(g) exp(b_r(g)),      log L(g) = −½ Σ_r (y_r − y_obs,r)² / var_r − ½ Σ_r log var_r,

with seven or so coefficients a row. ``line_mode`` finds the mode by Gauss–Newton steps inside
the box, ``line_sum`` integrates exp(log L). A bell that lies inside the box is summed by the
trapezoidal rule, which converges geometrically there (Trefethen & Weideman, SIAM Review 56, 2014);
one that the box cuts, by Gauss–Legendre points up to the cut, which is an exact limit of the
uniform prior. A bell that is close to Gaussian, checked at the outermost points, needs five
Gauss–Hermite points only.

The variance var_r = sigma² + s_r² is frozen along a line at its mode: the surrogate's part
varies over the whole box, a line's bell over a small part of it.

The functions are compiled; arrays of coefficients have shape (R, P), P = degree + 1.
"""

from __future__ import annotations

import math

import numpy as np

from core.compiled import compiled, contracted

FLANK = 7
GL_X, GL_W = np.polynomial.legendre.leggauss(FLANK)
TRAPEZOID = 9
GH_X, GH_W = np.polynomial.hermite_e.hermegauss(5)
GH_W = GH_W / math.sqrt(2.0 * math.pi)
BELL = 0.5 * GH_X[4] ** 2  # the drop of an exact bell at the outermost point
OFF_BELL = 2.0  # how far from it the drop may be: five points then err by less than 1e-3


@contracted
def line_value(a, b, y, iv, g):  # type: ignore[no-untyped-def]
    """−½ Σ (y_r(g) − y_obs,r)² iv_r with iv = 1/var frozen."""
    rows, p = a.shape
    total = 0.0
    for r in range(rows):
        va, vb = a[r, p - 1], b[r, p - 1]
        for k in range(p - 2, -1, -1):
            va = va * g + a[r, k]
            vb = vb * g + b[r, k]
        d = va * math.exp(vb) - y[r]
        total += d * d * iv[r]
    return -0.5 * total


@contracted
def line_slopes(a, b, v, y, s2, ka2, kb2, g, iv):  # type: ignore[no-untyped-def]
    """log L, its slope and its Gauss–Newton curvature at g; fills iv with 1/var."""
    rows, p = a.shape
    value = slope = bend = 0.0
    for r in range(rows):
        va, vb, lv = a[r, p - 1], b[r, p - 1], v[r, p - 1]
        da = db = 0.0
        for k in range(p - 2, -1, -1):
            da = da * g + va
            db = db * g + vb
            va = va * g + a[r, k]
            vb = vb * g + b[r, k]
            lv = lv * g + v[r, k]
        e = math.exp(vb)
        var = s2[r] + e * e * math.exp(min(lv, 50.0)) * (ka2[r] + va * va * kb2[r])
        iv[r] = 1.0 / var
        d = va * e - y[r]
        m1 = (da + va * db) * e
        value -= 0.5 * (d * d * iv[r] + math.log(var))
        slope -= d * m1 * iv[r]
        bend += m1 * m1 * iv[r]
    return value, slope, bend


@compiled
def line_mode(a, b, v, y, s2, ka2, kb2, g, iv):  # type: ignore[no-untyped-def]
    """Mode inside [-1, 1] from start g: (log L, mode, slope, curvature, side).

    side is −1 or 1 where the mode sits at a bound with the slope pointing out of the box.
    """
    value, slope, bend = line_slopes(a, b, v, y, s2, ka2, kb2, g, iv)
    for _ in range(40):
        step = slope / (bend + 1e-12)
        step = min(max(step, -0.5), 0.5)
        new = min(max(g + step, -1.0), 1.0)
        moved = new - g
        if moved * moved * bend < 1e-4:  # a hundredth of the bell's width: it only places points
            break
        nv, ns, nb = line_slopes(a, b, v, y, s2, ka2, kb2, new, iv)
        halved = 0
        while nv < value - 0.01 and halved < 12:
            moved *= 0.4
            new = g + moved
            nv, ns, nb = line_slopes(a, b, v, y, s2, ka2, kb2, new, iv)
            halved += 1
        g, value, slope, bend = new, nv, ns, nb
    side = 0
    if g >= 1.0 and slope > 0.0:
        side = 1
    elif g <= -1.0 and slope < 0.0:
        side = -1
    return value, g, slope, bend, side


@compiled
def half_width(a, b, y, iv, g, top, slope, bend, direction):  # type: ignore[no-untyped-def]
    """How far the bell reaches from g towards `direction`, and whether the box cuts it."""
    room = 1.0 - direction * g
    out = max(-direction * slope, 0.0)  # a mode at the bound falls off linearly inwards
    w = 23.0 / (out + math.sqrt(out * out + 23.0 * (bend + 1e-12)))
    for _ in range(40):
        if w >= room:
            if top - line_value(a, b, y, iv, g + direction * room) > 40.0:
                w = 0.4 * room
                room = min(room, 2.0 * w)
                continue
            return room, True
        drop = top - line_value(a, b, y, iv, g + direction * w)
        if drop < 8.5:
            w *= 1.5
        elif drop > 16.0:
            w *= max(math.sqrt(11.5 / drop), 0.25)
        else:
            return w, False
    return min(w, room), w >= room


@compiled
def line_sum(a, b, y, iv, g, value, slope, bend):  # type: ignore[no-untyped-def]
    """log ∫ L dg over [-1, 1] from what line_mode found, and the range used (low, high)."""
    top = line_value(a, b, y, iv, g)
    sd = 1.0 / math.sqrt(bend + 1e-12)
    if 1.0 - abs(g) > 4.5 * sd:
        first = line_value(a, b, y, iv, g + sd * GH_X[0]) - top + BELL
        last = line_value(a, b, y, iv, g + sd * GH_X[4]) - top + BELL
        if abs(first) < OFF_BELL and abs(last) < OFF_BELL:
            total = GH_W[0] * math.exp(first) + GH_W[4] * math.exp(last) + GH_W[2]
            for i in (1, 3):
                at = line_value(a, b, y, iv, g + sd * GH_X[i]) - top + 0.5 * GH_X[i] ** 2
                total += GH_W[i] * math.exp(at)
            return (
                value + math.log(total * sd * math.sqrt(2.0 * math.pi)),
                max(g - 5.0 * sd, -1.0),
                min(g + 5.0 * sd, 1.0),
            )
    left, cut_left = half_width(a, b, y, iv, g, top, slope, bend, -1.0)
    right, cut_right = half_width(a, b, y, iv, g, top, slope, bend, 1.0)
    low, high = g - left, g + right
    total, peak = 0.0, 0.0  # Σ weight exp(value − top − peak): a stalled mode cannot overflow
    if cut_left or cut_right:
        for side in range(2):  # the two flanks may differ in steepness by an order
            half = 0.5 * (left if side == 0 else right)
            mid = g - half if side == 0 else g + half
            for i in range(FLANK):
                rise = line_value(a, b, y, iv, mid + half * GL_X[i]) - top
                if rise > peak:
                    total *= math.exp(peak - rise)
                    peak = rise
                total += half * GL_W[i] * math.exp(rise - peak)
    else:
        h = (high - low) / (TRAPEZOID - 1)
        for i in range(TRAPEZOID):
            rise = line_value(a, b, y, iv, low + i * h) - top
            if rise > peak:
                total *= math.exp(peak - rise)
                peak = rise
            total += h * math.exp(rise - peak)
    if not total > 0.0:  # narrower than every point: the bell itself
        total = min(sd * math.sqrt(2.0 * math.pi), 2.0)
    return value + peak + math.log(total), low, high
