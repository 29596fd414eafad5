"""Integrals of exp(f) along one parameter, panel by panel; 16 of them in step.

f, the log of what the parameters further in leave, is smooth between the places where a mode meets
a bound, and close to a parabola where nothing does. So not exp(f) but f is taken for a polynomial
on a panel: the one through five Gauss–Legendre points, whose last Legendre coefficient tells how
far it bends away from what polynomials can follow. A panel that matters and bends too much is
split. The last coefficient may be small by chance where f is no polynomial at all: over a panel
with a summit at one end, and another 11 nats lower far off, it was, at 3 of 256 shared values, and
the integral was 5.4 nats too large. So a share `SHY` of the coefficient before it counts as well: a
series that falls off faster than that has to show it on halves. exp of the polynomial is summed at
many points, which costs next to nothing; a normal density over its whole width needs one panel,
where five points of exp(f) itself need four.
"""

from __future__ import annotations

import math

import numpy as np

from core.calibration.vector import LANES, fast_exp
from core.compiled import compiled

POINTS = 5
MOST = 40  # panels that may wait
LEVELS = 4.0  # times that a panel may be split
SHY = 0.1  # of the last Legendre coefficient but one: the last is not believed to be smaller
GL_X, GL_W = np.polynomial.legendre.leggauss(POINTS)
FINE_X, FINE_W = np.polynomial.legendre.leggauss(16)
# (POINTS, POINTS) from values at the points to Legendre coefficients: degree, point
LEGENDRE = np.array(
    [(2 * n + 1) / 2 * GL_W * np.polynomial.legendre.Legendre.basis(n)(GL_X) for n in range(POINTS)]
)
FINE = np.polynomial.legendre.legvander(FINE_X, POINTS - 1) @ LEGENDRE
BUT_ONE, LAST = LEGENDRE[-2], LEGENDRE[-1]
# a waiting panel: lower and upper end, how often it was split
LOWER, UPPER, LEVEL = range(3)


@compiled
def sort_up(x):  # type: ignore[no-untyped-def]
    """Sort a dozen values in place; numpy's sort costs seconds to compile."""
    for i in range(1, len(x)):
        value, j = x[i], i
        while j > 0 and x[j - 1] > value:
            x[j] = x[j - 1]
            j -= 1
        x[j] = value


@compiled
def laid_out(breaks, n, thin, panels, i):  # type: ignore[no-untyped-def]
    """Panels of lane i between the first n breaks, into panels (MOST, 3, LANES); their number.

    breaks[0] and breaks[1] are the ends of the support; panels thinner than the share `thin` of it
    are joined to the next.
    """
    width = breaks[1] - breaks[0]
    sort_up(breaks[:n])
    m = 1
    for q in range(1, n):
        if breaks[q] - breaks[m - 1] > thin * width or q == n - 1:
            breaks[m] = breaks[q]
            m += 1
    for q in range(m - 1):
        panels[q, LOWER, i], panels[q, UPPER, i] = breaks[m - 2 - q], breaks[m - 1 - q]
        panels[q, LEVEL, i] = 0.0
    return m - 1


@compiled
def next_panels(panels, waiting, half, mid):  # type: ignore[no-untyped-def]
    """Half width and middle of each lane's next panel; how many the lane that lags has left."""
    left = 0
    for i in range(LANES):
        left = max(left, waiting[i])
        q = max(waiting[i] - 1, 0)
        half[i] = 0.5 * (panels[q, UPPER, i] - panels[q, LOWER, i])
        mid[i] = 0.5 * (panels[q, UPPER, i] + panels[q, LOWER, i])
    return left


@compiled
def take(f, half, mid, split, panels, waiting, out, peak):  # type: ignore[no-untyped-def]
    """Count each lane's panel, known by f (POINTS, LANES), into its integral exp(peak) out.

    A panel is split instead where its last coefficient [nat] times its share of the integral
    exceeds `split`.
    """
    for i in range(LANES):
        if waiting[i] > 0:
            take_one(f, half, mid, split, panels, waiting, out, peak, i)


@compiled
def take_one(f, half, mid, split, panels, waiting, out, peak, i):  # type: ignore[no-untyped-def]
    """`take` for lane i."""
    top = peak[i]
    for n in range(POINTS):
        top = max(top, f[n, i])
    if top > peak[i]:
        out[i] *= math.exp(peak[i] - top)
        peak[i] = top
    total = last = but_one = 0.0
    for n in range(POINTS):
        last += LAST[n] * f[n, i]
        but_one += BUT_ONE[n] * f[n, i]
    bends = max(abs(last), SHY * abs(but_one))
    for p in range(len(FINE_X)):
        c = -top
        for n in range(POINTS):
            c += FINE[p, n] * f[n, i]
        total += half[i] * FINE_W[p] * fast_exp(min(c, 50.0))
    q = waiting[i] - 1
    level = panels[q, LEVEL, i]
    if bends * total > split * max(out[i], total) and level < LEVELS and q + 2 <= MOST:
        low, high = panels[q, LOWER, i], panels[q, UPPER, i]
        panels[q, LOWER, i], panels[q, UPPER, i], panels[q, LEVEL, i] = mid[i], high, level + 1.0
        panels[q + 1, LOWER, i], panels[q + 1, UPPER, i] = low, mid[i]
        panels[q + 1, LEVEL, i] = level + 1.0
        waiting[i] = q + 2
        return
    if abs(last) > 1.0:  # no polynomial goes through these
        total = 0.0
        for n in range(POINTS):
            total += half[i] * GL_W[n] * math.exp(f[n, i] - top)
    out[i] += total
    waiting[i] = q
