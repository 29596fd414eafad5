"""What a model answers over the whole box of three local parameters, as a histogram; compiled.

Answers Y(l) and variances V(l) are known on a grid of the box, and each of its cells is six
tetrahedra (Kuhn's) in which Y is linear. The share of a tetrahedron in which Y stays below a value
is a cubic spline of that value with the four corners as knots, so the shares of all bins of Y are
those of the interpolant, exactly, however thin the sheets Y = const are beside a cell; physicists
count the states of a crystal like that (Lehmann & Taut, phys. stat. sol. (b) 54, 1972). What is
left is the interpolant's error: of second order in the width of a cell, and smooth in all else that
Y depends on.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from core.calibration.vector import fast_exp, fast_log
from core.compiled import compiled

SHARPEST = 0.6  # of a bin's width: the least standard deviation that a sum over bins resolves
LOWEST = -1e300


def _corners() -> NDArray[np.int64]:
    """Second and third corner of each tetrahedron of a cell, (6, 2, 3); the others are (0, 0, 0)
    and (1, 1, 1), and from one to the next a single coordinate grows."""
    unit = np.eye(3, dtype=np.int64)
    return np.array([[unit[i], unit[i] + unit[j]] for i, j, _ in permutations(range(3))])


CORNERS = _corners()


@compiled
def collapse_row(c, exponents, factors, out):  # type: ignore[no-untyped-def]
    """Fix all but the local inputs of one polynomial: c (M,), factors (M,) → out (6, 6, 6)."""
    out[:] = 0.0
    for q in range(len(c)):
        out[exponents[q, 0], exponents[q, 1], exponents[q, 2]] += c[q] * factors[q]


@compiled
def on_grid(c, out):  # type: ignore[no-untyped-def]
    """A polynomial with coefficients c (6, 6, 6) on an even grid over [-1, 1]³, out (I, J, K)."""
    plane, line = np.empty((6, 6)), np.empty(6)
    for i in range(out.shape[0]):
        x = 2.0 * i / (out.shape[0] - 1) - 1.0
        plane[:] = c[5]
        for d in range(4, -1, -1):
            plane[:] = plane * x + c[d]
        for j in range(out.shape[1]):
            x = 2.0 * j / (out.shape[1] - 1) - 1.0
            line[:] = plane[5]
            for d in range(4, -1, -1):
                line[:] = line * x + plane[d]
            for k in range(out.shape[2]):
                x = 2.0 * k / (out.shape[2] - 1) - 1.0
                t = (((line[5] * x + line[4]) * x + line[3]) * x + line[2]) * x + line[1]
                out[i, j, k] = t * x + line[0]


@compiled
def answers(a, b, v, exponents, factors, ka2, kb2, y, s2):  # type: ignore[no-untyped-def]
    """A row's answers and their variances on a grid at one shared value: y and s2 (I, J, K).

    a, b, v (M,), factors (M,); y = a exp(b), s2 = exp(2 b + v) (ka² + (a kb)²).
    """
    c, vb, vv = np.empty((6, 6, 6)), np.empty(y.shape), np.empty(y.shape)
    collapse_row(a, exponents, factors, c)
    on_grid(c, y)
    collapse_row(b, exponents, factors, c)
    on_grid(c, vb)
    collapse_row(v, exponents, factors, c)
    on_grid(c, vv)
    for i in range(y.shape[0]):
        for j in range(y.shape[1]):
            for k in range(y.shape[2]):
                e, va = fast_exp(vb[i, j, k]), y[i, j, k]
                y[i, j, k] = va * e
                s2[i, j, k] = e * e * fast_exp(min(vv[i, j, k], 50.0)) * (ka2 + va * va * kb2)


@compiled
def histogram(y, s2, step, corners, low, width, share, variance):  # type: ignore[no-untyped-def]
    """Shares of the box by classes of V and bins of Y, and the mean of V in each: (C, K) both.

    y, s2   on the grid's points, of which every `step`-th one is a corner of cells
    low     where the first bin begins, `width` the width of all; no answer lies outside
    """
    share[:], variance[:] = 0.0, 0.0
    least = max(s2.min(), 1e-300)
    classes = len(share) / (np.log(max(s2.max() / least, 1.0)) + 1e-9)
    cells = 1.0
    for n in y.shape:
        cells *= (n - 1) // step
    part, last_bin = 1.0 / (6.0 * cells), share.shape[1] - 1
    for i in range(0, y.shape[0] - step, step):
        for j in range(0, y.shape[1] - step, step):
            for k in range(0, y.shape[2] - step, step):
                for t in range(6):
                    i1, j1 = i + step * corners[t, 0, 0], j + step * corners[t, 0, 1]
                    i2, j2 = i + step * corners[t, 1, 0], j + step * corners[t, 1, 1]
                    k1, k2 = k + step * corners[t, 0, 2], k + step * corners[t, 1, 2]
                    a, d = y[i, j, k], y[i + step, j + step, k + step]
                    b, c = y[i1, j1, k1], y[i2, j2, k2]
                    s = s2[i, j, k] + s2[i + step, j + step, k + step]
                    s = 0.25 * (s + s2[i1, j1, k1] + s2[i2, j2, k2])
                    if a > b:
                        a, b = b, a
                    if c > d:
                        c, d = d, c
                    if a > c:
                        a, c = c, a
                    if b > d:
                        b, d = d, b
                    if b > c:
                        b, c = c, b
                    q = int(classes * fast_log(max(s / least, 1.0)))
                    q = min(max(q, 0), len(share) - 1)
                    n = min(max(int((a - low) / width), 0), last_bin)
                    edge, before = low + (n + 1) * width, 0.0
                    if edge < d:
                        first = 1.0 / ((b - a) * (c - a) * (d - a))
                        middle = 1.0 / ((c - a) * (d - a))
                        bend = (c - a + d - b) / ((c - b) * (d - b))
                        final = 1.0 / ((d - a) * (d - b) * (d - c))
                        while edge < b and n < last_bin:
                            u = edge - a
                            below = u * u * u * first
                            share[q, n] += below - before
                            variance[q, n] += (below - before) * s
                            before = below
                            n += 1
                            edge += width
                        ba = b - a
                        while edge < c and n < last_bin:
                            u = edge - b
                            below = (ba * (ba + 3.0 * u) + (3.0 - bend * u) * u * u) * middle
                            share[q, n] += below - before
                            variance[q, n] += (below - before) * s
                            before = below
                            n += 1
                            edge += width
                        while edge < d and n < last_bin:
                            u = d - edge
                            below = 1.0 - u * u * u * final
                            share[q, n] += below - before
                            variance[q, n] += (below - before) * s
                            before = below
                            n += 1
                            edge += width
                    share[q, n] += 1.0 - before
                    variance[q, n] += (1.0 - before) * s
    for q in range(share.shape[0]):
        for n in range(share.shape[1]):
            if share[q, n] > 0.0:
                variance[q, n] /= share[q, n]
            share[q, n] *= part


@compiled
def seen(bins, width, y, s2, out):  # type: ignore[no-untyped-def]
    """log Σ_k share_k N(y | middle_k, s2 + variance_k) for readings y (B,), out (B,).

    bins (3, N): middle, variance and share of those that are not empty. A bin's own width widens
    what is seen by width² / 12, which is taken off the variance.
    """
    least, own, number = (SHARPEST * width) ** 2, width * width / 12.0, bins.shape[1]
    peak, scale = np.empty(number), np.empty(number)
    for b in range(len(y)):
        top = LOWEST
        for k in range(number):
            scale[k] = 1.0 / max(s2[b] + bins[1, k] - own, least)
            off = y[b] - bins[0, k]
            peak[k] = -0.5 * off * off * scale[k]
            top = max(top, peak[k])
        value = 0.0
        for k in range(number):
            if peak[k] > top - 30.0:
                value += bins[2, k] * np.sqrt(scale[k]) * fast_exp(peak[k] - top)
        out[b] = top + np.log(value) - 0.5 * np.log(2.0 * np.pi)
