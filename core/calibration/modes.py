"""Where the two inner parameters of a blade are likeliest, for 16 values of the outer one at once.

A block of planes: the outer parameter is fixed at w[X + i] on plane i, and ``plane_modes`` climbs
log L over the middle parameter (w[M]) and the inner one (w[G]) by Fisher scoring inside the box,
all planes in step.

Coefficients are flat: ``pa[((6 r + j) 6 + k) LANES + i]`` belongs to the j-th power of the middle
and the k-th of the inner parameter of row r on plane i.
"""

from __future__ import annotations

import math

import numpy as np

from core.calibration.vector import LANES, fast_exp, fast_log
from core.compiled import compiled, contracted

# offsets in the scratch array; the trial's numbers stand DT after those that are kept
X, M, G, V, SX, SG, HXX, HXG, HGG, CODE, STEP, TM, TG, TV = (
    LANES * np.arange(14, dtype=np.int64)
).tolist()
DT = TV - V  # TV, then trial slopes and information, follow in the order of V … HGG
SCRATCH = TV + 6 * LANES


@contracted
def collapse_volumes(c, marks, w, out):  # type: ignore[no-untyped-def]
    """Fix the outer parameter at w[X]: a block of volumes → a block of planes (36 R LANES,).

    Rows whose mark (R,) is negative are left out (`lines`).
    """
    n = 36 * LANES  # from one power of the outer parameter to the next
    for r in range(len(marks)):
        if marks[r] < 0.0:
            continue
        for j in range(6):
            for k in range(6 - j):
                o, q = ((6 * r + j) * 6 + k) * LANES, ((36 * r + j) * 6 + k) * LANES
                if j + k == 5:
                    for i in range(LANES):
                        out[o + i] = c[q + i]
                elif j + k == 4:
                    for i in range(LANES):
                        out[o + i] = c[q + n + i] * w[X + i] + c[q + i]
                elif j + k == 3:
                    for i in range(LANES):
                        x = w[X + i]
                        out[o + i] = (c[q + 2 * n + i] * x + c[q + n + i]) * x + c[q + i]
                elif j + k == 2:
                    for i in range(LANES):
                        x, p = w[X + i], q + i
                        t = (c[p + 3 * n] * x + c[p + 2 * n]) * x + c[p + n]
                        out[o + i] = t * x + c[p]
                else:
                    for i in range(LANES):
                        x, p = w[X + i], q + i
                        t = (c[p + 4 * n] * x + c[p + 3 * n]) * x + c[p + 2 * n]
                        if j + k == 0:
                            t += c[p + 5 * n] * x * x * x
                        out[o + i] = (t * x + c[p + n]) * x + c[p]


@compiled
def middle_plane(a, b, v, ka2, kb2, w, pa, pb, pv):  # type: ignore[no-untyped-def]
    """Planes of a block that does not depend on the outer parameter; starts in their middle."""
    for i in range(LANES):
        w[X + i] = w[TM + i] = w[TG + i] = 0.0
        w[V + i] = -math.inf
    collapse_volumes(a, ka2, w, pa)
    collapse_volumes(b, kb2, w, pb)
    collapse_volumes(v, kb2, w, pv)


@compiled
def only_line(a, b, v, rows, la, lb, lv):  # type: ignore[no-untyped-def]
    """Lines of a block that depends on the inner parameter alone."""
    for r in range(rows):
        for q in range(6 * LANES):
            o, n = 216 * r * LANES + q, 6 * r * LANES + q
            la[n], lb[n], lv[n] = a[o], b[o], v[o]


