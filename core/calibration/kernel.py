"""A blade's message at given values of the shared parameters, compiled.

    m_b(s) = ∫ p(l) Π_i N(y_i | Y_m(l, s), sigma_i² + s_i²) dl

over the box of one, two or three local parameters l (`lines`, `planes`, `volumes`). The rows'
polynomials over all inputs are first collapsed to the local ones at each s. Parameters that do
not exist take the outer places with no dependence, and are not integrated.
"""

from __future__ import annotations

import math

import numpy as np

from core.calibration.lines import line_mode, line_sum
from core.calibration.planes import plane_mode, plane_sum
from core.calibration.volumes import MAX_NODES, STATIONS, log_sum, volume_glance, volume_nodes
from core.compiled import compiled


@compiled
def collapse_shared(c, exponents, factor, out):  # type: ignore[no-untyped-def]
    """Fix all but the local inputs: (R, M) → out (R, P, P, P); factor (M,) = shared monomials."""
    out[:] = 0.0
    rows, m = c.shape
    for q in range(m):
        i, j, k = exponents[q, 0], exponents[q, 1], exponents[q, 2]
        for r in range(rows):
            out[r, i, j, k] += c[r, q] * factor[q]


@compiled
def message(a, b, v, y, s2, ka2, kb2, dim, rough):  # type: ignore[no-untyped-def]
    """log of the message for collapsed rows (R, P, P, P) and `dim` local parameters.

    `rough` asks for a glance instead of the integral where there are three of them.
    """
    rows = a.shape[0]
    if dim == 3 and rough:
        value = volume_glance(a, b, v, y, s2, ka2, kb2, np.empty((STATIONS, 4)))
    elif dim == 3:
        points = np.empty((MAX_NODES, 4))
        count = volume_nodes(a, b, v, y, s2, ka2, kb2, points)
        value = log_sum(points, count)
    elif dim == 2:
        start, slopes, nodes = np.zeros(2), np.empty(5), np.empty((96, 4))
        pa, pb, pv = a[:, 0].copy(), b[:, 0].copy(), v[:, 0].copy()
        top, _ = plane_mode(pa, pb, pv, y, s2, ka2, kb2, start, slopes)
        value, _ = plane_sum(pa, pb, pv, y, s2, ka2, kb2, start, slopes, top, nodes)
    else:
        iv = np.empty(rows)
        la, lb, lv = a[:, 0, 0].copy(), b[:, 0, 0].copy(), v[:, 0, 0].copy()
        top, g, slope, bend, _ = line_mode(la, lb, lv, y, s2, ka2, kb2, 0.0, iv)
        value, _, _ = line_sum(la, lb, y, iv, g, top, slope, bend)
    return value - 0.5 * rows * math.log(2.0 * math.pi) - dim * math.log(2.0)


@compiled
def messages(a, b, v, exponents, factors, y, s2, ka2, kb2, dim, rough, out):  # type: ignore[no-untyped-def]
    """Messages at K values of the shared parameters.

    a, b, v (R, M); factors (K, M); y and s2 (K, R) readings and noise variances; out (K,).
    """
    rows, p = a.shape[0], 0
    for q in range(exponents.shape[0]):
        p = max(p, exponents[q, 0] + exponents[q, 1] + exponents[q, 2])
    p += 1
    ca = np.empty((rows, p, p, p))
    cb = np.empty((rows, p, p, p))
    cv = np.empty((rows, p, p, p))
    for k in range(factors.shape[0]):
        collapse_shared(a, exponents, factors[k], ca)
        collapse_shared(b, exponents, factors[k], cb)
        collapse_shared(v, exponents, factors[k], cv)
        out[k] = message(ca, cb, cv, y[k], s2[k], ka2, kb2, dim, rough)
