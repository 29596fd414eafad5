"""A blade's rows as polynomials of its thin local parameters alone, and log L of them, compiled.

The rows are polynomials of all local parameters (`gather`), whose coefficients go in pairs of
powers of broad and thin ones. At given broad ones f they collapse (`fix_broad`) to polynomials of
the thin ones t,

    y_r(t) = a_r(t) exp(b_r(t)),      polynomials as C = 3 R rows of coefficients (a; b; log v),
    log L(t) = −½ Σ_r (y_r(t) − y_obs,r)² / var_r − ½ Σ_r log var_r,
    var_r(t) = sigma_r² + exp(2 b_r(t) + log v_r(t)) (ka_r² + (a_r(t) kb_r)²).

Which monomial goes where is known beforehand (`collapsed_split`).
"""

from __future__ import annotations

import math

from core.compiled import compiled, contracted


@compiled
def gather(a, b, v, place, factor, pairs):  # type: ignore[no-untyped-def]
    """Fix all but the local inputs: coefficients (R, M) → pairs (3 R, P) of broad × thin powers."""
    rows = a.shape[0]
    pairs[:] = 0.0
    for q in range(place.shape[0]):
        p, scale = place[q], factor[q]
        for r in range(rows):
            pairs[r, p] += a[r, q] * scale
            pairs[rows + r, p] += b[r, q] * scale
            pairs[2 * rows + r, p] += v[r, q] * scale


@compiled
def constant(pairs, flat):  # type: ignore[no-untyped-def]
    """Which polynomials do not depend on any local parameter."""
    for c in range(pairs.shape[0]):
        flat[c] = True
        for p in range(1, pairs.shape[1]):
            if pairs[c, p] != 0.0:
                flat[c] = False
                break


@compiled
def raise_powers(x, parent, var, out):  # type: ignore[no-untyped-def]
    """All monomials of x, each from a lower one: out[q] = out[parent[q]] · x[var[q]]."""
    out[0] = 1.0
    for q in range(1, out.shape[0]):
        out[q] = out[parent[q]] * x[var[q]]


@contracted
def fix_broad(pairs, starts, flat, z, out):  # type: ignore[no-untyped-def]
    """Coefficients in t at given broad parameters: (C, P) and monomials z (F,) → out (C, T)."""
    for c in range(pairs.shape[0]):
        if flat[c]:
            out[c, 0] = pairs[c, 0]
            continue
        for q in range(out.shape[1]):
            first = starts[q]
            total = 0.0
            for i in range(starts[q + 1] - first):
                total += pairs[c, first + i] * z[i]
            out[c, q] = total


@contracted
def rows_at(coef, flat, z, out):  # type: ignore[no-untyped-def]
    """Every polynomial of coef (C, T) at monomials z (T,)."""
    for c in range(coef.shape[0]):
        total = coef[c, 0] * z[0]
        if not flat[c]:
            for q in range(1, z.shape[0]):
                total += coef[c, q] * z[q]
        out[c] = total


@compiled
def log_likelihood(value, y, s2, ka2, kb2):  # type: ignore[no-untyped-def]
    """−½ Σ ((y_r − y_obs,r)² / var_r + log var_r) from the polynomials' values (3 R,)."""
    rows, total = y.shape[0], 0.0
    for r in range(rows):
        e = math.exp(min(value[rows + r], 300.0))
        var = s2[r]
        if ka2[r] > 0.0 or kb2[r] > 0.0:
            scale = ka2[r] + value[r] * value[r] * kb2[r]
            var += e * e * math.exp(min(value[2 * rows + r], 50.0)) * scale
        d = value[r] * e - y[r]
        total -= 0.5 * (d * d / var + math.log(var))
    return total
