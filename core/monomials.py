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


def monomials(z: Array, degree: int) -> Array:
    """Every monomial at every point: ``z`` (n, d) → (n, M).

    >>> monomials(np.array([[2.0, 3.0]]), 2).tolist()
    [[1.0, 3.0, 2.0, 9.0, 6.0, 4.0]]
    """
    n, d = z.shape
    powers = np.ones((degree + 1, n, d))
    for k in range(1, degree + 1):
        powers[k] = powers[k - 1] * z
    table = multi_indices(d, degree)
    out = np.ones((len(table), n))
    for j in range(d):
        out *= powers[table[:, j], :, j]
    return np.ascontiguousarray(out.T)
