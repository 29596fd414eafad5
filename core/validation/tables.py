"""Polynomial rows as tables for any array module: powers of some inputs by monomials of others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.monomials import multi_indices
from core.response import Response

Array = NDArray[np.float64]


def powers(jnp: Any, z: Any, n: int) -> Any:
    """1, z, …, z^(n−1) along a new last axis."""
    out = [jnp.ones_like(z)]
    for _ in range(n - 1):
        out.append(out[-1] * z)
    return jnp.stack(out, axis=-1)


def products(jnp: Any, z: Any, exponents: NDArray[np.int64]) -> Any:
    """Products of powers: z (n, d), exponents (M, d) → (n, M), by matrices of 0 and 1."""
    degree = int(exponents.max())
    out = 1.0
    for j in range(exponents.shape[1]):
        choice = np.eye(degree + 1)[:, exponents[:, j]]
        out = out * (powers(jnp, z[:, j], degree + 1) @ choice)
    return out


def split(response: Response, outer: Sequence[int], inner: Sequence[int]) -> Array:
    """Rows as tables (R, 3, p + 1, …, M): powers of the inputs `outer`, monomials of `inner`.

    Together these are all inputs. The three are a, b and log v.
    """
    exponents = multi_indices(len(response.names), response.degree)
    local = multi_indices(len(inner), response.degree).tolist()
    where = np.array([local.index(e) for e in exponents[:, list(inner)].tolist()])
    out = np.zeros((len(response), 3, *[response.degree + 1] * len(outer), len(local)))
    place = (*exponents[:, list(outer)].T, where)
    for r in range(len(response)):
        for k, c in enumerate((response.a[r], response.b[r], response.log_v[r])):
            out[r, k][place] = c
    return out
