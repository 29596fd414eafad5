"""The 20-node serendipity hexahedron in VTK order.

Corners (xi_i = ±1):     N_i = (1 + xi xi_i)(1 + eta eta_i)(1 + zeta zeta_i)
                               (xi xi_i + eta eta_i + zeta zeta_i - 2) / 8
Mid-edges (one xi_i = 0): N_i = (1 - xi²)(1 + eta eta_i)(1 + zeta zeta_i) / 4, and cyclic.

Reference: Zienkiewicz & Taylor, *The Finite Element Method*, vol. 1. Integrals of the corner
functions are negative, so nodal fields are projected with the trilinear functions of the
corners instead (:func:`trilinear`).
"""

from __future__ import annotations

from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Index: TypeAlias = NDArray[np.int64]

_C = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
_RING = [(0, -1), (1, 0), (0, 1), (-1, 0)]
NODES = np.array(
    [(a, b, z) for z in (-1, 1) for a, b in _C]
    + [(a, b, z) for z in (-1, 1) for a, b in _RING]
    + [(a, b, 0) for a, b in _C],
    dtype=np.float64,
)
"""Local coordinates of the nodes, shape (20, 3), in the order of VTK and meshio."""

EDGES: tuple[tuple[int, int], ...] = (
    *pairwise((0, 1, 2, 3, 0)),
    *pairwise((4, 5, 6, 7, 4)),
    *((i, i + 4) for i in range(4)),
)
"""The two corners of each mid-edge node 8 … 19."""


def shape(points: Array) -> tuple[Array, Array]:
    """Values (P, 20) and local gradients (P, 20, 3) at local points (P, 3).

    >>> value, gradient = shape(np.array([[0.3, -0.2, 0.7]]))
    >>> bool(abs(value.sum() - 1) < 1e-14 and abs(gradient.sum()) < 1e-14)
    True
    """
    x = np.asarray(points, dtype=np.float64)[:, None, :]
    one = 1 + x * NODES  # (P, 20, 3)
    value = np.empty(one.shape[:2])
    gradient = np.empty(one.shape)
    corner = slice(0, 8)
    product = one[:, corner].prod(axis=2)
    bracket = (x * NODES[corner]).sum(axis=2) - 2
    value[:, corner] = product * bracket / 8
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        rest = one[:, corner, b] * one[:, corner, c]
        gradient[:, corner, a] = NODES[corner, a] * (rest * bracket + product) / 8
        mid = np.flatnonzero(NODES[:, a] == 0)
        bubble = 1 - x[:, :, a] ** 2
        value[:, mid] = bubble * one[:, mid, b] * one[:, mid, c] / 4
        gradient[:, mid, a] = -x[:, :, a] * one[:, mid, b] * one[:, mid, c] / 2
        gradient[:, mid, b] = bubble * NODES[mid, b] * one[:, mid, c] / 4
        gradient[:, mid, c] = bubble * NODES[mid, c] * one[:, mid, b] / 4
    return value, gradient


def trilinear(points: Array) -> Array:
    """Values (P, 8) of the corner functions (1 ± xi)(1 ± eta)(1 ± zeta)/8: never negative inside.

    >>> trilinear(np.array([[1.0, -1.0, 1.0]])).argmax()
    np.int64(5)
    """
    x = np.asarray(points, dtype=np.float64)[:, None, :]
    values: Array = (1 + x * NODES[:8]).prod(axis=2) / 8
    return values


def gauss(n: int, dimensions: int = 3) -> tuple[Array, Array]:
    """Gauss-Legendre points (n^d, d) and weights (n^d,) on [-1, 1]^d."""
    x, w = np.polynomial.legendre.leggauss(n)
    grid = np.meshgrid(*[x] * dimensions, indexing="ij")
    weights = np.meshgrid(*[w] * dimensions, indexing="ij")
    return (
        np.stack([g.ravel() for g in grid], axis=1),
        np.prod(np.stack([g.ravel() for g in weights]), axis=0),
    )


def face_points(axis: int, side: int, n: int = 3) -> tuple[Array, Array, tuple[int, int]]:
    """Gauss points on the face where local coordinate `axis` is `side`: points, weights, tangents.

    The cross product of the two tangents points outwards for side = +1 and axis order (b, c).
    """
    flat, weights = gauss(n, 2)
    b, c = (axis + 1) % 3, (axis + 2) % 3
    points = np.full((len(flat), 3), float(side))
    points[:, b], points[:, c] = flat[:, 0], flat[:, 1]
    return points, weights, (b, c)
