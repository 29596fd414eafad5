"""Which kind of cells a user's mesh has, by the names of meshio and in VTK's order of nodes.

The file says it (attribute ``kind`` of ``cells``), or the number of corners does. Where that leaves
two kinds the places of the nodes tell them apart, by the median over the cells:

    8   hexahedron or quad8      quad8 has node 4 in the middle between nodes 0 and 1
    6   wedge or triangle6       triangle6 has node 3 there
    4   tetra or quad            a quad's four nodes lie in a plane, but for its warp

Of cells of no kind that is known the nodes alone are drawn.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

CORNERS = {
    "vertex": 1, "line": 2, "triangle": 3, "tetra": 4, "quad": 4, "pyramid": 5, "wedge": 6,
    "triangle6": 6, "hexahedron": 8, "quad8": 8, "tetra10": 10, "hexahedron20": 20,
}  # fmt: skip
FROM_MESHIO = {"wedge": [0, 2, 1, 3, 5, 4]}  # whose order it has turned
MIDDLE = {6: (3, "triangle6", "wedge"), 8: (4, "quad8", "hexahedron")}
WARP = 0.05  # |det| of three edges over the product of their lengths

Cells = NDArray[np.integer[Any]]


def kind_of(cells: Cells, points: NDArray[np.float64]) -> str:
    """The kind of cells (E, n) by their corners and places; "": none that is known.

    >>> cube = np.array([[x, y, z] for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))])
    >>> kind_of(np.arange(8)[None], cube), kind_of(np.array([[0, 1, 2, 3]]), cube)
    ('hexahedron', 'quad')
    >>> kind_of(np.array([[0, 1, 3, 4]]), cube), kind_of(np.arange(7)[None], cube)
    ('tetra', '')
    """
    kinds = [kind for kind, count in CORNERS.items() if count == cells.shape[1]]
    if len(kinds) < 2 or not len(cells):
        return kinds[0] if kinds and len(cells) else ""
    at = np.asarray(points, float)[cells]
    edge = at[:, 1] - at[:, 0]
    length = np.linalg.norm(edge, axis=1)
    if cells.shape[1] == 4:
        others = at[:, 2:] - at[:, :1]
        product = length * np.prod(np.linalg.norm(others, axis=2), axis=1)
        volume = np.abs(np.einsum("ij,ij->i", edge, np.cross(others[:, 0], others[:, 1])))
        return "tetra" if np.median(volume / np.maximum(product, 1e-300)) > WARP else "quad"
    node, middle, solid = MIDDLE[cells.shape[1]]
    off = np.linalg.norm(at[:, node] - at[:, 0] - 0.5 * edge, axis=1)
    return middle if np.median(off / np.maximum(length, 1e-300)) < 0.25 else solid
