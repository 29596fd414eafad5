"""Weighted draws of a blade's local parameters at one value of the shared ones.

The filter's move: particles are not pushed around but drawn anew from the tube that the message
was integrated over, with exact weights. A particle's outer parameter falls into a station's cell
with the cell's rough probability and is uniform inside; the two inner ones come from the bell at
that place, or cell by cell from the nested points. With q the density of that draw the weight is
L / q. The average of the weights estimates the message, independently of the quadrature: tests
hold the two against each other.

`SHARE` particles have one outer value: their inner parameters are drawn from one plane.
"""

from __future__ import annotations

import math

import numpy as np

from core.calibration.kernel import collapse_shared
from core.calibration.lines import half_width, line_mode, line_value
from core.calibration.planes import (
    collapse_plane,
    plane_bell,
    plane_mode,
    plane_sum,
    plane_value,
)
from core.calibration.volumes import STATIONS, log_sum, station, volume_glance
from core.compiled import compiled

SHARE = 12
SLICES = 12


@compiled
def pick(nodes, count, u):  # type: ignore[no-untyped-def]
    """Index of the point whose share of Σ weight · exp(log value) holds the quantile u."""
    peak = -1e300
    for i in range(count):
        peak = max(peak, nodes[i, 2])
    total = 0.0
    for i in range(count):
        total += nodes[i, 1] * math.exp(nodes[i, 2] - peak)
    left = u * total
    for i in range(count):
        left -= nodes[i, 1] * math.exp(nodes[i, 2] - peak)
        if left <= 0.0:
            return i
    return count - 1


@compiled
def draw_line(la, lb, lv, y, s2, ka2, kb2, g, iv, u1, u2):  # type: ignore[no-untyped-def]
    """Inner parameter on a line: (value, log L there − log q)."""
    value, g, slope, bend, _ = line_mode(la, lb, lv, y, s2, ka2, kb2, g, iv)
    top = line_value(la, lb, y, iv, g)
    left, _ = half_width(la, lb, y, iv, g, top, slope, bend, -1.0)
    right, _ = half_width(la, lb, y, iv, g, top, slope, bend, 1.0)
    at, log_q = draw_chords(la, lb, y, iv, g - left, g + right, u1, u2)
    return at, value + line_value(la, lb, y, iv, at) - top - log_q


@compiled
def draw_chords(la, lb, y, iv, low, high, u1, u2):  # type: ignore[no-untyped-def]
    """A draw from the chords of log L between `SLICES` + 1 even points, and its log density."""
    h = (high - low) / SLICES
    edge, mass = np.empty(SLICES + 1), np.empty(SLICES)
    peak = -1e300
    for i in range(SLICES + 1):
        edge[i] = line_value(la, lb, y, iv, low + i * h)
        peak = max(peak, edge[i])
    total, before = 0.0, math.exp(edge[0] - peak)  # the best edge is 1: nothing overflows
    for i in range(SLICES):
        after, d = math.exp(edge[i + 1] - peak), edge[i + 1] - edge[i]
        mass[i] = h * ((after - before) / d if abs(d) > 1e-6 else before)
        total += mass[i]
        before = after
    left, cell = u1 * total, SLICES - 1
    for i in range(SLICES):
        left -= mass[i]
        if left <= 0.0:
            cell = i
            break
    d = edge[cell + 1] - edge[cell]
    if abs(d) <= 1e-6:
        t = u2
    elif d > 0.0:  # from the high end, so that exp() stays below 1
        t = 1.0 + math.log1p(u2 * math.expm1(-d)) / d
    else:
        t = math.log1p(u2 * math.expm1(d)) / d
    return low + (cell + t) * h, edge[cell] + d * t - peak - math.log(total)


