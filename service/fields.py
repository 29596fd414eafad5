"""A quantity on a model's whole mesh at one instant, and the mesh's surface.

With particles (psi_i, w_i) of a blade's posterior, the surrogate's mean Y_i and standard deviation
s_i at a node, and the discrepancy's gain g_i, offset o_i and own spread, the field is the blade's
own, without the noise of a reading (`core.prediction`):

    mean   = Σ w_i (g_i Y_i + o_i)
    sd²    = Var_w(g_i Y_i + o_i) + Σ w_i (g_i s_i)² + sigma_delta² + Σ w_i (left g_i Y_i)²

Thousands of particles times thousands of nodes times three directions would fill a gigabyte, so
`ENOUGH` equally weighted ones are drawn by systematic resampling from a fixed stream and summed in
blocks: the mean errs by 0.04 sd at most, the sd by 3 %. Where inputs run in time most of these are
told by some that are followed (`core.surrogate.nearby`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from core.answers import Answers
from core.blade.element import NODES
from core.blade.geometry import MESHES, build_mesh
from core.calibration.state import Posterior
from core.curves import corrected, inputs_of
from core.model import Model
from core.surrogate.driven import Driven
from core.surrogate.nearby import Block, nearby
from service.ports import Field, Mesh, Surface

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Cells = tuple[str, Index]
ENOUGH = 512
BLOCK = 64


def _ring(axis: int, side: int) -> list[int]:
    """The eight nodes of a face, a corner first, counter-clockwise as seen from outside."""
    face = np.flatnonzero(NODES[:, axis] == side)
    along, across = NODES[face, (axis + 1) % 3], NODES[face, (axis + 2) % 3]
    angle = np.round((side * np.arctan2(across, along) - np.pi / 4) / (np.pi / 4)) % 8
    return [int(node) for node in face[np.argsort(angle)]]


RINGS = np.array([_ring(axis, side) for axis in range(3) for side in (-1, 1)])
# corners and middles alternate around a face: cut off each corner, halve the square that is left
CUT = np.array([(7, 0, 1), (1, 2, 3), (3, 4, 5), (5, 6, 7), (7, 1, 3), (7, 3, 5)])


def skin(points: Array, cells: Index) -> Surface:
    """The faces of 20-node elements that no other element shares, each as six triangles.

    points (N, 3), cells (E, 20) in VTK order.

    >>> mesh = build_mesh((4, 1, 2))
    >>> len(skin(mesh.points, mesh.cells).triangles) == 6 * (2 * 4 * 2 + 2 * 4)
    True
    """
    faces = cells[:, RINGS].reshape(-1, 8)
    same = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    outer = faces[np.sort(same[1][same[2] == 1])]
    return Surface(points, outer[:, CUT].reshape(-1, 3))


def mesh_of(points: Array | None, mesh: str | None, cells: Cells | None = None) -> Mesh | None:
    """The mesh of a model: one of the blade's, or a user's own; None: nodes without places.

    cells  kind and node numbers of a user's mesh; None: its nodes alone are drawn
    """
    if points is None or not len(points) or not np.all(np.isfinite(points)):
        return None
    if mesh not in MESHES:
        kind, corners = cells or ("vertex", np.arange(len(points))[:, None])
        return Mesh(points, corners, kind, own=True)
    built = build_mesh(mesh)
    same = built.points.shape == points.shape and np.allclose(built.points, points, atol=1e-6)
    return Mesh(built.points, built.cells, "hexahedron20") if same else None


def surface_of(points: Array | None, mesh: str | None) -> Surface | None:
    """The surface of a mesh of the blade; None: it is on no such mesh."""
    found = mesh_of(points, mesh) if mesh in MESHES else None
    return None if found is None else skin(found.points, found.cells)


def field_of(
    model: Model,
    posterior: Posterior,
    quantity: str,
    time_h: float,
    known: Mapping[str, float] | None,
    nodes: Sequence[int] | None = None,
) -> Field:
    """The field of a blade at an hour inside the model's horizon; at `nodes` (default: at all)."""
    declared, surrogate = model.network.quantity(quantity), model.part(quantity)
    places = range(surrogate.node_count) if nodes is None else nodes
    thin = posterior
    if len(posterior.particles.log_w) > ENOUGH:
        drawn = posterior.particles.resampled(ENOUGH, np.random.default_rng(0))
        thin = Posterior(posterior.names, drawn)
    w, time = thin.particles.w, np.array([time_h])
    x = inputs_of(model, thin, quantity, known)
    parts = [
        corrected(model, thin, declared, time, component, None)
        for component in ((0, 1, 2) if declared.kind == "vector" else (None,))
    ]
    gain, offset, sigma, left = (
        np.stack([part[i] for part in parts], axis=-1)[..., 0, :] for i in range(4)
    )
    # a particle says g Y + o ± sqrt(g² s² + (nu g Y)² + (left g Y)²): summed are Y, Y² and s²
    share = w[:, None] * gain
    square = share * gain
    swollen = square * (1.0 + declared.numerical**2 + left**2)
    sums: list[Array] = []
    for block, y, sd in _blocks(surrogate, x, quantity, time, places):
        y, sd = (part.reshape(len(y), len(places), len(parts)) for part in (y, sd))
        o = offset[block]

        def over(weights: Array, values: Array) -> Array:
            return np.asarray(np.einsum("ik,ijk->jk", weights, values), float)

        first = over(share[block], y) + w[block] @ o
        twice = over(2.0 * share[block] * o, y) + w[block] @ o**2 if o.any() else 0.0
        np.square(y, out=y)
        np.square(sd, out=sd)
        sums.append(np.stack([first, twice + over(swollen[block], y) + over(square[block], sd)]))
    mean, second = np.sum(sums, axis=0)
    deviation = np.sqrt(np.maximum(second - mean**2, 0.0) + sigma**2)
    if declared.kind == "field":
        mean, deviation = mean[:, 0], deviation[:, 0]
    return Field(mean, deviation, len(w))


def _blocks(
    surrogate: Answers, x: Array, quantity: str, time: Array, places: Sequence[int]
) -> Iterator[Block]:
    """Answers of `BLOCK` particles at a time: all of a field's at once take gigabytes.

    To follow thousands of nodes under inputs that run is dear: most are told by some of them.
    """
    if isinstance(surrogate, Driven):
        followed = partial(surrogate.in_blocks, quantity=quantity, times=time, nodes=places)
        yield from nearby(x, partial(followed, size=BLOCK), BLOCK)
        return
    for start in range(0, len(x), BLOCK):
        which = np.arange(start, min(start + BLOCK, len(x)))
        yield which, *surrogate.predict(x[which], quantity, time, places)
