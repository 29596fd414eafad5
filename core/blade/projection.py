"""Fields at Gauss points as fields at nodes.

Both projections use the trilinear functions L_i of the element corners, because the serendipity
corner functions have negative integrals; a mid-edge node takes the mean of its two corners.

    positive     v_i = sum_g L_i V f / sum_g L_i V       a weighted mean of the points around it
    consistent   sum_j (sum_g L_i L_j V) v_j = sum_g L_i V f      exact for trilinear fields

The weighted mean keeps a positive field positive and is used for CEEQ and damage, which span
many decades and are fitted in logarithms; where a field falls steeply through the wall it is
smoothed. Stress is nearly linear in an element and is projected consistently, component by
component.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from core.blade.element import EDGES, Array, gauss, trilinear
from core.blade.geometry import BladeMesh
from core.errors import InputError


class Projection:
    """The projections of one mesh; `volume` (G,) mm³ are the weights of its order³ points."""

    def __init__(self, mesh: BladeMesh, volume: Array, order: int) -> None:
        cells, each = mesh.cells, order**3
        corner = trilinear(gauss(order)[0])
        self._corners, flat = np.unique(cells[:, :8], return_inverse=True)
        at = flat.reshape(-1, 8)
        weight = np.einsum("ep,pi->eip", volume.reshape(-1, each), corner)
        column = np.arange(volume.size).reshape(-1, 1, each) + np.zeros((1, 8, 1), dtype=np.int64)
        row = np.repeat(at[:, :, None], each, axis=2)
        self._sum = sparse.csr_matrix(
            (weight.ravel(), (row.ravel(), column.ravel())),
            shape=(len(self._corners), volume.size),
        )
        mass = np.einsum("eip,pj->eij", weight, corner)
        index = (np.repeat(at, 8, axis=1).ravel(), np.tile(at, (1, 8)).ravel())
        matrix = sparse.csc_matrix((mass.ravel(), index))
        self._lumped = np.asarray(matrix.sum(axis=1)).ravel()
        self._solve = splu(matrix).solve
        self._nodes = len(mesh.points)
        self._middle, first = np.unique(cells[:, 8:], return_index=True)
        ends = np.array(EDGES)
        self._ends = cells[:, ends].reshape(-1, 2)[first]

    def positive(self, values: Array) -> Array:
        """(G, m) as (N, m): positive stays positive, a constant stays itself."""
        return self._fill((self._sum @ self._columns(values)) / self._lumped[:, None])

    def consistent(self, values: Array) -> Array:
        """(G, m) as (N, m): trilinear fields are kept exactly; overshoots near steep fronts."""
        return self._fill(self._solve(self._sum @ self._columns(values)))

    def _columns(self, values: Array) -> Array:
        if values.ndim != 2 or len(values) != self._sum.shape[1]:
            raise InputError(
                "values",
                np.shape(values),
                f"is not ({self._sum.shape[1]}, m)",
                "give one row per Gauss point",
            )
        return values

    def _fill(self, corners: Array) -> Array:
        out = np.empty((self._nodes, corners.shape[1]))
        out[self._corners] = corners
        out[self._middle] = out[self._ends].mean(axis=1)
        return out
