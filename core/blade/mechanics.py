"""Equilibrium of the rotating, hot, creeping blade.

    K(T) u = F_centrifugal + F_thermal + sum_e ∫ Bᵀ D eps_creep
    sigma = D(T) (B u - alpha(T) (T - T_ref) I - eps_creep)

Small strains, isotropic D(E(T), nu), body force rho omega² (0, y, z) about the rotor's axis x.
Root: u_z = 0 and an in-plane elastic foundation; a clamp would make a singularity. The integrals
use 2×2×2 Gauss points, the element's superconvergent points: stress, creep strain and stiffness
live at the same points, so that relaxation is a projection and cannot grow.

K depends on the temperature alone: it is factorised once and each later displacement costs one
forward and backward substitution.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from core.blade.creep import all_rates
from core.blade.element import Array, Index, face_points, gauss, shape
from core.blade.geometry import BladeMesh
from core.blade.kernels import creep_load, point_stress
from core.blade.properties import Properties
from core.errors import InputError

Solver = Literal["splu", "cholmod", "auto"]


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """Root conditions: u[component] = 0 on face nodes, foundation N/mm³ on the other components."""

    face: str = "root"
    fixed: tuple[int, ...] = (2,)
    foundation: float = 0.0


class Structure:
    """One mesh at one temperature, factorised.

    `extra_load` (3N,) N is added to the centrifugal and thermal loads; `extra_fixed` prescribes
    u[component] in mm at nodes, {component: (nodes, values)}.

    points G = elements × order³, all arrays of a point in that order:

    gradient     (G, 20, 3) dN/dx in 1/mm
    volume       (G,) mm³
    temperature  (G,) K;  shear, lame (G,) MPa;  thermal (G,) strain
    """

    def __init__(
        self,
        mesh: BladeMesh,
        temperature: Array,
        properties: Properties,
        *,
        support: Support | None = None,
        order: int = 2,
        solver: Solver = "splu",
        extra_load: Array | None = None,
        extra_fixed: dict[int, tuple[Index, Array]] | None = None,
    ) -> None:
        m = properties.material
        local, weight = gauss(order)
        value, slope = shape(local)
        jacobian = np.einsum("enx,pna->epxa", mesh.points[mesh.cells], slope)
        gradient = np.einsum("pna,epax->epnx", slope, np.linalg.inv(jacobian))
        self.mesh, self.order = mesh, order
        self.cells = np.ascontiguousarray(mesh.cells)
        self.gradient = np.ascontiguousarray(gradient.reshape(-1, 20, 3))
        self.volume = (np.linalg.det(jacobian) * weight).ravel()
        self.temperature = (temperature[mesh.cells] @ value.T).ravel()
        young = np.interp(self.temperature, m.temperature_k, m.youngs_modulus)
        self.shear = young / (2 * (1 + m.poisson_ratio))
        self.lame = 2 * self.shear * m.poisson_ratio / (1 - 2 * m.poisson_ratio)
        expansion = np.interp(self.temperature, m.temperature_k, m.secant_expansion)
        self.thermal = expansion * (self.temperature - m.reference_k)

        support = support or Support(foundation=properties.geometry.foundation)
        self.stiffness = self._stiffness() + self._foundation(support)
        self.pull = self._centrifugal(value, m.density * properties.service.omega**2)
        self.thermal_load = self._thermal_load()
        self.load = self.pull + self.thermal_load
        if extra_load is not None:
            self.load = self.load + extra_load
        value_at = np.full((len(mesh.points), 3), np.nan)
        value_at[mesh.face_nodes(support.face)[:, None], list(support.fixed)] = 0.0
        for component, (nodes, prescribed) in (extra_fixed or {}).items():
            value_at[nodes, component] = prescribed
        given = np.isfinite(value_at.ravel())
        self.fixed, self.free = np.flatnonzero(given), np.flatnonzero(~given)
        self.prescribed = value_at.ravel()[given]
        self._lift = self.stiffness[self.free][:, self.fixed] @ self.prescribed
        self._solve = factorise(self.stiffness[self.free][:, self.free].tocsc(), solver)

    @property
    def points(self) -> int:
        """Number of Gauss points."""
        return len(self.volume)

    def displacement(self, state: Array | None = None) -> Array:
        """u (3N,) in mm for the creep state (G, 9); none: no creep strain."""
        load = self.load if state is None else self.load + self.creep_load(state)
        u = np.zeros(3 * len(self.mesh.points))
        u[self.fixed] = self.prescribed
        u[self.free] = self._solve(load[self.free] - self._lift)
        return u

    def creep_load(self, state: Array) -> Array:
        """∫ Bᵀ D eps_creep, (3N,) in N."""
        out = np.zeros(3 * len(self.mesh.points))
        creep_load(self.cells, self.gradient, self.volume, self.shear, self.lame, state, out)
        return out

    def stress(self, u: Array, state: Array) -> Array:
        """sigma (G, 6) in MPa: xx, yy, zz, yz, xz, xy."""
        out = np.empty((self.points, 6))
        point_stress(self.cells, self.gradient, self.shear, self.lame, self.thermal, u, state, out)
        return out

    def rates(self, u: Array, state: Array, law: Array) -> tuple[Array, float]:
        """The nine state rates (G, 9) in 1/h, and the fastest decay rate in 1/h."""
        out = np.empty_like(state)
        fastest = all_rates(law, self.stress(u, state), self.temperature, self.shear, state, out)
        return out, float(fastest)

    def internal_force(self, u: Array, state: Array) -> Array:
        """∫ Bᵀ sigma, (3N,) in N: at free nodes the external load less the foundation."""
        stress = self.stress(u, state) * self.volume[:, None]
        tensor = stress[:, [[0, 5, 4], [5, 1, 3], [4, 3, 2]]]
        force = np.einsum("gna,gab->gnb", self.gradient, tensor)
        cells = np.repeat(self.cells, self.order**3, axis=0)
        out = np.zeros((len(self.mesh.points), 3))
        np.add.at(out, cells, force)
        return out.ravel()

    def _stiffness(self) -> sparse.csr_matrix:
        """K_iajb = ∫ lame N_i,a N_j,b + shear (N_i,b N_j,a + delta_ab N_i,c N_j,c)."""
        n = len(self.cells)
        flat = self.gradient.reshape(n, -1, 60)
        scale = (self.shear * self.volume).reshape(n, -1, 1)
        outer = (flat.transpose(0, 2, 1) @ (flat * scale)).reshape(n, 20, 3, 20, 3)
        ratio = (self.lame * self.volume).reshape(n, -1, 1)
        block = (flat.transpose(0, 2, 1) @ (flat * ratio)).reshape(n, 20, 3, 20, 3)
        block += outer.transpose(0, 1, 4, 3, 2)
        dot = np.einsum("niaja->nij", outer)
        for a in range(3):
            block[:, :, a, :, a] += dot
        dof = (3 * self.cells[:, :, None] + np.arange(3)).reshape(n, 60)
        size = 3 * len(self.mesh.points)
        index = (np.repeat(dof, 60, axis=1).ravel(), np.tile(dof, (1, 60)).ravel())
        return sparse.csr_matrix((block.ravel(), index), shape=(size, size))

    def _foundation(self, support: Support) -> sparse.csr_matrix:
        size = 3 * len(self.mesh.points)
        elements, axis, side = self.mesh.face(support.face)
        local, weight, (b, c) = face_points(axis, side)
        value, slope = shape(local)
        tangent = np.einsum("enx,pna->epxa", self.mesh.points[self.cells[elements]], slope)
        area = np.linalg.norm(np.cross(tangent[..., b], tangent[..., c]), axis=-1) * weight
        block = support.foundation * np.einsum("ep,pi,pj->eij", area, value, value)
        total = sparse.csr_matrix((size, size))
        for component in sorted({0, 1, 2} - set(support.fixed)):
            dof = 3 * self.cells[elements] + component
            index = (np.repeat(dof, 20, axis=1).ravel(), np.tile(dof, (1, 20)).ravel())
            total = total + sparse.csr_matrix((block.ravel(), index), shape=(size, size))
        return total

    def _centrifugal(self, value: Array, density_omega2: float) -> Array:
        at = np.einsum("pn,enx->epx", value, self.mesh.points[self.cells])
        at[..., 0] = 0.0
        force = density_omega2 * at * self.volume.reshape(len(self.cells), -1, 1)
        out = np.zeros_like(self.mesh.points)
        np.add.at(out, self.cells, np.einsum("pn,epx->enx", value, force))
        return out.ravel()

    def _thermal_load(self) -> Array:
        bulk = (3 * self.lame + 2 * self.shear) * self.thermal * self.volume
        block = (self.gradient * bulk[:, None, None]).reshape(len(self.cells), -1, 20, 3)
        out = np.zeros_like(self.mesh.points)
        np.add.at(out, self.cells, block.sum(axis=1))
        return out.ravel()


def factorise(matrix: sparse.csc_matrix, solver: Solver = "splu") -> Callable[[Array], Array]:
    """A function that solves with a symmetric positive definite matrix.

    splu      SuperLU in symmetric mode under minimum degree; always there
    cholmod   CHOLMOD, if scikit-sparse is installed
    auto      CHOLMOD if it is there, else SuperLU
    """
    if solver not in ("splu", "cholmod", "auto"):
        raise InputError("solver", solver, "is unknown", "choose splu, cholmod or auto")
    if solver != "splu":
        try:
            from sksparse.cholmod import cholesky
        except ImportError:
            if solver == "cholmod":
                raise InputError(
                    "solver", solver, "needs scikit-sparse", "install bladetwin[cholmod]"
                ) from None
        else:
            factor = cholesky(matrix)
            return lambda load: np.asarray(factor(load))
    lu = splu(
        matrix,
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    return lambda load: np.asarray(lu.solve(load))
