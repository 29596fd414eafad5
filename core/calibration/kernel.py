"""A blade's message at given values of the shared parameters, compiled.

    m_b(s) = ∫ p(l) Π_i N(y_i | Y_m(l, s), sigma_i² + s_i²) dl

over the box of one, two or three local parameters l (`line_integrals`, `planes`, `volumes`). The
rows' polynomials over all inputs are first collapsed to the local ones at each s. Parameters that
do not exist take the outer places with no dependence, and are not integrated. `LANES` values of s
go through the quadrature together; their neighbourhood decides how well they keep step, never what
comes out. Only a glance and the draws' survey, which need not be exact, are led: within a chain of
blocks, each starts from the one before it (`survey`).
"""

from __future__ import annotations

import numpy as np

from core.calibration import lines, modes
from core.calibration.draws import draw_block, draw_volumes
from core.calibration.line_integrals import line_sums
from core.calibration.panels import MOST
from core.calibration.planes import FIELDS as PLANE_FIELDS
from core.calibration.planes import STATIONS as PLANE_STATIONS
from core.calibration.planes import plane_sums
from core.calibration.survey import FIELDS, STATIONS
from core.calibration.vector import LANES
from core.calibration.volumes import volume_glances, volume_sums
from core.compiled import compiled, contracted


@contracted
def collapse_shared(c, exponents, factors, marks, out):  # type: ignore[no-untyped-def]
    """Fix all but the local inputs: (R, M) → a block of volumes; factors (M, LANES).

    Rows whose mark (R,) is negative are left out (`lines`).
    """
    out[:] = 0.0
    rows, m = c.shape
    for r in range(rows):
        if marks[r] < 0.0:
            continue
        for q in range(m):
            d, j, k = exponents[q, 0], exponents[q, 1], exponents[q, 2]
            o = (((6 * r + d) * 6 + j) * 6 + k) * LANES
            for i in range(LANES):
                out[o + i] += c[r, q] * factors[q, i]


@compiled
def collapsed(a, b, v, exponents, factors, ka2, kb2, ca, cb, cv):  # type: ignore[no-untyped-def]
    """`collapse_shared` for the three polynomials."""
    collapse_shared(a, exponents, factors, ka2, ca)
    collapse_shared(b, exponents, factors, kb2, cb)
    collapse_shared(v, exponents, factors, kb2, cv)


@compiled
def volume_messages(a, b, v, exponents, factors, y, s2, ka2, kb2, chain, out):  # type: ignore[no-untyped-def]
    """log ∫ L over the box of three local parameters; or glances at it, in chains of blocks.

    a, b, v (R, M); factors (N, M, LANES); y and s2 (N, R, LANES) readings and noise variances;
    out (N, LANES).
    """
    size = 216 * len(ka2) * LANES
    ca, cb, cv = np.empty(size), np.empty(size), np.empty(size)
    seen, plan = np.empty((FIELDS, STATIONS, LANES)), np.empty((3, LANES))
    for n in range(len(factors)):
        collapsed(a, b, v, exponents, factors[n], ka2, kb2, ca, cb, cv)
        if chain > 0:
            yn, sn = y[n].ravel(), s2[n].ravel()
            volume_glances(ca, cb, cv, yn, sn, ka2, kb2, seen, plan, n % chain > 0, out[n])
        else:
            volume_sums(ca, cb, cv, y[n].ravel(), s2[n].ravel(), ka2, kb2, out[n])


