"""Bells of a blade's likelihood along lines: one parameter free, all others fixed; 16 at a time.

Along a line the R rows of a blade are functions of one scaled parameter g in [-1, 1],

    y_r(g) = a_r(g) exp(b_r(g)),
    var_r(g) = sigma_r² + exp(2 b_r(g) + v_r(g)) (ka_r² + (a_r(g) kb_r)²),
    log L(g) = −½ Σ_r (y_r − y_obs,r)² / var_r − ½ Σ_r log var_r,

with a, b and v of degree 5. The rows of a 3-D scan share b and v, and have no kb: from the second
on they are marked (kb2 is `SAME`), and nobody reads their b and v. ``line_modes`` finds the modes
of a block of lines by Fisher scoring inside the box, in step with one another; ``line_ranges``
finds where each bell has fallen by 7 … 16 nats or the box cuts it, which is an exact limit of the
uniform prior. The innermost integral of a message goes from there (`line_integrals`).

A block holds `LANES` lines. Their coefficients are flat: ``la[(6 r + k) LANES + i]`` is the k-th
of row r on line i, readings and variances stand at ``y[r LANES + i]``; a line's own numbers are in
a scratch array `w` at the offsets below. One flat array with constant distances is what lets the
compiler run several lines in one instruction.
"""

from __future__ import annotations

import math

import numpy as np

from core.calibration.vector import LANES, fast_exp, fast_log
from core.compiled import compiled, contracted

# offsets in the scratch array: place, mode, log L, slope, curvature there; the same of a trial
# exp(b), exp(2 b + v) and their relative slopes, of the row at hand
X, G, V, S, B, T, TV, TS, TB, STEP, LEFT, RIGHT, SIDE, TMP, SUM, E, U, DE, DU = (
    LANES * np.arange(19, dtype=np.int64)
).tolist()
SCRATCH = 19 * LANES
SAME = -1.0  # mark in the place of kb²: b and v are those of the row before, and kb is zero
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
