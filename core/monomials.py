"""Monomials up to a total degree: the basis of compiled rows (`core.response`) and of trends.

Of d variables z, scaled to [-1, 1]^d, and total degree p there are M = C(d + p, p) of them,

    z^e = prod_j z_j^{e_j},    sum_j e_j <= p,

in an order that is the same for all who multiply them by coefficients.
"""

from __future__ import annotations

import sys
from functools import lru_cache
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
NEAR, ROOM = 64, 1 << 16  # points at a time at least, and numbers


@lru_cache(maxsize=64)
def multi_indices(d: int, degree: int) -> NDArray[np.int64]:
    """Exponents of all monomials in `d` variables up to total degree `degree`, shape (M, d).

    Sorted by total degree, then lexicographically; row 0 is the constant.

    >>> multi_indices(2, 2).tolist()
    [[0, 0], [0, 1], [1, 0], [0, 2], [1, 1], [2, 0]]
    """
    chosen = (c for n in range(degree + 1) for c in combinations_with_replacement(range(d), n))
    found = [tuple(c.count(j) for j in range(d)) for c in chosen]
    found.sort(key=lambda e: (sum(e), e))
    table = np.array(found, dtype=np.int64).reshape(len(found), d)
    table.flags.writeable = False
    return table


@lru_cache(maxsize=64)
def _products(d: int, degree: int) -> tuple[NDArray[np.int64], ...]:
    """Of each monomial where it is without its last variable, which this is, and its exponent."""
    table = multi_indices(d, degree)
    place = {tuple(e): i for i, e in enumerate(table.tolist())}
    without, last, exponent = (np.zeros(len(table), dtype=np.int64) for _ in range(3))
    for m, e in enumerate(table.tolist()):
        j = max((i for i in range(d) if e[i]), default=0)
        if m:
            without[m], last[m], exponent[m] = place[(*e[:j], *[0] * (d - j))], j, e[j]
    return without, last, exponent


@lru_cache(maxsize=64)
def _by_last(d: int, degree: int) -> tuple[tuple[NDArray[np.int64], ...], ...]:
    """For each variable the monomials of which it is the last, and what `_products` has of them."""
    without, last, exponent = _products(d, degree)
    own = [np.flatnonzero((last == j) & (exponent > 0)) for j in range(d)]
    return tuple((some, without[some], exponent[some]) for some in own)


def monomials(z: Array, degree: int) -> Array:
    """Every monomial at every point: ``z`` (n, d) → (n, M).

    One product each, from that without its last variable; a compiled function makes them where
    numba is loaded (`core.monomials_compiled`), arrays of points elsewhere, with the same bits.

    >>> monomials(np.array([[2.0, 3.0]]), 2).tolist()
    [[1.0, 3.0, 2.0, 9.0, 6.0, 4.0]]
    """
    n, d = z.shape
    found = np.empty((n, len(multi_indices(d, degree))))
    if "numba" in sys.modules:
        from core.monomials_compiled import fill

        fill(np.array(z, dtype=float, order="C"), degree, *_products(d, degree), found)
    else:
        _in_arrays(z, degree, found)
    return found


def _in_arrays(z: Array, degree: int, found: Array) -> None:
    """Into `found`, so many points at a time that what is read again is still near."""
    (n, d), width = z.shape, found.shape[1]
    near = max(NEAR, ROOM // width)
    for start in range(0, n, near):
        some = z[start : start + near].T
        powers = np.ones((degree + 1, *some.shape))
        for k in range(1, degree + 1):
            powers[k] = powers[k - 1] * some
        out = np.empty((width, some.shape[1]))
        out[0] = 1.0
        for j, (own, without, exponents) in enumerate(_by_last(d, degree)):
            out[own] = out[without] * powers[exponents, j]
        found[start : start + near] = out.T