@compiled
def draw_plane(a, b, v, y, s2, ka2, kb2, start, slopes, top, u, z, out, log_w):  # type: ignore[no-untyped-def]
    """Draws of the two inner parameters into out[:, 1:3]; log_w += log(L / q)."""
    rows, p, many = a.shape[0], a.shape[1], out.shape[0]
    bell, _ = plane_bell(a, b, v, y, s2, ka2, kb2, start, slopes, top)
    if bell:
        hxx, hxg, hgg = slopes[2], slopes[3], slopes[4]
        wide = 1.1  # heavier than the bell, so that weights stay bounded
        sd_x = wide / math.sqrt(hxx - hxg * hxg / hgg)
        sd_g = wide / math.sqrt(hgg)
        for i in range(many):
            x = start[0] + sd_x * z[i, 0]
            g = start[1] - hxg / hgg * (x - start[0]) + sd_g * z[i, 1]
            if abs(x) > 1.0 or abs(g) > 1.0:  # no weight, and a place that the model knows
                out[i, 1], out[i, 2] = start[0], start[1]
                log_w[i] = -math.inf
                continue
            out[i, 1], out[i, 2] = x, g
            q = -0.5 * (z[i, 0] ** 2 + z[i, 1] ** 2) - math.log(2.0 * math.pi * sd_x * sd_g)
            log_w[i] += plane_value(a, b, v, y, s2, ka2, kb2, x, g) - q
        return
    la, lb, lv, iv = np.empty((rows, p)), np.empty((rows, p)), np.empty((rows, p)), np.empty(rows)
    nodes = np.empty((96, 4))
    total, count = plane_sum(a, b, v, y, s2, ka2, kb2, start, slopes, top, nodes)
    for i in range(many):
        j = pick(nodes, count, u[i, 2])
        x = nodes[j, 3] + u[i, 3] * nodes[j, 1]
        if abs(x) > 1.0:
            log_w[i] = -math.inf
            continue
        collapse_plane(a, x, la)
        collapse_plane(b, x, lb)
        collapse_plane(v, x, lv)
        g, ratio = draw_line(la, lb, lv, y, s2, ka2, kb2, start[1], iv, u[i, 4], u[i, 5])
        out[i, 1], out[i, 2] = x, g
        log_w[i] += ratio - (nodes[j, 2] - total)


@compiled
def draw(a, b, v, y, s2, ka2, kb2, dim, u, z, out, log_w):  # type: ignore[no-untyped-def]
    """Draws for collapsed rows (R, P, P, P): out (m, 3) scaled locals, log_w (m,) = log L / q.

    u (m, 6) uniforms (the first column stratified), z (m, 2) normals.
    """
    rows, p, m = a.shape[0], a.shape[1], out.shape[0]
    slopes, start = np.empty(5), np.zeros(2)
    out[:] = 0.0
    if dim == 1:
        iv = np.empty(rows)
        la, lb, lv = a[:, 0, 0].copy(), b[:, 0, 0].copy(), v[:, 0, 0].copy()
        for i in range(m):
            out[i, 2], log_w[i] = draw_line(la, lb, lv, y, s2, ka2, kb2, 0.0, iv, u[i, 0], u[i, 1])
        return
    log_w[:] = 0.0
    if dim == 2:
        pa, pb, pv = a[:, 0].copy(), b[:, 0].copy(), v[:, 0].copy()
        top, _ = plane_mode(pa, pb, pv, y, s2, ka2, kb2, start, slopes)
        draw_plane(pa, pb, pv, y, s2, ka2, kb2, start, slopes, top, u, z, out, log_w)
        return
    qa, qb, qv = np.empty((rows, p, p)), np.empty((rows, p, p)), np.empty((rows, p, p))
    nodes = np.empty((STATIONS, 4))
    count = nodes.shape[0]
    total = volume_glance(a, b, v, y, s2, ka2, kb2, nodes)
    floor = total - 9.0  # a thin floor under the rough values: no place is proposed never
    for j in range(count):
        nodes[j, 2] = max(nodes[j, 2], floor)
    total = log_sum(nodes, count)
    for first in range(0, m, SHARE):
        own = slice(first, min(first + SHARE, m))
        j = pick(nodes, count, u[first, 0])
        x = nodes[j, 3] + u[first, 1] * nodes[j, 1]
        start[0] = start[1] = 0.0
        top, _ = station(a, b, v, y, s2, ka2, kb2, x, start, slopes, qa, qb, qv)
        out[own, 0] = x
        log_w[own] = total - nodes[j, 2]
        draw_plane(
            qa, qb, qv, y, s2, ka2, kb2, start, slopes, top, u[own], z[own], out[own], log_w[own]
        )


@compiled
def draws(a, b, v, exponents, factors, y, s2, ka2, kb2, dim, u, z, out, log_w):  # type: ignore[no-untyped-def]
    """Draws at K values of the shared parameters: out (K, m, 3), log_w (K, m); u, z likewise."""
    rows, p = a.shape[0], 0
    for q in range(exponents.shape[0]):
        p = max(p, exponents[q, 0] + exponents[q, 1] + exponents[q, 2])
    p += 1
    ca, cb, cv = np.empty((rows, p, p, p)), np.empty((rows, p, p, p)), np.empty((rows, p, p, p))
    for k in range(factors.shape[0]):
        collapse_shared(a, exponents, factors[k], ca)
        collapse_shared(b, exponents, factors[k], cb)
        collapse_shared(v, exponents, factors[k], cv)
        draw(ca, cb, cv, y[k], s2[k], ka2, kb2, dim, u[k], z[k], out[k], log_w[k])
