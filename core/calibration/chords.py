"""Draws of one parameter from a log density known at some places: chords between them; 16 in step.

Between two places h apart, with log values f and f + d, the density is exp of the chord. Its mass,
and the place at the quantile u inside the cell as a share of h, are

    h exp(f) (exp(d) − 1) / d,      t = log(1 + u (exp(d) − 1)) / d.

A cell is picked in proportion to its mass (``pick``) and a place inside it from its chord
(``along``), both by one number: the map from [0, 1] is the inverse of the distribution function.
Values are by place and lane, masses by cell and lane.
"""

from __future__ import annotations

import math

from core.calibration.vector import fast_exp
from core.compiled import compiled


@compiled
def chords(edge, count, i, h, mass):  # type: ignore[no-untyped-def]
    """Masses of exp(chord) between `count` + 1 even values of lane i; (log of their sum, peak)."""
    peak = edge[0, i]
    for q in range(1, count + 1):
        peak = max(peak, edge[q, i])
    total, before = 0.0, fast_exp(edge[0, i] - peak)
    for q in range(count):
        after, d = fast_exp(edge[q + 1, i] - peak), edge[q + 1, i] - edge[q, i]
        mass[q, i] = h * ((after - before) / d if abs(d) > 1e-6 else before)
        total += mass[q, i]
        before = after
    return math.log(total) + peak


@compiled
def uneven_chords(at, edge, count, i, mass):  # type: ignore[no-untyped-def]
    """`chords` between `count` + 1 places at[:, i]."""
    peak = edge[0, i]
    for q in range(1, count + 1):
        peak = max(peak, edge[q, i])
    total = 0.0
    for q in range(count):
        before, after = math.exp(edge[q, i] - peak), math.exp(edge[q + 1, i] - peak)
        d, h = edge[q + 1, i] - edge[q, i], at[q + 1, i] - at[q, i]
        mass[q, i] = h * ((after - before) / d if abs(d) > 1e-6 else before)
        total += mass[q, i]
    return math.log(total) + peak


@compiled
def pick(mass, count, i, u):  # type: ignore[no-untyped-def]
    """The cell of lane i that holds the quantile u of mass (cells, LANES), and u's place in it."""
    total = 0.0
    for q in range(count):
        total += mass[q, i]
    left = u * total
    for q in range(count):
        if left <= mass[q, i]:
            return q, left / (mass[q, i] + 1e-300)
        left -= mass[q, i]
    return count - 1, 1.0


@compiled
def along(edge, cell, i, u):  # type: ignore[no-untyped-def]
    """A draw inside a cell under its chord: (place in the cell 0 … 1, log value there)."""
    d = edge[cell + 1, i] - edge[cell, i]
    if abs(d) <= 1e-6:
        t = u
    elif d > 0.0:  # from the high end, so that exp() stays below 1
        t = 1.0 + math.log1p(u * math.expm1(-d)) / d
    else:
        t = math.log1p(u * math.expm1(d)) / d
    return t, edge[cell, i] + d * t
