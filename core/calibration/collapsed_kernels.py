"""Compiled parts of `collapsed`: likelihoods of many local parameters, and the thin ones drawn.

The local parameters are split into broad ones f, given, and thin ones t. At each f the rows
collapse to polynomials of t (`collapsed_rows`), whose bell in t is found by Gauss–Newton steps
inside the box [−1, 1] and drawn from coordinate by coordinate, each a normal cut at the box
(`cut_normal`; the sampler of Geweke, Hajivassiliou and Keane). Where the mode sits at a bound with
the slope pointing outwards, that coordinate is drawn first, with the slope and curvature of its
profile; the others follow given it. The weight L / q(t) is exact and nearly constant where the bell
is nearly normal.
"""

from __future__ import annotations

import math

import numpy as np

from core.calibration.collapsed_rows import (
    constant,
    fix_broad,
    gather,
    log_likelihood,
    raise_powers,
    rows_at,
)
from core.calibration.cut_normal import cut_normal
from core.compiled import compiled

WIDER = 1.1  # draws are a little wider than the bell, so that weights stay bounded
RIDGE = 0.1  # curvature of a direction that no row sees: wider than the box


@compiled
def slopes(coef, flat, t, tables, y, s2, ka2, kb2, z, dz, value, turn, move, g, h):  # type: ignore[no-untyped-def]
    """log L at t; fills its slope g (D,) and Gauss–Newton curvature h (D, D)."""
    parent, var, exponent, down = tables
    rows, d = y.shape[0], t.shape[0]
    raise_powers(t, parent, var, z)
    rows_at(coef, flat, z, value)
    for j in range(d):
        for q in range(z.shape[0]):
            dz[q] = exponent[q, j] * z[down[q, j]]
        rows_at(coef, flat, dz, turn)
        for r in range(rows):
            e = math.exp(min(value[rows + r], 300.0))
            move[r, j] = (turn[r] + value[r] * turn[rows + r]) * e
    g[:] = 0.0
    h[:] = 0.0
    for r in range(rows):
        e = math.exp(min(value[rows + r], 300.0))
        scale = ka2[r] + value[r] * value[r] * kb2[r]
        variance = s2[r] + e * e * math.exp(min(value[2 * rows + r], 50.0)) * scale
        miss = value[r] * e - y[r]
        for i in range(d):
            g[i] -= miss * move[r, i] / variance
            for j in range(i + 1):
                h[i, j] += move[r, i] * move[r, j] / variance
    for i in range(d):
        h[i, i] += RIDGE
        for j in range(i):
            h[j, i] = h[i, j]
    return log_likelihood(value, y, s2, ka2, kb2)


@compiled
def factorise(h, order, root):  # type: ignore[no-untyped-def]
    """Lower Cholesky factor of h in the given order of its coordinates."""
    for i in range(order.shape[0]):
        for j in range(i + 1):
            total = h[order[i], order[j]]
            for k in range(j):
                total -= root[i, k] * root[j, k]
            if i == j:
                root[i, i] = math.sqrt(max(total, 1e-3 * RIDGE))
            else:
                root[i, j] = total / root[j, j]


@compiled
def ordered(t, g, order):  # type: ignore[no-untyped-def]
    """Coordinates inside the box first, then those held by a bound; how many are inside."""
    inside, last = 0, t.shape[0]
    for j in range(t.shape[0]):
        if (t[j] >= 1.0 and g[j] > 0.0) or (t[j] <= -1.0 and g[j] < 0.0):
            last -= 1
            order[last] = j
        else:
            order[inside] = j
            inside += 1
    return inside


@compiled
def bell(coef, flat, t, tables, y, s2, ka2, kb2, work, g, h, order, root):  # type: ignore[no-untyped-def]
    """Mode inside the box from the start t (changed), its slope, curvature and their factor.

    Returns how many coordinates no bound holds; they come first in `order`, and in `root`.
    """
    z, dz, value, turn, move = work
    d = t.shape[0]
    best = slopes(coef, flat, t, tables, y, s2, ka2, kb2, z, dz, value, turn, move, g, h)
    step, old = np.zeros(d), np.empty(d)
    for _ in range(40):
        inside = ordered(t, g, order)
        factorise(h, order, root)
        for i in range(inside):
            total = g[order[i]]
            for k in range(i):
                total -= root[i, k] * step[k]
            step[i] = total / root[i, i]
        longest = 0.0
        for i in range(inside - 1, -1, -1):
            for k in range(i + 1, inside):
                step[i] -= root[k, i] * step[k]
            step[i] /= root[i, i]
            longest = max(longest, abs(step[i]))
        shrink = min(1.0, 0.5 / max(longest, 1e-300))
        old[:] = t
        gain = 0.0
        for i in range(inside):
            j = order[i]
            t[j] = min(max(old[j] + shrink * step[i], -1.0), 1.0)
            gain += g[j] * (t[j] - old[j])
        if gain < 2e-3:  # nats still to win: the draws' centre holds the last step anyway
            t[:] = old
            break
        now = slopes(coef, flat, t, tables, y, s2, ka2, kb2, z, dz, value, turn, move, g, h)
        halved = 0
        while now < best - 0.01 and halved < 12:
            for j in range(d):
                t[j] = old[j] + 0.4 * (t[j] - old[j])
            now = slopes(coef, flat, t, tables, y, s2, ka2, kb2, z, dz, value, turn, move, g, h)
            halved += 1
        best = now
    inside = ordered(t, g, order)
    factorise(h, order, root)
    return inside


