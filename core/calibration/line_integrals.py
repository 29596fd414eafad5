"""Innermost integral of a blade's message, along lines whose bells are known; 16 at a time.

Between the ends of each bell (`lines`) exp(log L) is summed at Gauss–Legendre points,

    ∫ L dg ≈ ½ (left + right) Σ_q w_q L(g_q).

Along most lines log L is close to a parabola: then a polynomial through five or nine values, at
Chebyshev–Lobatto places, takes its place at these points. It will do where the last Chebyshev
coefficient of log L is small on every line of the block.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from core.calibration.lines import LEFT, RIGHT, STEP, SUM, TMP, TV, B, G, T, V, line_values
from core.calibration.vector import LANES, fast_exp, fast_log
from core.compiled import compiled, contracted

POINTS = 12
GL_X, GL_W = np.polynomial.legendre.leggauss(POINTS)
LOBATTO = -np.cos(np.pi * np.arange(9) / 8)  # every second one: the places of five
BENT = 0.05  # size of the last Chebyshev coefficient of log L below which its polynomial will do


def _through(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values at the Gauss points of the polynomial through values at these places."""
    basis = np.polynomial.chebyshev.chebvander
    return np.asarray(basis(GL_X, len(places) - 1) @ np.linalg.inv(basis(places, len(places) - 1)))


QUARTIC, OCTIC = _through(LOBATTO[::2]), _through(LOBATTO)


@compiled
def line_sums(la, lb, lv, y, s2, ka2, kb2, w, nodes):  # type: ignore[no-untyped-def]
    """log ∫ L dg over [-1, 1], into w[SUM]; modes and ranges as `lines` left them.

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