@contracted
def horner(c, r, w, out):  # type: ignore[no-untyped-def]
    """One polynomial at (w[TM], w[TG]): value and slopes along both, into out (3 LANES,)."""
    for i in range(LANES):
        m, g, p = w[TM + i], w[TG + i], 36 * r * LANES + i
        c0, c1, c2 = c[p], c[p + 1 * LANES], c[p + 2 * LANES]
        c3, c4, c5 = c[p + 3 * LANES], c[p + 4 * LANES], c[p + 5 * LANES]
        q0 = ((((c5 * g + c4) * g + c3) * g + c2) * g + c1) * g + c0
        d0 = (((5.0 * c5 * g + 4.0 * c4) * g + 3.0 * c3) * g + 2.0 * c2) * g + c1
        c0, c1, c2 = c[p + 6 * LANES], c[p + 7 * LANES], c[p + 8 * LANES]
        c3, c4 = c[p + 9 * LANES], c[p + 10 * LANES]
        q1 = (((c4 * g + c3) * g + c2) * g + c1) * g + c0
        d1 = ((4.0 * c4 * g + 3.0 * c3) * g + 2.0 * c2) * g + c1
        c0, c1, c2 = c[p + 12 * LANES], c[p + 13 * LANES], c[p + 14 * LANES]
        c3 = c[p + 15 * LANES]
        q2 = ((c3 * g + c2) * g + c1) * g + c0
        d2 = (3.0 * c3 * g + 2.0 * c2) * g + c1
        c0, c1, c2 = c[p + 18 * LANES], c[p + 19 * LANES], c[p + 20 * LANES]
        q3 = (c2 * g + c1) * g + c0
        d3 = 2.0 * c2 * g + c1
        c0, c1 = c[p + 24 * LANES], c[p + 25 * LANES]
        q4 = c1 * g + c0
        d4 = c1
        q5 = c[p + 30 * LANES]
        out[i] = ((((q5 * m + q4) * m + q3) * m + q2) * m + q1) * m + q0
        out[LANES + i] = (((5.0 * q5 * m + 4.0 * q4) * m + 3.0 * q3) * m + 2.0 * q2) * m + q1
        out[2 * LANES + i] = (((d4 * m + d3) * m + d2) * m + d1) * m + d0


@contracted
def block_slopes(pa, pb, pv, y, s2, ka2, kb2, w, acc):  # type: ignore[no-untyped-def]
    """log L, its slopes and Fisher information at (w[TM], w[TG]), into w[TV] and what follows.

    acc (10 LANES,) is scratch: by lane a and its slopes, exp(b) and b's slopes, exp(2 b + v) and
    v's slopes, and the product of some rows' weights, whose logarithm is taken once.
    """
    out = w[TV : TV + 6 * LANES]
    for i in range(6 * LANES):
        out[i] = 0.0
    for i in range(9 * LANES, 10 * LANES):
        acc[i] = 1.0
    rows = len(ka2)
    for r in range(rows):
        horner(pa, r, w, acc[: 3 * LANES])
        if kb2[r] >= 0.0:
            horner(pb, r, w, acc[3 * LANES : 6 * LANES])
            horner(pv, r, w, acc[6 * LANES : 9 * LANES])
            for i in range(LANES):
                e, v = fast_exp(acc[3 * LANES + i]), fast_exp(min(acc[6 * LANES + i], 50.0))
                acc[3 * LANES + i], acc[6 * LANES + i] = e, e * e * v
        own = slice(r * LANES, (r + 1) * LANES)
        add_row(acc, y[own], s2[own], ka2[r], max(kb2[r], 0.0), out)
        if r % 8 == 7 or r == rows - 1:
            for i in range(LANES):
                out[i] += 0.5 * fast_log(acc[9 * LANES + i])
                acc[9 * LANES + i] = 1.0


@contracted
def add_row(acc, y, s2, ka, kb, out):  # type: ignore[no-untyped-def]
    """One row's share of log L, its slopes and its information, for `block_slopes`."""
    for i in range(LANES):
        va, vax, vag = acc[i], acc[LANES + i], acc[2 * LANES + i]
        e, vbx, vbg = acc[3 * LANES + i], acc[4 * LANES + i], acc[5 * LANES + i]
        u, vvx, vvg = acc[6 * LANES + i], acc[7 * LANES + i], acc[8 * LANES + i]
        scale = ka + va * va * kb
        iv = 1.0 / (s2[i] + u * scale)
        d = va * e - y[i]
        mx, mg = (vax + va * vbx) * e, (vag + va * vbg) * e
        zx = 0.5 * iv * u * (scale * (2.0 * vbx + vvx) + 2.0 * va * vax * kb)
        zg = 0.5 * iv * u * (scale * (2.0 * vbg + vvg) + 2.0 * va * vag * kb)
        excess = d * d * iv - 1.0
        out[i] -= 0.5 * d * d * iv
        acc[9 * LANES + i] *= iv
        out[LANES + i] -= d * mx * iv - excess * zx
        out[2 * LANES + i] -= d * mg * iv - excess * zg
        out[3 * LANES + i] += mx * mx * iv + 2.0 * zx * zx
        out[4 * LANES + i] += mx * mg * iv + 2.0 * zx * zg
        out[5 * LANES + i] += mg * mg * iv + 2.0 * zg * zg


