"""Quarter rings in plane strain with closed answers: pressure, heat, spin, stationary creep."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from core.blade import BladeMesh, Properties
from core.blade.creep import STATE, all_rates, coefficients
from core.blade.element import gauss, shape
from core.blade.geometry import lattice
from core.blade.integrate import Tolerance, advance
from core.blade.mechanics import Structure, Support
from core.blade.properties import Creep
from core.blade.thermal import Film, assemble_film, solve_heat

Array = np.ndarray
HOT, YOUNG, NU, EXPANSION = 1143.15, 150e3, 0.3, 15e-6
INNER, OUTER, LONG = 10.0, 20.0, 4.0
ALONG = {0: (1, 2, 0), 2: (0, 1, 2)}  # the ring's axis -> (radial at 0, radial at 90 deg, axis)


def ring(n: tuple[int, int, int], axis: int) -> tuple[BladeMesh, Array, Array]:
    """A quarter ring about an axis; radius and angle of its nodes."""
    cells, parametric = lattice(n, closed=False)
    angle, r = 0.5 * np.pi * parametric[:, 0], OUTER + (INNER - OUTER) * parametric[:, 1]
    points = np.empty((len(r), 3))
    points[:, list(ALONG[axis])] = np.stack(
        [r * np.cos(angle), r * np.sin(angle), LONG * parametric[:, 2]], axis=1
    )
    return BladeMesh(points, cells, parametric, n, closed=False, name="ring"), r, angle


def steady(plain: Properties, rpm: float = 0.0) -> Properties:
    """The same elastic constants at all temperatures."""
    table = {"youngs_modulus": (YOUNG,) * 4, "secant_expansion": (EXPANSION,) * 4}
    material = replace(plain.material, poisson_ratio=NU, **table)  # type: ignore[arg-type]
    return replace(plain, material=material, service=replace(plain.service, speed_rpm=rpm))


def held(
    mesh: BladeMesh,
    properties: Properties,
    temperature: Array,
    axis: int = 2,
    load: Array | None = None,
) -> Structure:
    """Symmetric at both cuts, and as long as it was."""
    a, b, c = ALONG[axis]
    cut = {
        b: np.flatnonzero(mesh.parametric[:, 0] == 0),
        a: np.flatnonzero(mesh.parametric[:, 0] == 1),
        c: mesh.face_nodes("tip"),
    }
    return Structure(
        mesh,
        temperature,
        properties,
        support=Support(fixed=(c,), foundation=0.0),
        extra_load=load,
        extra_fixed={k: (nodes, np.zeros(len(nodes))) for k, nodes in cut.items()},
    )


def pressed(mesh: BladeMesh, pressure: float) -> Array:
    """Loads (3N,) of a pressure inside, about z."""
    load = np.zeros((len(mesh.points), 3))
    for k, part in ((0, np.cos), (1, np.sin)):

        def traction(at: Array, part: Callable[[Array], Array] = part) -> Array:
            return pressure * part(0.5 * np.pi * at[..., 0])

        film = Film("inside", lambda at: np.ones(at.shape[:-1]), traction)
        load[:, k] = assemble_film(mesh, film).vector
    return load.ravel()


def polar(mesh: BladeMesh, stress: Array) -> tuple[Array, Array, Array]:
    """Radius, radial and hoop stress at the points of a ring about z."""
    at = np.einsum("pn,enx->epx", shape(gauss(2)[0])[0], mesh.points[mesh.cells]).reshape(-1, 3)
    r = np.hypot(at[:, 0], at[:, 1])
    c, s = at[:, 0] / r, at[:, 1] / r
    xx, yy, xy = stress[:, 0], stress[:, 1], stress[:, 5]
    shear = 2 * xy * c * s
    return r, xx * c * c + yy * s * s + shear, xx * s * s + yy * c * c - shear


def test_a_ring_under_pressure_widens_as_lame_says(plain: Properties) -> None:
    mesh, r, angle = ring((6, 4, 1), 2)
    u = held(mesh, steady(plain), np.full(len(r), HOT), load=pressed(mesh, 100.0)).displacement()
    x, y, _ = u.reshape(-1, 3).T
    a = 100.0 * INNER**2 / (OUTER**2 - INNER**2)
    exact = (1 + NU) / YOUNG * a * ((1 - 2 * NU) * r + OUTER**2 / r)
    assert np.abs((x * np.cos(angle) + y * np.sin(angle)) / exact - 1).max() < 2e-4


def test_a_ring_that_is_hotter_inside_has_the_closed_stresses(plain: Properties) -> None:
    mesh, r, _ = ring((8, 8, 1), 2)
    ratio, hotter = np.log(OUTER / INNER), 200.0
    warm = HOT + hotter * np.log(OUTER / r) / ratio
    structure = held(mesh, steady(plain), warm)
    stress = structure.stress(structure.displacement(), np.zeros((structure.points, STATE)))
    at, radial, hoop = polar(mesh, stress)
    k = YOUNG * EXPANSION * hotter / (2 * (1 - NU) * ratio)
    own, whole = np.log(OUTER / at), INNER**2 / (OUTER**2 - INNER**2) * ratio
    exact = k * (-own - whole * (1 - OUTER**2 / at**2))
    around = k * (1 - own - whole * (1 + OUTER**2 / at**2))
    along = NU * (exact + around) - YOUNG * EXPANSION * hotter * own / ratio
    for found, told in ((radial, exact), (hoop, around), (stress[:, 2], along)):
        assert np.abs(found - told).max() < 1e-3 * np.abs(around).max()


def test_a_ring_that_spins_about_the_rotors_axis_widens_as_the_closed_form_says(
    plain: Properties,
) -> None:
    mesh, r, angle = ring((6, 4, 1), 0)
    spinning = steady(plain, 30_000.0)
    u = held(mesh, spinning, np.full(len(r), HOT), axis=0).displacement().reshape(-1, 3)
    flat, side = YOUNG / (1 - NU**2), NU / (1 - NU)  # plane strain by plane stress
    pull = spinning.material.density * spinning.service.omega**2
    form = OUTER**2 + INNER**2 - (1 + side) / (3 + side) * r**2
    form = form + (1 + side) / (1 - side) * OUTER**2 * INNER**2 / r**2
    exact = pull * (3 + side) * (1 - side) / (8 * flat) * r * form
    assert np.abs((u[:, 1] * np.cos(angle) + u[:, 2] * np.sin(angle)) / exact - 1).max() < 2e-4


def test_a_ring_between_two_films_has_the_logarithmic_temperature() -> None:
    mesh, r, _ = ring((6, 4, 1), 2)

    def film(face: str, h: float, kelvin: float) -> Film:
        return Film(
            face, lambda at: np.full(at.shape[:-1], h), lambda at: 0.0 * at[..., 0] + kelvin
        )

    terms = [
        assemble_film(mesh, film(*f)) for f in (("inside", 2e-3, 800), ("outside", 4e-3, 1400))
    ]
    found = solve_heat(mesh, lambda t: np.full(t.shape, 20e-3), terms)
    entry, exit_ = 1 / (2e-3 * INNER), 1 / (4e-3 * OUTER)
    flow = 600 / (entry + np.log(OUTER / INNER) / 20e-3 + exit_)
    assert np.abs(found - 800 - flow * (entry + np.log(r / INNER) / 20e-3)).max() < 0.01


def test_a_ring_that_creeps_under_pressure_comes_to_nortons_stationary_stress(
    plain: Properties,
) -> None:
    """The law at one temperature is a power law of the exponent B / T."""
    mesh, r, _ = ring((3, 5, 1), 2)
    bare = replace(steady(plain), creep=replace(plain.creep, primary_strain=1e-12))
    structure = held(mesh, bare, np.full(len(r), HOT), load=pressed(mesh, 90.0))
    law = coefficients(bare.creep, 0.0, 0.0)
    *_, before, state = (
        one.copy()
        for one in advance(
            lambda y: structure.rates(structure.displacement(y), y, law),
            np.zeros((structure.points, STATE)),
            np.array([0.0, 5e4, 5.1e4]),
            Tolerance(),
        )
    )
    stress = structure.stress(structure.displacement(state), state)
    at, radial, hoop = polar(mesh, stress)
    power = 2 * HOT / bare.creep.larson_miller_b
    whole = (OUTER / INNER) ** power - 1
    exact = -90.0 * ((OUTER / at) ** power - 1) / whole
    around = 90.0 * ((power - 1) * (OUTER / at) ** power + 1) / whole
    assert np.abs(radial - exact).max() < 1e-3 * 90.0
    assert np.abs(hoop - around).max() < 1e-3 * 90.0
    assert np.abs(stress[:, 2] - (exact + around) / 2).max() < 1e-3 * 90.0
    q = np.sqrt(0.75) * (around - exact)
    rate = 0.02 * 10 ** (20 - (41566.8 - 6536.04 * np.log10(q)) / HOT)
    assert (state[:, 7] - before[:, 7]) / 1e3 == pytest.approx(rate, rel=2e-3)


def test_a_point_under_stress_in_steps_hardens_by_its_strain() -> None:
    """Primary strain goes on from where it is, and rests above what less stress saturates at."""
    law = coefficients(Creep(), 0.7, -0.3)
    state, primary, secondary = np.zeros((1, STATE)), 0.0, 0.0
    for q, hours in ((100.0, 50.0), (200.0, 5.0), (80.0, 3000.0), (250.0, 2.0), (100.0, 1000.0)):
        stress = np.array([[0.0, 0.0, q, 0.0, 0.0, 0.0]])

        def rates(y: Array, stress: Array = stress) -> tuple[Array, float]:
            out = np.empty_like(y)
            fastest = all_rates(law, stress, np.array([HOT]), np.array([5e4]), y, out)
            return out, float(fastest)

        *_, state = advance(rates, state, np.array([0.0, hours]), Tolerance())
        r0 = 0.02 * 10 ** (20 - (41566.8 - 6536.04 * np.log10(q)) / HOT)
        target = 1e-3 * (q / 100) ** 2 * np.exp(0.35 * 0.7)
        left = max(target - primary, 0.0)
        primary += left * -np.expm1(-hours * r0 / 2e-4)
        secondary += hours * r0 * np.exp(-0.35 * 0.3)
        assert state[0, 6] == pytest.approx(primary, rel=2e-3), q
        assert state[0, 7] == pytest.approx(secondary, rel=1e-6), q
        assert state[0, 2] == pytest.approx(primary + secondary, rel=2e-3), q
