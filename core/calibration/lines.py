"""Innermost integral of a blade's message: one parameter free, all others fixed; 16 at a time.

Along a line the R rows of a blade are functions of one scaled parameter g in [-1, 1],

    y_r(g) = a_r(g) exp(b_r(g)),
    var_r(g) = sigma_r² + exp(2 b_r(g) + v_r(g)) (ka_r² + (a_r(g) kb_r)²),
    log L(g) = −½ Σ_r (y_r − y_obs,r)² / var_r − ½ Σ_r log var_r,

with a, b and v of degree 5. The rows of a 3-D scan share b and v, and have no kb: from the second
on they are marked (kb2 is `SAME`), and nobody reads their b and v. ``line_modes`` finds the modes
of a block of lines by Fisher scoring inside the box, in step with one another; ``line_ranges``
finds where each bell has fallen by 7 … 16 nats or the box cuts it, which is an exact limit of the
uniform prior, and ``line_sums`` integrates exp(log L) between by Gauss–Legendre points. Along most
lines log L is close to a parabola: then a polynomial through five or nine values takes its place at
these points.

A block holds `LANES` lines. Their coefficients are flat: ``la[(6 r + k) LANES + i]`` is the k-th
of row r on line i, readings and variances stand at ``y[r LANES + i]``; a line's own numbers are in
a scratch array `w` at the offsets below. One flat array with constant distances is what lets the
compiler run several lines in one instruction.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from core.calibration.vector import LANES, fast_exp, fast_log
from core.compiled import compiled, contracted

# offsets in the scratch array: place, mode, log L, slope, curvature there; the same of a trial
# exp(b), exp(2 b + v) and their relative slopes, of the row at hand
X, G, V, S, B, T, TV, TS, TB, STEP, LEFT, RIGHT, SIDE, TMP, SUM, E, U, DE, DU = (
    LANES * np.arange(19, dtype=np.int64)
).tolist()
SCRATCH = 19 * LANES
SAME = -1.0  # mark in the place of kb²: b and v are those of the row before, and kb is zero
POINTS = 12
GL_X, GL_W = np.polynomial.legendre.leggauss(POINTS)
LOBATTO = -np.cos(np.pi * np.arange(9) / 8)  # every second one: the places of five
BENT = 0.05  # size of the last Chebyshev coefficient of log L below which its polynomial will do


def _through(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values at the Gauss points of the polynomial through values at these places."""
    basis = np.polynomial.chebyshev.chebvander
    return np.asarray(basis(GL_X, len(places) - 1) @ np.linalg.inv(basis(places, len(places) - 1)))


QUARTIC, OCTIC = _through(LOBATTO[::2]), _through(LOBATTO)
INSIDE, OUTSIDE = 8.0, 17.0  # nats by which a bell has fallen where its range ends


@contracted
def line_slopes(la, lb, lv, y, s2, ka2, kb2, w):  # type: ignore[no-untyped-def]
    """log L, its slope and the Fisher information at the places w[T], into w[TV, TS, TB]."""
    rows = len(ka2)
    for i in range(LANES):
        w[TV + i] = w[TS + i] = w[TB + i] = 0.0
        w[TMP + i] = 1.0
    for r in range(rows):
        o = 6 * r * LANES
        p, ka, kb = r * LANES, ka2[r], max(kb2[r], 0.0)
        if kb2[r] >= 0.0:
            for i in range(LANES):
                g = w[T + i]
                b1, b2, b3 = lb[o + LANES + i], lb[o + 2 * LANES + i], lb[o + 3 * LANES + i]
                b4, b5 = lb[o + 4 * LANES + i], lb[o + 5 * LANES + i]
                v1, v2, v3 = lv[o + LANES + i], lv[o + 2 * LANES + i], lv[o + 3 * LANES + i]
                v4, v5 = lv[o + 4 * LANES + i], lv[o + 5 * LANES + i]
                vb = ((((b5 * g + b4) * g + b3) * g + b2) * g + b1) * g + lb[o + i]
                vv = ((((v5 * g + v4) * g + v3) * g + v2) * g + v1) * g + lv[o + i]
                db = (((5.0 * b5 * g + 4.0 * b4) * g + 3.0 * b3) * g + 2.0 * b2) * g + b1
                dv = (((5.0 * v5 * g + 4.0 * v4) * g + 3.0 * v3) * g + 2.0 * v2) * g + v1
                e = fast_exp(vb)
                w[E + i], w[U + i] = e, e * e * fast_exp(min(vv, 50.0))
                w[DE + i], w[DU + i] = db, 2.0 * db + dv
        for i in range(LANES):
            g = w[T + i]
            a1, a2, a3 = la[o + LANES + i], la[o + 2 * LANES + i], la[o + 3 * LANES + i]
            a4, a5 = la[o + 4 * LANES + i], la[o + 5 * LANES + i]
            va = ((((a5 * g + a4) * g + a3) * g + a2) * g + a1) * g + la[o + i]
            da = (((5.0 * a5 * g + 4.0 * a4) * g + 3.0 * a3) * g + 2.0 * a2) * g + a1
            e, u = w[E + i], w[U + i]
            scale = ka + va * va * kb
            weight = 1.0 / (s2[p + i] + u * scale)
            d = va * e - y[p + i]
            m = (da + va * w[DE + i]) * e
            z = 0.5 * weight * u * (scale * w[DU + i] + 2.0 * va * da * kb)  # var' / 2 var
            w[TV + i] -= 0.5 * d * d * weight
            w[TS + i] -= d * m * weight - (d * d * weight - 1.0) * z
            w[TB + i] += m * m * weight + 2.0 * z * z
            w[TMP + i] *= weight
        if r % 8 == 7 or r == rows - 1:
            for i in range(LANES):
                w[TV + i] += 0.5 * fast_log(w[TMP + i])
                w[TMP + i] = 1.0


