"""Products of monomials without the interpreter's lock, for processes that calibrate.

Every product is one multiplication as in `core.monomials`, so its results are the same to the last
bit. It is taken where numba is loaded already: a process that only serves does without it.
"""

from __future__ import annotations

import numpy as np

from core.compiled import compiled

LANES = 8  # points at a time


@compiled
def fill(z, degree, without, last, exponent, found):  # type: ignore[no-untyped-def]
    """Monomials at points z (n, d), into found (n, M).

    The m-th, m ≥ 1, is that at `without` times the `exponent` of its `last` variable, (M,) each.
    """
    n, d = z.shape
    some = np.ones((len(without), LANES))
    power = np.ones((d, max(degree, 1) + 1, LANES))
    for start in range(0, n, LANES):
        count = min(LANES, n - start)
        for j in range(d):
            for i in range(count):
                power[j, 1, i] = z[start + i, j]
            for k in range(2, degree + 1):
                for i in range(LANES):
                    power[j, k, i] = power[j, k - 1, i] * power[j, 1, i]
        for m in range(1, len(without)):
            a, j, k = without[m], last[m], exponent[m]
            for i in range(LANES):
                some[m, i] = some[a, i] * power[j, k, i]
        for i in range(count):
            for m in range(len(without)):
                found[start + i, m] = some[m, i]