@compiled
def plane_messages(a, b, v, exponents, factors, y, s2, ka2, kb2, out):  # type: ignore[no-untyped-def]
    """The same for two local parameters."""
    rows = len(ka2)
    size = 216 * rows * LANES
    ca, cb, cv = np.empty(size), np.empty(size), np.empty(size)
    wp, w = np.empty(modes.SCRATCH), np.empty(lines.SCRATCH)
    la, lb, lv = np.empty(6 * rows * LANES), np.empty(6 * rows * LANES), np.empty(6 * rows * LANES)
    pa, pb = np.empty(36 * rows * LANES), np.empty(36 * rows * LANES)
    pv = np.empty(36 * rows * LANES)
    seen, plan = np.empty((PLANE_FIELDS, PLANE_STATIONS, LANES)), np.empty((7, LANES))
    panels, waiting = np.empty((MOST, 3, LANES)), np.empty(LANES, dtype=np.int64)
    for n in range(len(factors)):
        collapsed(a, b, v, exponents, factors[n], ka2, kb2, ca, cb, cv)
        yn, sn = y[n].ravel(), s2[n].ravel()
        modes.middle_plane(ca, cb, cv, ka2, kb2, wp, pa, pb, pv)
        modes.plane_modes(pa, pb, pv, yn, sn, ka2, kb2, wp)
        plane_sums(
            pa, pb, pv, yn, sn, ka2, kb2, wp, w, la, lb, lv, seen, plan, panels, waiting, out[n]
        )


@compiled
def line_messages(a, b, v, exponents, factors, y, s2, ka2, kb2, out):  # type: ignore[no-untyped-def]
    """The same for one local parameter."""
    rows = len(ka2)
    size = 216 * rows * LANES
    ca, cb, cv = np.empty(size), np.empty(size), np.empty(size)
    w, ends = np.empty(lines.SCRATCH), np.empty((9, LANES))
    la, lb, lv = np.empty(6 * rows * LANES), np.empty(6 * rows * LANES), np.empty(6 * rows * LANES)
    for n in range(len(factors)):
        collapsed(a, b, v, exponents, factors[n], ka2, kb2, ca, cb, cv)
        yn, sn = y[n].ravel(), s2[n].ravel()
        modes.only_line(ca, cb, cv, rows, la, lb, lv)
        for i in range(LANES):
            w[lines.G + i] = 0.0
        lines.line_modes(la, lb, lv, yn, sn, ka2, kb2, w)
        lines.line_ranges(la, lb, lv, yn, sn, ka2, kb2, w, ends)
        line_sums(la, lb, lv, yn, sn, ka2, kb2, w, ends)
        for i in range(LANES):
            out[n, i] = w[lines.SUM + i]


@compiled
def volume_draws(a, b, v, exponents, factors, y, s2, ka2, kb2, chain, u, out, log_w):  # type: ignore[no-untyped-def]
    """Draws of three local parameters: u (N, LANES, m, 6) uniforms, out (N, LANES, m, 3).

    log_w (N, LANES, m) receives log L / q, without the constants of L.
    """
    size = 216 * len(ka2) * LANES
    ca, cb, cv = np.empty(size), np.empty(size), np.empty(size)
    seen, plan = np.empty((FIELDS, STATIONS, LANES)), np.empty((3, LANES))
    for n in range(len(factors)):
        collapsed(a, b, v, exponents, factors[n], ka2, kb2, ca, cb, cv)
        yn, sn = y[n].ravel(), s2[n].ravel()
        led = n % chain > 0
        draw_volumes(ca, cb, cv, yn, sn, ka2, kb2, seen, plan, led, u[n], out[n], log_w[n])


@compiled
def fewer_draws(a, b, v, exponents, factors, y, s2, ka2, kb2, dim, u, out, log_w):  # type: ignore[no-untyped-def]
    """Draws of one or two local parameters, in the last places of `out`."""
    size = 216 * len(ka2) * LANES
    ca, cb, cv = np.empty(size), np.empty(size), np.empty(size)
    for n in range(len(factors)):
        collapsed(a, b, v, exponents, factors[n], ka2, kb2, ca, cb, cv)
        yn, sn = y[n].ravel(), s2[n].ravel()
        draw_block(ca, cb, cv, yn, sn, ka2, kb2, dim, u[n], out[n], log_w[n])
