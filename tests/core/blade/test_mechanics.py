from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from skfem import Basis, ElementHexS2, ElementVector, MeshHex, asm
from skfem.models.elasticity import linear_elasticity

from core.blade import BladeMesh, Properties, build_mesh, output_times
from core.blade.creep import EPS_P, EPS_S, STATE
from core.blade.element import gauss, shape
from core.blade.geometry import brick
from core.blade.mechanics import Structure, Support, factorise
from core.blade.thermal import Film, assemble_film, metal_temperature
from core.errors import InputError

Uniform = Callable[[BladeMesh], np.ndarray]
History = Callable[..., tuple[np.ndarray, np.ndarray]]
HOT = 1143.15
YOUNG = np.interp(HOT, (1000, 1300), (155e3, 130e3))


def on_the_boundary(mesh: BladeMesh) -> np.ndarray:
    return np.flatnonzero(np.any((mesh.parametric == 0) | (mesh.parametric == 1), axis=1))


def prescribed(mesh: BladeMesh, field: np.ndarray) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    nodes = on_the_boundary(mesh)
    return {a: (nodes, field[nodes, a]) for a in range(3)}


# --- elasticity -------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [2, 3])
def test_patch_of_distorted_elements_carries_a_linear_displacement(
    order: int, plain: Properties, uniform: Uniform
) -> None:
    mesh = brick((3, 3, 3), (30.0, 24.0, 36.0), distort=0.25, seed=5)
    gradient = np.random.default_rng(8).normal(size=(3, 3)) * 1e-3
    exact = mesh.points @ gradient.T + [0.2, -0.1, 0.3]
    structure = Structure(
        mesh, uniform(mesh), plain, order=order, extra_fixed=prescribed(mesh, exact)
    )
    u = structure.displacement().reshape(-1, 3)
    assert len(structure.free) == 3 * (len(mesh.points) - len(on_the_boundary(mesh))) > 100
    assert np.abs(u - exact).max() < 1e-12 * np.abs(exact).max()
    stress = structure.stress(u.ravel(), np.zeros((structure.points, STATE)))
    assert np.abs(stress - stress[0]).max() < 1e-11 * np.abs(stress).max()


def test_patch_of_distorted_elements_fails_for_a_quadratic_displacement(
    plain: Properties, uniform: Uniform
) -> None:
    mesh = brick((3, 3, 3), (30.0, 24.0, 36.0), distort=0.25, seed=5)
    x, y, z = mesh.points.T
    exact = 1e-4 * np.stack([x * y, y * z, z * x], axis=1)
    structure = Structure(mesh, uniform(mesh), plain, extra_fixed=prescribed(mesh, exact))
    assert np.abs(structure.displacement().reshape(-1, 3) - exact).max() > 1e-4 * exact.max()


def test_stiffness_is_the_one_that_scikit_fem_assembles(
    plain: Properties, uniform: Uniform
) -> None:
    mesh = brick((2, 3, 2), (20.0, 33.0, 24.0), distort=0.2, seed=1)
    corners, flat = np.unique(mesh.cells[:, :8], return_inverse=True)
    vtk = flat.reshape(-1, 8)[:, [0, 4, 3, 1, 7, 5, 2, 6]]  # any valid order of a hexahedron
    other = _skfem_mesh(mesh.points[corners], vtk)
    basis = Basis(other, ElementVector(ElementHexS2()), intorder=3)
    ours = Structure(mesh, uniform(mesh), plain, support=Support(foundation=0.0))
    theirs = asm(linear_elasticity(ours.lame[0], ours.shear[0]), basis)
    places = basis.doflocs.T
    node = np.array([np.abs(mesh.points - at).max(axis=1).argmin() for at in places])
    assert np.abs(mesh.points[node] - places).max() < 1e-12
    dof = 3 * node + _component(basis)
    gap = ours.stiffness[dof][:, dof] - theirs
    assert np.abs(gap).max() < 1e-14 * np.abs(theirs).max()


def _skfem_mesh(points: np.ndarray, cells: np.ndarray) -> MeshHex:
    return MeshHex(points.T.copy(), cells.T.copy())


