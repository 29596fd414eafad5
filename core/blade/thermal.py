"""Steady temperature of the metal.

    div(k(T) grad T) = 0              in the metal
    k dT/dn = h_eff (T_gas - T)       outside, 1/h_eff = 1/h_g + m t_TBC / k_TBC
    k dT/dn = h_c (T_coolant - T)     inside
    k dT/dn = 0                       at the root and the tip

with m the ratio `tbc_thickness`, the coating's mass neglected, and

    T_gas [°C] = (gas_c - gas_per_rate_c (1 - t1t_rate)) · profile(s)
    profile(s) = 1 - (1 - profile_root) ((s - s_peak) / s_peak)²

Four Picard iterations on k(T). Weakly, with the 20-node functions N: (∫ k grad N_i·grad N_j +
∮ h N_i N_j) T_j = ∮ h T_inf N_i; summing the rows shows that what enters outside leaves inside
to rounding error, whatever the mesh.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from core.blade.element import Array, Index, face_points, gauss, shape
from core.blade.geometry import BladeMesh
from core.blade.properties import Properties

PICARD = 4
ZERO_C = 273.15


@dataclass(frozen=True, slots=True)
class Film:
    """Convection on one face: h in W/(mm² K) and T_inf in K as functions of (c, w, s) (…, 3)."""

    face: str
    coefficient: Callable[[Array], Array]
    ambient: Callable[[Array], Array]


@dataclass(frozen=True, slots=True)
class FilmTerms:
    """One film assembled: ∮ h N N (N, N), ∮ h T_inf N (N,)."""

    matrix: sparse.csr_matrix
    vector: Array

    def heat_in(self, temperature: Array) -> float:
        """W into the metal through this film."""
        return float((self.vector - self.matrix @ temperature).sum())


def films(tbc_thickness: float, t1t_rate: float, properties: Properties) -> tuple[Film, Film]:
    """The films of the blade: gas through the coating outside, coolant inside."""
    p = properties.service
    gas = p.gas_c - p.gas_per_rate_c * (1 - t1t_rate)
    coating = tbc_thickness * p.tbc_thickness / p.tbc_conductivity

    def outside(at: Array) -> Array:
        nose = np.exp(-0.5 * ((at[..., 0] - 0.5) / p.leading_width) ** 2)
        film = p.gas_film + (p.gas_film_leading - p.gas_film) * nose
        return np.asarray(1 / (1 / film + coating))

    def gas_k(at: Array) -> Array:
        off = (at[..., 2] - p.profile_peak) / p.profile_peak
        return np.asarray(gas * (1 - (1 - p.profile_root) * off**2) + ZERO_C)

    def coolant_k(at: Array) -> Array:
        rise = p.coolant_tip_c - p.coolant_root_c
        return np.asarray(p.coolant_root_c + rise * at[..., 2] + ZERO_C)

    return (
        Film("outside", outside, gas_k),
        Film("inside", lambda at: np.full(at.shape[:-1], p.coolant_film), coolant_k),
    )


def assemble_film(mesh: BladeMesh, film: Film) -> FilmTerms:
    """∮ h N_i N_j and ∮ h T_inf N_i over the film's face, 3×3 Gauss points."""
    elements, axis, side = mesh.face(film.face)
    local, weight, (b, c) = face_points(axis, side)
    value, gradient = shape(local)
    tangent = np.einsum("enx,pna->epxa", mesh.points[mesh.cells[elements]], gradient)
    area = np.linalg.norm(np.cross(tangent[..., b], tangent[..., c]), axis=-1) * weight
    at = mesh.parametric_at(elements, local)
    h = film.coefficient(at) * area
    load = np.einsum("ep,pi->ei", h * film.ambient(at), value)
    return FilmTerms(
        scatter(mesh.cells[elements], np.einsum("ep,pi,pj->eij", h, value, value), mesh),
        np.asarray(
            np.bincount(mesh.cells[elements].ravel(), load.ravel(), len(mesh.points)), np.float64
        ),
    )


def scatter(cells: Index, blocks: Array, mesh: BladeMesh) -> sparse.csr_matrix:
    """Sum element blocks (E, n, n) into a sparse (N, N) matrix."""
    n = cells.shape[1]
    row, col = np.repeat(cells, n, axis=1).ravel(), np.tile(cells, (1, n)).ravel()
    size = len(mesh.points)
    return sparse.csr_matrix((blocks.ravel(), (row, col)), shape=(size, size))


def solve_heat(
    mesh: BladeMesh,
    conductivity: Callable[[Array], Array],
    terms: list[FilmTerms],
    iterations: int = PICARD,
) -> Array:
    """Nodal temperature (N,) in K for k(T) in W/(mm K) and assembled films."""
    local, weight = gauss(3)
    value, gradient = shape(local)
    jacobian = np.einsum("enx,pna->epxa", mesh.points[mesh.cells], gradient)
    slope = np.einsum("pna,epax->epnx", gradient, np.linalg.inv(jacobian))
    volume = np.linalg.det(jacobian) * weight
    films_matrix = sum(t.matrix for t in terms)
    load = sum((t.vector for t in terms), np.zeros(len(mesh.points)))
    # start from the film's own mean, so that k(T) begins near the answer
    temperature = np.full(len(mesh.points), load.sum() / films_matrix.sum())
    flat = slope.transpose(0, 2, 1, 3).reshape(len(mesh.cells), 20, -1)
    for _ in range(iterations):
        k = conductivity(temperature[mesh.cells] @ value.T) * volume
        scaled = flat * np.repeat(k, 3, axis=1)[:, None, :]
        matrix = scatter(mesh.cells, scaled @ flat.transpose(0, 2, 1), mesh) + films_matrix
        factor = splu(
            matrix.tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        temperature = factor.solve(load)
    return np.asarray(temperature)


def metal_temperature(
    mesh: BladeMesh, tbc_thickness: float, t1t_rate: float, properties: Properties | None = None
) -> Array:
    """Nodal metal temperature (N,) in K of the blade."""
    properties = properties or Properties()
    m = properties.material
    terms = [assemble_film(mesh, f) for f in films(tbc_thickness, t1t_rate, properties)]
    return solve_heat(mesh, lambda t: np.interp(t, m.temperature_k, m.conductivity), terms)
