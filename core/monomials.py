"""Monomials up to a total degree: the basis of compiled rows (`core.response`) and of trends.

Of d variables z, scaled to [-1, 1]^d, and total degree p there are M = C(d + p, p) of them,

    z^e = prod_j z_j^{e_j},    sum_j e_j <= p,

in an order that is the same for all who multiply them by coefficients.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
NEAR = 128  # points at a time


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
def _by_last(d: int, degree: int) -> tuple[tuple[NDArray[np.int64], ...], ...]:
    """For each variable j the monomials of which it is the last, where each of them is without it,
    and its exponents."""
    table = multi_indices(d, degree)
    place = {tuple(e): i for i, e in enumerate(table.tolist())}
    steps = []
    for j in range(d):
        own = np.flatnonzero((table[:, j] > 0) & ~np.any(table[:, j + 1 :] > 0, axis=1))
        without = [place[tuple(e[:j] + [0] * (d - j))] for e in table[own].tolist()]
        steps.append((own, np.array(without, dtype=np.int64), table[own, j]))
    return tuple(steps)


def monomials(z: Array, degree: int) -> Array:
    """Every monomial at every point: ``z`` (n, d) → (n, M).

    One product each, from that without its last variable; some points at a time, for there are
    hundreds of monomials and what is read again should still be near.

    >>> monomials(np.array([[2.0, 3.0]]), 2).tolist()
    [[1.0, 3.0, 2.0, 9.0, 6.0, 4.0]]
    """
    n, d = z.shape
    found = np.empty((n, len(multi_indices(d, degree))))
    for start in range(0, n, NEAR):
        some = z[start : start + NEAR].T
        powers = np.ones((degree + 1, *some.shape))
        for k in range(1, degree + 1):
            powers[k] = powers[k - 1] * some
        out = np.ones((found.shape[1], some.shape[1]))
        for j, (own, without, exponents) in enumerate(_by_last(d, degree)):
            out[own] = out[without] * powers[exponents, j]
        found[start : start + NEAR] = out.T
    return found