@compiled
def line_modes(la, lb, lv, y, s2, ka2, kb2, w):  # type: ignore[no-untyped-def]
    """Modes inside [-1, 1] from the starts in w[G]; fills w[G, V, S, B, SIDE].

    SIDE is −1 or 1 where the mode sits at a bound with the slope pointing out of the box.
    """
    for i in range(LANES):
        w[T + i] = w[G + i] = min(max(w[G + i], -1.0), 1.0)
        w[V + i] = -math.inf
        w[STEP + i] = 1.0
    for _ in range(60):
        line_slopes(la, lb, lv, y, s2, ka2, kb2, w)
        moving = False
        for i in range(LANES):
            if w[TV + i] < w[V + i] - 0.01 and w[STEP + i] > 1e-5:
                w[STEP + i] *= 0.4
            else:
                w[G + i], w[V + i] = w[T + i], w[TV + i]
                w[S + i], w[B + i] = w[TS + i], w[TB + i]
                w[STEP + i] = 1.0
            g = w[G + i]
            step = w[S + i] / (w[B + i] + 1e-12)
            new = min(max(g + w[STEP + i] * min(max(step, -0.5), 0.5), -1.0), 1.0)
            if (new - g) * (new - g) * w[B + i] < 0.01:
                w[T + i] = g  # a tenth of the bell's width: the mode only places points
            else:
                w[T + i] = new
                moving = True
        if not moving:
            break
    for i in range(LANES):
        g = w[G + i]
        w[SIDE + i] = 0.0
        if g >= 1.0 and w[S + i] > 0.0:
            w[SIDE + i] = 1.0
        elif g <= -1.0 and w[S + i] < 0.0:
            w[SIDE + i] = -1.0


@contracted
def line_values(la, lb, lv, y, s2, ka2, kb2, w):  # type: ignore[no-untyped-def]
    """log L at the places w[T], into w[TV]."""
    rows = len(ka2)
    for i in range(LANES):
        w[TV + i] = 0.0
        w[TMP + i] = 1.0
    for r in range(rows):
        o = 6 * r * LANES
        p, ka, kb = r * LANES, ka2[r], max(kb2[r], 0.0)
        if kb2[r] >= 0.0:
            for i in range(LANES):
                g = w[T + i]
                vb = (lb[o + 5 * LANES + i] * g + lb[o + 4 * LANES + i]) * g + lb[o + 3 * LANES + i]
                vb = ((vb * g + lb[o + 2 * LANES + i]) * g + lb[o + LANES + i]) * g + lb[o + i]
                vv = (lv[o + 5 * LANES + i] * g + lv[o + 4 * LANES + i]) * g + lv[o + 3 * LANES + i]
                vv = ((vv * g + lv[o + 2 * LANES + i]) * g + lv[o + LANES + i]) * g + lv[o + i]
                e = fast_exp(vb)
                w[E + i], w[U + i] = e, e * e * fast_exp(min(vv, 50.0))
        for i in range(LANES):
            g = w[T + i]
            va = (la[o + 5 * LANES + i] * g + la[o + 4 * LANES + i]) * g + la[o + 3 * LANES + i]
            va = ((va * g + la[o + 2 * LANES + i]) * g + la[o + LANES + i]) * g + la[o + i]
            weight = 1.0 / (s2[p + i] + w[U + i] * (ka + va * va * kb))
            d = va * w[E + i] - y[p + i]
            w[TV + i] -= 0.5 * d * d * weight
            w[TMP + i] *= weight
        if r % 8 == 7 or r == rows - 1:
            for i in range(LANES):
                w[TV + i] += 0.5 * fast_log(w[TMP + i])
                w[TMP + i] = 1.0