def _component(basis: Basis) -> np.ndarray:
    """0, 1, 2 for each degree of freedom: at one place they are numbered by component."""
    component = np.empty(basis.N, dtype=int)
    for at in np.unique(basis.doflocs.round(9), axis=1).T:
        here = np.flatnonzero(np.abs(basis.doflocs.T - at).max(axis=1) < 1e-8)
        component[here] = np.arange(3)
    return component


def test_displacement_converges_with_the_third_power_of_the_element(
    plain: Properties, uniform: Uniform
) -> None:
    """u = grad(e^{ax} sin ay + e^{az} cos ax) is harmonic without divergence: in equilibrium."""
    a = 0.06

    def exact(p: np.ndarray) -> np.ndarray:
        x, y, z = np.moveaxis(p, -1, 0)
        return a * np.stack(
            [
                np.exp(a * x) * np.sin(a * y) - np.exp(a * z) * np.sin(a * x),
                np.exp(a * x) * np.cos(a * y),
                np.exp(a * z) * np.cos(a * x),
            ],
            axis=-1,
        )

    local, weight = gauss(4)
    errors = []
    for n in (1, 2, 4):
        mesh = brick((n, n, n), (40.0, 40.0, 40.0))
        structure = Structure(
            mesh,
            uniform(mesh),
            plain,
            support=Support(foundation=0.0),
            order=3,
            extra_fixed=prescribed(mesh, exact(mesh.points)),
        )
        u = structure.displacement().reshape(-1, 3)
        value = shape(local)[0]
        at = np.einsum("pn,enx->epx", value, mesh.points[mesh.cells])
        gap = np.einsum("pn,enx->epx", value, u[mesh.cells]) - exact(at)
        errors.append(np.sqrt(np.einsum("epx,p->", gap**2, weight) / n**3))
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(rates > 2.7), rates
    assert np.all(rates < 4.3), rates


# --- one-dimensional answers ------------------------------------------------------------------


def uniaxial_rate(q: float, temperature: float, eps_p: float, alpha: float, gamma: float):  # type: ignore[no-untyped-def]
    r0 = 0.02 / 10 ** ((41566.8 - 6536.04 * np.log10(q)) / temperature - 20)
    target = 1e-3 * (q / 100) ** 2 * np.exp(0.35 * alpha)
    return max(target - eps_p, 0.0) * r0 / 2e-4, r0 * np.exp(0.35 * gamma)


@pytest.mark.parametrize(("alpha", "gamma"), [(0.0, 0.0), (2.0, -1.5)])
def test_uniaxial_creep_follows_the_closed_form(
    alpha: float,
    gamma: float,
    plain: Properties,
    uniform: Uniform,
    creep_history: History,
) -> None:
    mesh = brick((2, 2, 2), (10.0, 12.0, 20.0), distort=0.2, seed=2)
    stress, time_h = 140.0, np.array([0.0, 10.0, 100.0, 700.0, 3000.0])
    load = np.zeros((len(mesh.points), 3))
    load[:, 2] = assemble_film(mesh, Film("tip", _ones, lambda at: stress * _ones(at))).vector
    structure = Structure(mesh, uniform(mesh), plain, extra_load=load.ravel())
    _, u = creep_history(structure, plain, time_h, alpha, gamma)
    tip = mesh.face_nodes("tip")
    strain = (u[:, tip, 2] - u[0, tip, 2]) / 20.0
    primary, secondary = uniaxial_rate(stress, HOT, 0.0, alpha, gamma)
    target = 1e-3 * 1.4**2 * np.exp(0.35 * alpha)
    exact = target * (1 - np.exp(-time_h * primary / target)) + secondary * time_h
    assert u[0, tip, 2] / 20.0 == pytest.approx(np.full(len(tip), stress / YOUNG), rel=1e-9)
    assert np.abs(strain[1:] / exact[1:, None] - 1).max() < 2e-3


def _ones(at: np.ndarray) -> np.ndarray:
    return np.ones(at.shape[:-1])


