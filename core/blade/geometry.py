"""The blade as a structured mesh of 20-node hexahedra.

A material point has parametric coordinates (c, w, s): c in [0, 1) once around the section from
the trailing edge over the suction side and the leading edge (c = 1/2), w in [0, 1] from the
outer to the inner skin, s in [0, 1] from root to tip. With phi = 2 pi c a section is

    outer   x = a cos(phi),             y = b sin(phi) (1 - n cos(phi)),    max |y| = half thickness
    inner   the same curve with the half chord less `edge_wall`·wall and the half thickness less
            `wall`: a cooled cavity that reaches both edges

bent over the parabolic camber line 4 m x (1 - x), moved to the centroid of the metal, turned by
stagger + twist s, and stacked along z = hub_radius + span s. x is the rotor's axis, z the radius.
Tip and critical points have the same (c, w, s), hence the same place, in every mesh.

Two elements through the wall, not one: creep goes with the sixth power of stress, and two Gauss
points miss how thermal stress relaxes across the wall. At equal numbers of nodes one element errs
0.9 % (centre) to 3.6 % (coolest corner) in the elongation after 50,000 h, two 0.06 and 0.26 %.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np

from core.blade.element import EDGES, NODES, Array, Index, gauss, shape
from core.blade.properties import Geometry
from core.errors import InputError, RangeError

MESHES: dict[str, tuple[int, int, int]] = {
    "coarse": (16, 2, 8),  # 1,536 nodes
    "default": (40, 2, 12),  # 5,600 nodes
    "fine": (48, 3, 16),  # 12,048 nodes
    "paper": (76, 2, 32),  # 27,360 nodes
}
"""Elements around the section, through the wall and along the span, by name."""

NAMED_POINTS: dict[str, tuple[float, float, float]] = {
    "tip": (0.5, 0.0, 1.0),
    "critical": (0.625, 0.0, 0.5),
}


@dataclass(frozen=True, eq=False)
class BladeMesh:
    """Nodes and elements.

    points      (N, 3) mm
    cells       (E, 20) node numbers, VTK order, local axes (c, w, s)
    parametric  (N, 3) coordinates c, w, s of each node
    shape       elements along c, w, s; `closed` if c runs around
    named       node numbers by name
    """

    points: Array
    cells: Index
    parametric: Array
    shape: tuple[int, int, int]
    closed: bool
    named: dict[str, int] = field(default_factory=dict)
    name: str = ""

    def __post_init__(self) -> None:
        volume = jacobians(self.points, self.cells)
        if not np.all(volume > 0):
            bad = np.flatnonzero((volume <= 0).any(axis=1))
            raise InputError(
                "mesh",
                int(bad[0]),
                f"is left-handed or folded: {len(bad)} of {len(self.cells)} elements, this one "
                f"first, have det J = {volume.min():.3g} mm³",
                "order the nodes of each element so that its local axes are right-handed",
            )
        for array in (self.points, self.cells, self.parametric):
            array.setflags(write=False)

    @property
    def element_nodes(self) -> Index:
        """The same as `cells`."""
        return self.cells

    @property
    def volume(self) -> float:
        """Volume of metal in mm³."""
        return float((jacobians(self.points, self.cells) * gauss(3)[1]).sum())

    def face(self, name: str) -> tuple[Index, int, int]:
        """Elements, local axis and side of ``outside | inside | root | tip``."""
        axis, side = {"outside": (1, -1), "inside": (1, 1), "root": (2, -1), "tip": (2, 1)}[name]
        where = np.unravel_index(np.arange(len(self.cells)), self.shape)[axis]
        return np.flatnonzero(where == (0 if side < 0 else self.shape[axis] - 1)), axis, side

    def face_nodes(self, name: str) -> Index:
        """Sorted numbers of the nodes on a face."""
        elements, axis, side = self.face(name)
        return np.unique(self.cells[elements][:, NODES[:, axis] == side])

    def parametric_at(self, elements: Index, local: Array) -> Array:
        """(c, w, s) of local points (P, 3) in each of the elements, shape (len(elements), P, 3)."""
        cell = np.stack(np.unravel_index(elements, self.shape), axis=1)
        return np.asarray((cell[:, None, :] + (local + 1) / 2) / self.shape)

    def locate(self, parametric: Array) -> tuple[Index, Array]:
        """Element and local coordinates (P, 3) of points given by (c, w, s)."""
        at = np.array(parametric, dtype=np.float64)
        if self.closed:
            at[:, 0] %= 1.0
        grid = at * self.shape
        cell = np.clip(np.floor(grid + 1e-9).astype(np.int64), 0, np.array(self.shape) - 1)
        if np.any(np.abs(grid - cell - 0.5) > 0.5 + 1e-6):
            worst = at[np.abs(grid - cell - 0.5).max(axis=1).argmax()]
            raise RangeError(
                "parametric", worst.tolist(), "lies outside the blade", "give c, w, s in [0, 1]"
            )
        return np.ravel_multi_index(tuple(cell.T), self.shape), 2 * (grid - cell) - 1

    def write_vtu(self, path: str | Path, point_data: dict[str, Array] | None = None) -> None:
        """Write the mesh and nodal fields as VTU (hexahedron20), readable by ParaView."""
        for name, values in (point_data or {}).items():
            if len(values) != len(self.points):
                raise InputError(
                    f"point_data[{name!r}]",
                    np.shape(values),
                    f"does not fit {len(self.points)} nodes",
                    "give one row per node",
                )
        import meshio

        meshio.write(
            path,
            meshio.Mesh(self.points, [("hexahedron20", self.cells)], point_data=point_data or {}),
        )


def jacobians(points: Array, cells: Index, order: int = 3) -> Array:
    """det J (E, order³) at the Gauss points: the sign is the handedness."""
    gradient = shape(gauss(order)[0])[1]
    return np.asarray(np.linalg.det(np.einsum("enx,pna->epxa", points[cells], gradient)))


def interpolate(mesh_from: BladeMesh, values: Array, mesh_to: BladeMesh | Array) -> Array:
    """A nodal field of one mesh at the nodes (or given (c, w, s)) of another.

    values (N_from, ...) or (T, N_from, ...) is not guessed: axis 0 is the node. Evaluated with
    the element's own shape functions, so that a field of the element space is reproduced exactly.
    """
    at = mesh_to.parametric if isinstance(mesh_to, BladeMesh) else mesh_to
    if len(values) != len(mesh_from.points):
        raise InputError(
            "values",
            np.shape(values),
            f"does not fit the {len(mesh_from.points)} nodes of mesh_from on axis 0",
            "put the node axis first",
        )
    element, local = mesh_from.locate(at)
    weights = shape(local)[0]
    return np.asarray(np.einsum("pn,pn...->p...", weights, values[mesh_from.cells[element]]))


def lattice(n: tuple[int, int, int], *, closed: bool) -> tuple[Index, Array]:
    """Cells (E, 20) and parametric coordinates (N, 3) of a structured serendipity mesh.

    >>> cells, parametric = lattice((48, 1, 16), closed=True)
    >>> cells.shape, len(parametric)
    ((768, 20), 5616)
    """
    if min(n) < 1 or (closed and n[0] < 3):
        raise InputError("shape", n, "is no mesh", "give at least one element each way, 3 around")
    size = (2 * n[0] + (0 if closed else 1), 2 * n[1] + 1, 2 * n[2] + 1)
    grid = np.stack(np.meshgrid(*map(np.arange, size), indexing="ij"), axis=-1).reshape(-1, 3)
    grid = grid[(grid % 2).sum(axis=1) <= 1]
    # span first, so that neighbours in number are neighbours along the blade
    grid = grid[np.lexsort((grid[:, 1], grid[:, 0], grid[:, 2]))]
    number = np.full(size, -1, dtype=np.int64)
    number[tuple(grid.T)] = np.arange(len(grid))
    base = np.array(list(itertools.product(*map(range, n))))
    local = (NODES + 1).astype(np.int64)
    index = 2 * base[:, None, :] + local
    index[..., 0] %= size[0] if closed else size[0] + 1
    cells = number[tuple(np.moveaxis(index, -1, 0))]
    return cells, grid / (2 * np.array(n, dtype=np.float64))


def build_mesh(
    mesh: str | tuple[int, int, int] = "default", geometry: Geometry | None = None
) -> BladeMesh:
    """The blade's mesh by name (:data:`MESHES`) or by numbers of elements.

    >>> mesh = build_mesh("coarse")
    >>> len(mesh.points), sorted(mesh.named)
    (1536, ['critical', 'tip'])
    """
    return _build(mesh, geometry or Geometry())


@lru_cache(maxsize=8)
def _build(mesh: str | tuple[int, int, int], geometry: Geometry) -> BladeMesh:
    if isinstance(mesh, str) and mesh not in MESHES:
        raise InputError("mesh", mesh, "is unknown", f"choose one of {', '.join(MESHES)}")
    n = MESHES[mesh] if isinstance(mesh, str) else mesh
    cells, parametric = lattice(n, closed=True)
    named = {}
    for name, point in NAMED_POINTS.items():
        gap = np.abs(parametric - point).max(axis=1)
        if gap.min() > 1e-9:
            raise InputError(
                "mesh", n, f"has no node at {name} {point}", "take multiples of 4, any, of 2"
            )
        named[name] = int(gap.argmin())
    return BladeMesh(
        points=place(parametric, geometry),
        cells=cells,
        parametric=parametric,
        shape=n,
        closed=True,
        named=named,
        name=mesh if isinstance(mesh, str) else "x".join(map(str, n)),
    )


def brick(
    n: tuple[int, int, int], size: tuple[float, float, float], distort: float = 0.0, seed: int = 0
) -> BladeMesh:
    """A box for verification: local axes along x, y, z; inner nodes moved by `distort`·spacing.

    Mid-edge nodes stay midway between their corners, so that the box passes patch tests.
    """
    cells, parametric = lattice(n, closed=False)
    points = parametric * size
    inner = np.all((parametric > 0) & (parametric < 1), axis=1)
    shift = np.random.default_rng(seed).uniform(-1, 1, points.shape) * np.array(size) / n
    points[inner] += distort * shift[inner]
    for k, (a, b) in enumerate(EDGES):
        points[cells[:, 8 + k]] = (points[cells[:, a]] + points[cells[:, b]]) / 2
    return BladeMesh(points, cells, parametric, n, closed=False, name="brick")


def place(parametric: Array, geometry: Geometry) -> Array:
    """Points (P, 3) in mm of material points (P, 3) given by (c, w, s)."""
    c, w, s = np.asarray(parametric, dtype=np.float64).T
    xy = (1 - w[:, None]) * _skin(c, s, geometry, 0) + w[:, None] * _skin(c, s, geometry, 1)
    spans, where = np.unique(s, return_inverse=True)
    xy = xy - np.array([_centroid(value, geometry) for value in spans])[where]
    angle = np.deg2rad(geometry.stagger_deg + geometry.twist_deg * s)
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = cos * xy[:, 0] - sin * xy[:, 1], sin * xy[:, 0] + cos * xy[:, 1]
    return np.stack([x, y, geometry.hub_radius + geometry.span * s], axis=1)


def _skin(c: Array, s: Array, g: Geometry, inner: int) -> Array:
    """The outer (0) or inner (1) skin before stacking, (P, 2)."""
    chord = g.chord_root + (g.chord_tip - g.chord_root) * s
    wall = inner * (g.wall_root + (g.wall_tip - g.wall_root) * s)
    half = g.half_thickness_root + (g.half_thickness_tip - g.half_thickness_root) * s
    phi = 2 * np.pi * c
    x = (chord / 2 - g.edge_wall * wall) * np.cos(phi)
    y = (half - wall) * np.sin(phi) * (1 - g.nose * np.cos(phi)) / _peak(g.nose)
    along = x / chord + 0.5
    height, slope = 4 * g.camber * chord * along * (1 - along), 4 * g.camber * (1 - 2 * along)
    norm = np.hypot(1.0, slope)
    return np.stack([x - y * slope / norm, height + y / norm], axis=1)


def _peak(nose: float) -> float:
    """max over phi of sin(phi) (1 - nose cos(phi))."""
    cos = 0.0 if nose == 0 else (1 - np.sqrt(1 + 8 * nose**2)) / (4 * nose)
    return float(np.sqrt(1 - cos**2) * (1 - nose * cos))


def _centroid(s: float, geometry: Geometry) -> Array:
    """Centroid (2,) of the metal of a section, by the trapezoidal rule on closed curves."""
    c = np.arange(720) / 720
    moments = np.zeros(3)
    for inner, sign in ((0, 1.0), (1, -1.0)):
        p = _skin(c, np.full_like(c, s), geometry, inner)
        q = np.roll(p, -1, axis=0)
        cross = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
        moments += sign * np.array([cross.sum() / 2, *((p + q) * cross[:, None]).sum(axis=0) / 6])
    return np.asarray(moments[1:] / moments[0])