@compiled
def line_ranges(la, lb, lv, y, s2, ka2, kb2, w, nodes):  # type: ignore[no-untyped-def]
    """How far each bell reaches to the left and to the right of its mode: w[LEFT], w[RIGHT].

    log L at the two ends goes into nodes[0] and nodes[8].
    """
    for direction in (-1.0, 1.0):
        out = LEFT if direction < 0.0 else RIGHT
        for i in range(LANES):
            rise = max(-direction * w[S + i], 0.0)  # at a bound it falls off linearly inwards
            width = 19.0 / (rise + math.sqrt(rise * rise + 19.0 * (w[B + i] + 1e-12)))
            w[STEP + i] = 1.0 - direction * w[G + i]  # the room left
            w[out + i] = min(width, w[STEP + i])
        for _ in range(40):
            for i in range(LANES):
                w[T + i] = w[G + i] + direction * w[out + i]
            line_values(la, lb, lv, y, s2, ka2, kb2, w)
            done = True
            for i in range(LANES):
                width, room = w[out + i], w[STEP + i]
                drop = w[V + i] - w[TV + i]
                if width >= room:
                    if drop > 40.0:
                        w[out + i], done = 0.4 * room, False
                        w[STEP + i] = 0.8 * room
                elif drop < INSIDE:
                    grown = min(max(math.sqrt(10.0 / max(drop, 0.1)), 1.2), 2.5) * width
                    w[out + i], done = min(grown, room), False
                elif drop > OUTSIDE:
                    w[out + i], done = width * max(math.sqrt(10.0 / drop), 0.25), False
            if done:
                break
        for i in range(LANES):
            nodes[0 if direction < 0.0 else 8, i] = w[TV + i]


@compiled
def line_sums(la, lb, lv, y, s2, ka2, kb2, w, nodes):  # type: ignore[no-untyped-def]
    """log ∫ L dg over [-1, 1], into w[SUM]; modes and ranges as the functions above left them.

    nodes (9, LANES) holds log L at both ends in its first and last row, as line_ranges left it.
    """
    for first, step in ((2, 2), (1, 2)):  # the even places, then those between
        for q in range(first, 8, step):
            for i in range(LANES):
                wide = w[LEFT + i] + w[RIGHT + i]
                w[T + i] = w[G + i] - w[LEFT + i] + wide * 0.5 * (1.0 + LOBATTO[q])
            line_values(la, lb, lv, y, s2, ka2, kb2, w)
            for i in range(LANES):
                nodes[q, i] = w[TV + i]
        if first == 2 and bent(nodes, 2) <= BENT:
            interpolated(nodes, 2, QUARTIC, w)
            return
    if bent(nodes, 1) <= BENT:
        interpolated(nodes, 1, OCTIC, w)
        return
    for i in range(LANES):
        w[SUM + i], w[STEP + i] = 0.0, w[V + i]
    for q in range(POINTS):
        for i in range(LANES):
            wide = w[LEFT + i] + w[RIGHT + i]
            w[T + i] = w[G + i] - w[LEFT + i] + wide * 0.5 * (1.0 + GL_X[q])
        line_values(la, lb, lv, y, s2, ka2, kb2, w)
        for i in range(LANES):
            if w[TV + i] > w[STEP + i]:  # a stalled mode cannot overflow
                w[SUM + i] *= math.exp(w[STEP + i] - w[TV + i])
                w[STEP + i] = w[TV + i]
        for i in range(LANES):
            w[SUM + i] += 0.5 * GL_W[q] * fast_exp(w[TV + i] - w[STEP + i])
    for i in range(LANES):
        total = w[SUM + i] * (w[LEFT + i] + w[RIGHT + i])
        if not total > 0.0:  # narrower than every point: the bell itself
            total = min(math.sqrt(2.0 * math.pi / (w[B + i] + 1e-12)), 2.0)
        w[SUM + i] = w[STEP + i] + math.log(total)


@contracted
def bent(nodes, step):  # type: ignore[no-untyped-def]
    """The largest last Chebyshev coefficient of log L through every `step`-th node, over lines."""
    most = 0.0
    for i in range(LANES):
        last, sign = 0.5 * (nodes[0, i] + nodes[8, i]), -1.0
        for q in range(step, 8, step):
            last += sign * nodes[q, i]
            sign = -sign
        most = max(most, abs(last))
    return 0.25 * most * (1.0 if step == 2 else 0.5)


@contracted
def interpolated(nodes, step, matrix, w):  # type: ignore[no-untyped-def]
    """w[SUM] from log L at every `step`-th node; `matrix` leads from there to the Gauss points."""
    for i in range(LANES):
        w[STEP + i], w[TMP + i] = nodes[0, i], 0.0
    for q in range(step, 9, step):
        for i in range(LANES):
            w[STEP + i] = max(w[STEP + i], nodes[q, i])
    for p in range(POINTS):
        for i in range(LANES):
            w[TV + i] = -w[STEP + i]
        for q in range(matrix.shape[1]):
            for i in range(LANES):
                w[TV + i] += matrix[p, q] * nodes[q * step, i]
        for i in range(LANES):
            w[TMP + i] += GL_W[p] * fast_exp(w[TV + i])
    for i in range(LANES):
        total = 0.5 * w[TMP + i] * (w[LEFT + i] + w[RIGHT + i])
        w[SUM + i] = w[STEP + i] + fast_log(total)