def test_relaxation_at_constant_length_follows_the_scalar_equation(
    plain: Properties, uniform: Uniform, creep_history: History
) -> None:
    mesh = brick((2, 2, 2), (10.0, 12.0, 20.0), distort=0.2, seed=2)
    time_h = output_times()[:18]
    tip = mesh.face_nodes("tip")
    stretch = np.full(len(tip), 20.0 * 260.0 / YOUNG)
    structure = Structure(mesh, uniform(mesh), plain, extra_fixed={2: (tip, stretch)})
    states, u = creep_history(structure, plain, time_h, 1.0, 0.5)
    stress = [structure.stress(w.ravel(), y)[:, 2] for w, y in zip(u, states, strict=True)]

    def scalar(_: float, y: np.ndarray) -> list[float]:
        primary, secondary = uniaxial_rate(max(y[0], 1e-6), HOT, y[1], 1.0, 0.5)
        return [-YOUNG * (primary + secondary), primary]

    exact = solve_ivp(
        scalar, (0, time_h[-1]), [260.0, 0.0], "LSODA", time_h, rtol=1e-10, atol=1e-12
    ).y[0]
    assert exact[-1] < 100.0
    assert np.abs(np.array(stress) / exact[:, None] - 1).max() < 2e-3


@pytest.fixture(scope="module")
def bar() -> BladeMesh:
    mesh = brick((2, 2, 12), (8.0, 8.0, 180.0))
    return replace(mesh, points=mesh.points + np.array([-4.0, -4.0, 900.0]))


def test_rotating_bar_stretches_and_creeps_as_the_integral_says(
    bar: BladeMesh, plain: Properties, uniform: Uniform, creep_history: History
) -> None:
    spinning = replace(plain, service=replace(plain.service, speed_rpm=3600.0))
    structure = Structure(bar, uniform(bar), spinning)
    time_h = np.array([0.0, 100.0, 1000.0, 8000.0])
    _, u = creep_history(structure, spinning, time_h, 0.0, 0.0)
    tip = bar.face_nodes("tip")
    pull = spinning.material.density * spinning.service.omega**2

    def stress(z: float) -> float:
        return pull * (1080.0**2 - z**2) / 2

    def creep(z: float, t: float) -> float:
        q = stress(z)
        primary, secondary = uniaxial_rate(q, HOT, 0.0, 0.0, 0.0)
        target = 1e-3 * (q / 100) ** 2
        return target * (1 - np.exp(-t * primary / target)) + secondary * t

    elastic = quad(lambda z: stress(z) / YOUNG, 900, 1080)[0]
    assert u[0, tip, 2].mean() == pytest.approx(elastic, rel=1e-3)
    for k in (1, 2, 3):
        exact = quad(creep, 900, 1080 - 1e-9, args=(time_h[k],))[0]
        assert (u[k, tip, 2] - u[0, tip, 2]).mean() == pytest.approx(exact, rel=5e-3)


def test_a_bar_spun_a_hundredth_faster_misses_the_elastic_bound(
    bar: BladeMesh, plain: Properties, uniform: Uniform
) -> None:
    tips = []
    for rpm in (3600.0, 3636.0):
        spinning = replace(plain, service=replace(plain.service, speed_rpm=rpm))
        u = Structure(bar, uniform(bar), spinning).displacement().reshape(-1, 3)
        tips.append(u[bar.face_nodes("tip"), 2].mean())
    assert abs(tips[1] / tips[0] - 1) > 1e-3


# --- the blade --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def crept() -> tuple[Structure, np.ndarray, np.ndarray]:
    """The coarse blade, hot, with an arbitrary creep strain."""
    mesh = build_mesh("coarse")
    structure = Structure(mesh, metal_temperature(mesh, 0.8, 0.95), Properties())
    state = np.zeros((structure.points, STATE))
    state[:, :6] = 1e-3 * np.random.default_rng(4).normal(size=(structure.points, 6))
    return structure, structure.displacement(state), state