@compiled
def ascent(x, g, sx, sg, hxx, hxg, hgg):  # type: ignore[no-untyped-def]
    """The scoring step inside the box: (dx, dg, expected gain).

    Few readings leave the information singular: a step that would be too long gets more ridge until
    it turns uphill (Levenberg & Marquardt); cut short instead, it would run along the valley.
    """
    ridge = 1e-9 * (hxx + hgg) + 0.05
    free_x = not ((x >= 1.0 and sx > 0.0) or (x <= -1.0 and sx < 0.0))
    free_g = not ((g >= 1.0 and sg > 0.0) or (g <= -1.0 and sg < 0.0))
    dx = dg = 0.0
    for _ in range(12):
        dx = dg = 0.0
        xx, gg = hxx + ridge, hgg + ridge
        if free_x and free_g:
            det = xx * gg - hxg * hxg
            dx, dg = (gg * sx - hxg * sg) / det, (xx * sg - hxg * sx) / det
            if (x >= 1.0 and dx > 0.0) or (x <= -1.0 and dx < 0.0):
                dx, dg = 0.0, sg / gg
            elif (g >= 1.0 and dg > 0.0) or (g <= -1.0 and dg < 0.0):
                dx, dg = sx / xx, 0.0
        elif free_x:
            dx = sx / xx
        elif free_g:
            dg = sg / gg
        if max(abs(dx), abs(dg)) <= 0.5:
            break
        ridge *= 10.0
    longest = max(abs(dx), abs(dg))
    if longest > 0.5:
        dx, dg = dx * 0.5 / longest, dg * 0.5 / longest
    return dx, dg, sx * dx + sg * dg


@compiled
def plane_modes(pa, pb, pv, y, s2, ka2, kb2, w):  # type: ignore[no-untyped-def]
    """Climb from (w[TM], w[TG]); a plane keeps what it had where that is higher.

    w[V] is the height to beat (−inf for none). Kept: w[M, G, V, SX … HGG].
    """
    best = np.empty(LANES)
    for i in range(LANES):
        best[i] = -math.inf
        w[STEP + i] = 1.0
    here, acc = np.empty((8, LANES)), np.empty(10 * LANES)
    for _ in range(40):
        block_slopes(pa, pb, pv, y, s2, ka2, kb2, w, acc)
        moving = False
        for i in range(LANES):
            if w[TV + i] < best[i] - 1e-3 and w[STEP + i] > 1e-6:
                w[STEP + i] *= 0.4
            else:
                best[i] = w[TV + i]
                w[STEP + i] = 1.0
                here[0, i], here[1, i] = w[TM + i], w[TG + i]
                for q in range(6):
                    here[2 + q, i] = w[TV + q * LANES + i]
            x, g = here[0, i], here[1, i]
            dx, dg, gain = ascent(
                x, g, here[3, i], here[4, i], here[5, i], here[6, i], here[7, i]
            )  # fmt: skip
            if gain < 1e-3:
                w[TM + i], w[TG + i] = x, g
                continue
            w[TM + i] = min(max(x + w[STEP + i] * dx, -1.0), 1.0)
            w[TG + i] = min(max(g + w[STEP + i] * dg, -1.0), 1.0)
            moving = True
        if not moving:
            break
    for i in range(LANES):
        if best[i] > w[V + i] + 1e-6:
            w[M + i], w[G + i] = here[0, i], here[1, i]
            for q in range(6):
                w[V + q * LANES + i] = here[2 + q, i]


@compiled
def codes(w):  # type: ignore[no-untyped-def]
    """w[CODE]: 3 (side of the middle + 1) + side of the inner + 1; 4 where no bound is active."""
    for i in range(LANES):
        x, g, sx, sg = w[M + i], w[G + i], w[SX + i], w[SG + i]
        side_x = 1.0 if (x >= 1.0 and sx > 0.0) else (-1.0 if (x <= -1.0 and sx < 0.0) else 0.0)
        side_g = 1.0 if (g >= 1.0 and sg > 0.0) else (-1.0 if (g <= -1.0 and sg < 0.0) else 0.0)
        w[CODE + i] = 3.0 * (side_x + 1.0) + side_g + 1.0
