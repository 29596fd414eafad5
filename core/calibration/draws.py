"""Weighted draws of a blade's local parameters at 16 values of the shared ones at once.

The filter's move: particles are not pushed around but drawn anew from the tube that the message
was integrated over, with exact weights. A particle's outer parameter is drawn from the `chords` of
the log of a rough integral over the plane there, the middle one from those of a rough inner
integral along the plane (both: `rough`), the inner one from the chords of log L along its line.
With q the density of that draw the weight is L / q. The average of the weights estimates the
message, independently of the quadrature: tests hold the two against each other.

`SHARE` particles have one outer value: their inner parameters are drawn from one plane.

Each coordinate is the quantile of one uniform number (Rosenblatt's transformation), and these are
not independent but even (`even_points`): with 4,000 independent particles, a few hundred outer
values among them, a published 95 % interval of the outer parameter would hold 94.7 % on average.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from core.calibration import lines, modes
from core.calibration.chords import along, chords, pick, uneven_chords
from core.calibration.lines import LEFT, RIGHT, TV, G, T, X, line_ranges, line_values
from core.calibration.modes import plane_modes
from core.calibration.planes import FIELDS as PLANE_FIELDS
from core.calibration.planes import STATIONS as PLANE_STATIONS
from core.calibration.planes import profile, scan
from core.calibration.rough import FLOOR, MOST, PLACES, bent, refined
from core.calibration.vector import LANES
from core.calibration.volumes import near, volume_glances
from core.compiled import compiled

SHARE = 10
SLICES = 8
GOLDEN, PLASTIC = 0.6180339887498949, (0.7548776662466927, 0.5698402909980532)


def even_points(
    rng: np.random.Generator, nodes: int, per_node: int, share: int, dim: int
) -> NDArray[np.float64]:
    """Numbers (nodes, per_node, 3) in [0, 1), each uniform, together even; the last `dim` count.

    The first of them is constant over `share` draws and evenly spaced at a node, from a start that
    goes round by the golden ratio between nodes; the others follow the two-dimensional sequence of
    the plastic number (Roberts 2018; a Kronecker sequence: Niederreiter 1992, ch. 3), over all
    nodes. All are moved by a random shift (Cranley & Patterson 1976): no average is biased.

    >>> u = even_points(np.random.default_rng(0), 64, 12, 4, 3)
    >>> np.round(np.diff(u[5, ::4, 0]), 9).tolist()
    [0.333333333, 0.333333333]
    """
    u, shift = np.zeros((nodes, per_node, 3)), rng.random(3)
    groups = per_node // share
    starts = (shift[0] + np.arange(nodes) * GOLDEN) % 1.0
    u[:, :, 3 - dim] = np.repeat((starts[:, None] + np.arange(groups)) / groups, share, axis=1)
    count = np.arange(nodes * per_node).reshape(nodes, per_node)
    for k in range(1, dim):
        u[:, :, 3 - dim + k] = (shift[k] + count * PLASTIC[k - 1]) % 1.0
    return u


@compiled
def draw_lines(la, lb, lv, y, s2, ka2, kb2, w, edge, mass, u, out, log_w, n):  # type: ignore[no-untyped-def]
    """Draw n of the inner parameter on each line: out[i, n, 2], and log_w[i, n] += log L / q."""
    line_ranges(la, lb, lv, y, s2, ka2, kb2, w, edge)
    for q in range(SLICES + 1):
        for i in range(LANES):
            w[T + i] = w[G + i] - w[LEFT + i] + (w[LEFT + i] + w[RIGHT + i]) * q / SLICES
        line_values(la, lb, lv, y, s2, ka2, kb2, w)
        for i in range(LANES):
            edge[q, i] = w[TV + i]
    for i in range(LANES):
        wide = w[LEFT + i] + w[RIGHT + i]
        total = chords(edge, SLICES, i, wide / SLICES, mass)
        cell, inside = pick(mass, SLICES, i, u[i, n, 2])
        part, value = along(edge, cell, i, inside)
        w[T + i] = min(max(w[G + i] - w[LEFT + i] + wide * (cell + part) / SLICES, -1.0), 1.0)
        log_w[i, n] -= value - total
    line_values(la, lb, lv, y, s2, ka2, kb2, w)
    for i in range(LANES):
        out[i, n, 2] = w[T + i]
        log_w[i, n] += w[TV + i]


@compiled
def draw_planes(  # type: ignore[no-untyped-def]
    pa, pb, pv, y, s2, ka2, kb2, wp, w, la, lb, lv, seen, plan, work, u, out, log_w, first, last
):
    """Draws first … last of the two inner parameters on the planes whose modes wp holds."""
    edge, share, mass = work[0], work[1], work[2]
    at, rough, mode, bound = work[3], work[4], work[5], work[6]
    count, total = np.empty(LANES, np.int64), np.empty(LANES)
    scan(pa, pb, pv, y, s2, ka2, kb2, wp, w, la, lb, lv, seen, plan)
    bent(pa, pb, pv, y, s2, ka2, kb2, w, la, lb, lv, seen, at, rough, mode, bound, count)
    for i in range(LANES):
        peak = -math.inf
        for s in range(count[i]):
            peak = max(peak, rough[s, i])
        for s in range(count[i]):
            rough[s, i] = max(rough[s, i], peak - FLOOR - 7.0)
        total[i] = uneven_chords(at, rough, count[i] - 1, i, mass)
    for n in range(first, last):
        for i in range(LANES):
            cell, inside = pick(mass, count[i] - 1, i, u[i, n, 1])
            part, value = along(rough, cell, i, inside)
            x = at[cell, i] + part * (at[cell + 1, i] - at[cell, i])
            w[X + i] = min(max(x, -1.0), 1.0)
            w[G + i] = mode[cell, i] + part * (mode[cell + 1, i] - mode[cell, i])
            out[i, n, 1] = w[X + i]
            log_w[i, n] -= value - total[i]
        profile(pa, pb, pv, y, s2, ka2, kb2, w, la, lb, lv)
        draw_lines(la, lb, lv, y, s2, ka2, kb2, w, edge, share, u, out, log_w, n)


@compiled
def draw_volumes(a, b, v, y, s2, ka2, kb2, seen, plan, led, u, out, log_w):  # type: ignore[no-untyped-def]
    """Draws of three local parameters for a block of volumes: out (LANES, m, 3)."""
    rows, m = len(ka2), out.shape[1]
    wp, w = np.empty(modes.SCRATCH), np.empty(lines.SCRATCH)
    la, lb, lv = np.empty(6 * rows * LANES), np.empty(6 * rows * LANES), np.empty(6 * rows * LANES)
    pa, pb = np.empty(36 * rows * LANES), np.empty(36 * rows * LANES)
    pv = np.empty(36 * rows * LANES)
    seen2, plan2 = np.empty((PLANE_FIELDS, PLANE_STATIONS, LANES)), np.empty((7, LANES))
    work, mass, total = np.empty((7, PLACES, LANES)), np.empty((MOST, LANES)), np.empty(LANES)
    volume_glances(a, b, v, y, s2, ka2, kb2, seen, plan, led, total)
    at, rough, count = np.empty((MOST, LANES)), np.empty((MOST, LANES)), np.empty(LANES, np.int64)
    refined(
        a, b, v, y, s2, ka2, kb2, wp, pa, pb, pv, seen, plan, total, at, rough, count
    )  # fmt: skip
    for i in range(LANES):
        total[i] = uneven_chords(at, rough, count[i] - 1, i, mass)
    for first in range(0, m, SHARE):
        last = min(first + SHARE, m)
        for i in range(LANES):
            cell, inside = pick(mass, count[i] - 1, i, u[i, first, 0])
            part, value = along(rough, cell, i, inside)
            x = at[cell, i] + part * (at[cell + 1, i] - at[cell, i])
            x = min(max(x, -1.0), 1.0)
            for n in range(first, last):
                out[i, n, 0] = x
                log_w[i, n] = total[i] - value
            wp[modes.X + i] = x
        near(a, b, v, y, s2, ka2, kb2, wp, pa, pb, pv, seen, plan)
        draw_planes(
            pa, pb, pv, y, s2, ka2, kb2, wp, w, la, lb, lv, seen2, plan2, work, u, out, log_w,
            first, last,
        )  # fmt: skip


@compiled
def draw_block(a, b, v, y, s2, ka2, kb2, dim, u, out, log_w):  # type: ignore[no-untyped-def]
    """Draws of one or two local parameters for a block of collapsed rows."""
    rows, m = len(ka2), out.shape[1]
    w = np.empty(lines.SCRATCH)
    la, lb, lv = np.empty(6 * rows * LANES), np.empty(6 * rows * LANES), np.empty(6 * rows * LANES)
    work = np.empty((7, PLACES, LANES))
    out[:] = 0.0
    log_w[:] = 0.0
    if dim == 2:
        wp = np.empty(modes.SCRATCH)
        pa, pb = np.empty(36 * rows * LANES), np.empty(36 * rows * LANES)
        pv = np.empty(36 * rows * LANES)
        modes.middle_plane(a, b, v, ka2, kb2, wp, pa, pb, pv)
        plane_modes(pa, pb, pv, y, s2, ka2, kb2, wp)
        seen, plan = np.empty((PLANE_FIELDS, PLANE_STATIONS, LANES)), np.empty((7, LANES))
        draw_planes(
            pa, pb, pv, y, s2, ka2, kb2, wp, w, la, lb, lv, seen, plan, work, u, out, log_w, 0, m
        )
        return
    modes.only_line(a, b, v, rows, la, lb, lv)
    for i in range(LANES):
        w[G + i] = 0.0
    lines.line_modes(la, lb, lv, y, s2, ka2, kb2, w)
    for n in range(m):
        draw_lines(la, lb, lv, y, s2, ka2, kb2, w, work[0], work[1], u, out, log_w, n)