def test_root_reaction_balances_the_pull(crept: tuple[Structure, np.ndarray, np.ndarray]) -> None:
    structure, u, state = crept
    pull = structure.pull.reshape(-1, 3)
    assert pull[:, 2].sum() == pytest.approx(125.85e3, rel=1e-3)  # N
    outside = structure.internal_force(u, state).reshape(-1, 3) - pull
    root = structure.mesh.face_nodes("root")
    assert abs(outside[root, 2].sum() + pull[:, 2].sum()) < 1e-10 * pull[:, 2].sum()
    others = np.setdiff1d(np.arange(len(pull)), root)
    assert np.abs(outside[others]).max() < 1e-10 * pull[:, 2].sum()


def test_free_expansion_of_a_uniformly_hot_bar_leaves_no_stress(uniform: Uniform) -> None:
    p = Properties()
    rest = replace(p, service=replace(p.service, speed_rpm=0.0))
    mesh = brick((2, 2, 3), (10.0, 10.0, 30.0), distort=0.2, seed=3)
    structure = Structure(mesh, uniform(mesh), rest, support=Support(foundation=1e-9))
    u = structure.displacement()
    expansion = np.interp(HOT, (1000, 1300), (14.8e-6, 17.0e-6)) * (HOT - 293.0)
    assert u.reshape(-1, 3)[mesh.face_nodes("tip"), 2] == pytest.approx(30.0 * expansion, rel=1e-6)
    assert np.abs(structure.stress(u, np.zeros((structure.points, STATE)))).max() < 1e-4


def test_mean_root_stress_is_the_pull_over_the_root_section() -> None:
    mesh = build_mesh("coarse")
    structure = Structure(mesh, np.full(len(mesh.points), 293.0), Properties())
    stress = structure.stress(structure.displacement(), np.zeros((structure.points, STATE)))
    low = np.repeat(np.unravel_index(np.arange(len(mesh.cells)), mesh.shape)[2] == 0, 8)
    mean = (stress[low, 2] * structure.volume[low]).sum() / structure.volume[low].sum()
    assert mean == pytest.approx(157.0, abs=8.0)  # MPa over the lowest eighth


def softest(order: int) -> float:
    """Lowest eigenvalue of the coarse blade's stiffness, by inverse iteration."""
    mesh = build_mesh("coarse")
    structure = Structure(mesh, np.full(len(mesh.points), 1100.0), Properties(), order=order)
    solve = factorise(structure.stiffness[structure.free][:, structure.free].tocsc())
    mode = np.random.default_rng(6).normal(size=len(structure.free))
    for _ in range(60):
        mode = solve(mode / np.linalg.norm(mode))
    return float(1 / np.linalg.norm(mode))


def test_reduced_integration_has_no_mode_softer_than_full_integration_has() -> None:
    assert softest(2) == pytest.approx(softest(3), rel=0.06)


def test_one_point_integration_has_such_modes() -> None:
    assert softest(1) < 1e-3 * softest(3)


def test_an_unknown_solver_is_refused() -> None:
    with pytest.raises(InputError, match="splu, cholmod or auto"):
        factorise(None, "magic")  # type: ignore[arg-type]


def test_auto_solver_gives_the_answer_of_splu(plain: Properties, uniform: Uniform) -> None:
    mesh = brick((2, 2, 2), (10.0, 12.0, 20.0))
    spinning = replace(plain, service=replace(plain.service, speed_rpm=3600.0))
    first, second = (
        Structure(mesh, uniform(mesh), spinning, solver=solver).displacement()
        for solver in ("splu", "auto")
    )
    assert second == pytest.approx(first, rel=1e-9, abs=1e-12)


def test_ceeq_of_a_crept_blade_is_never_less_than_its_equivalent_creep_strain(
    creep_history: History,
) -> None:
    mesh = build_mesh("coarse")
    structure = Structure(mesh, metal_temperature(mesh, 1.0, 0.95), Properties())
    state = creep_history(structure, Properties(), np.array([0.0, 2000.0]), 0.0, 0.0)[0][-1]
    e = state[:, :6]
    length = np.sqrt(2 / 3 * ((e[:, :3] ** 2).sum(1) + (e[:, 3:] ** 2).sum(1) / 2))
    assert np.all(length <= (state[:, EPS_P] + state[:, EPS_S]) * (1 + 1e-9))
    assert np.abs(e[:, :3].sum(axis=1)).max() < 1e-12