@compiled
def draw_bell(t, g, order, inside, root, u, out):  # type: ignore[no-untyped-def]
    """A draw of the bell cut at the box into out (D,), from uniforms u (D,): its log density."""
    d = t.shape[0]
    w, moved = np.empty(d), np.zeros(d)
    total = 0.0
    for i in range(d):  # root⁻¹ g: the slope of each profile, once those before have adapted
        left = g[order[i]]
        for k in range(min(i, inside)):
            left -= root[i, k] * w[k]
        w[i] = left / root[i, i] if i < inside else left
    for i in range(inside, d):
        slope, bend = w[i], 0.0
        for k in range(inside, i + 1):
            bend += root[i, k] * root[i, k]
        for j in range(inside, i):
            pull = 0.0
            for k in range(inside, j + 1):
                pull += root[i, k] * root[j, k]
            slope -= pull * moved[j]
        j = order[i]
        x, log_q = cut_normal(t[j] + slope / bend, WIDER / math.sqrt(bend), -1.0, 1.0, u[i])
        moved[i] = x - t[j]
        out[j] = x
        total += log_q
    for i in range(inside - 1, -1, -1):
        left = w[i]
        for k in range(i + 1, d):
            left -= root[k, i] * moved[k]
        j = order[i]
        x, log_q = cut_normal(t[j] + left / root[i, i], WIDER / root[i, i], -1.0, 1.0, u[i])
        moved[i] = x - t[j]
        out[j] = x
        total += log_q
    return total


@compiled
def weigh(a, b, v, factors, y, s2, ka2, kb2, place, starts, rise, tables, f, u, t, log_w):  # type: ignore[no-untyped-def] # fmt: skip
    """Thin parameters drawn at given broad ones, at K values of the shared parameters.

    f (K, n, F) broad parameters, u (K, n, D) uniforms; fills t (K, n, D) and log_w (K, n), the
    log of L / q(t). place (M,) of each monomial among the pairs, starts (T + 1,) of the pairs of
    each thin monomial; `rise` and `tables` build the monomials of f and of t.
    """
    rows, d = a.shape[0], t.shape[2]
    powers = tables[0].shape[0]
    pairs, coef = np.empty((3 * rows, starts[powers])), np.zeros((3 * rows, powers))
    flat = np.empty(3 * rows, dtype=np.bool_)
    zf = np.empty(rise[0].shape[0])
    z, dz, value, turn = np.empty(powers), np.empty(powers), np.empty(3 * rows), np.empty(3 * rows)
    work = (z, dz, value, turn, np.empty((rows, d)))
    g, h, root = np.empty(d), np.empty((d, d)), np.zeros((d, d))
    order, mode = np.empty(d, dtype=np.int64), np.zeros(d)
    begin = np.zeros((f.shape[1], d))
    for k in range(factors.shape[0]):
        gather(a, b, v, place, factors[k], pairs)
        constant(pairs, flat)
        inside = 0
        for i in range(f.shape[1]):
            if i == 0 or f.shape[2] > 0:
                raise_powers(f[k, i], rise[0], rise[1], zf)
                fix_broad(pairs, starts, flat, zf, coef)
                mode[:] = begin[i]  # of the node before, which mostly has the same f
                inside = bell(
                    coef, flat, mode, tables, y[k], s2[k], ka2, kb2, work, g, h, order, root
                )
                begin[i] = mode
            log_q = draw_bell(mode, g, order, inside, root, u[k, i], t[k, i])
            raise_powers(t[k, i], tables[0], tables[1], z)
            rows_at(coef, flat, z, value)
            log_w[k, i] = log_likelihood(value, y[k], s2[k], ka2, kb2) - log_q


@compiled
def curvatures(a, b, v, factors, y, s2, ka2, kb2, place, starts, rise, tables, mode, h):  # type: ignore[no-untyped-def] # fmt: skip
    """Mode (K, L) and Gauss–Newton curvature (K, L, L) of all local parameters together."""
    rows, d = a.shape[0], mode.shape[1]
    powers = tables[0].shape[0]
    pairs, coef = np.empty((3 * rows, starts[powers])), np.zeros((3 * rows, powers))
    flat = np.empty(3 * rows, dtype=np.bool_)
    value, turn = np.empty(3 * rows), np.empty(3 * rows)
    work = (np.empty(powers), np.empty(powers), value, turn, np.empty((rows, d)))
    g, root, order = np.empty(d), np.zeros((d, d)), np.empty(d, dtype=np.int64)
    zf = np.ones(1)
    for k in range(factors.shape[0]):
        gather(a, b, v, place, factors[k], pairs)
        constant(pairs, flat)
        fix_broad(pairs, starts, flat, zf, coef)
        bell(coef, flat, mode[k], tables, y[k], s2[k], ka2, kb2, work, g, h[k], order, root)
