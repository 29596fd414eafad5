from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.blade import Properties, build_mesh
from core.blade.geometry import brick
from core.blade.thermal import (
    Film,
    assemble_film,
    films,
    metal_temperature,
    solve_heat,
)

H_GAS, H_COOL, GAS, COOL, K, WALL = 3000e-6, 1500e-6, 1450.0, 750.0, 0.024, 4.0
COATING = 0.3 / 1.2e-3  # m² K/W in mm² K/W


def slab(tbc: float) -> tuple[np.ndarray, np.ndarray]:
    """Temperature through a wall and its depth from the outer face."""
    mesh = brick((2, 3, 2), (5.0, WALL, 5.0))
    outside = 1 / (1 / H_GAS + tbc * COATING)
    terms = [
        assemble_film(mesh, Film("outside", _constant(outside), _constant(GAS))),
        assemble_film(mesh, Film("inside", _constant(H_COOL), _constant(COOL))),
    ]
    return solve_heat(mesh, _constant(K), terms), mesh.points[:, 1]


def _constant(value: float):  # type: ignore[no-untyped-def]
    return lambda at: np.full(at.shape if at.ndim < 3 else at.shape[:-1], value)


@pytest.mark.parametrize("tbc", [2 / 3, 1.0, 4 / 3])
def test_a_coated_slab_has_the_temperature_of_resistances_in_series(tbc: float) -> None:
    temperature, depth = slab(tbc)
    flux = (GAS - COOL) / (1 / H_GAS + tbc * COATING + WALL / K + 1 / H_COOL)
    exact = GAS - flux * (1 / H_GAS + tbc * COATING + depth / K)
    assert np.abs(temperature - exact).max() < 1e-9


def test_a_slab_without_its_coating_is_far_from_the_coated_one() -> None:
    assert slab(1e-9)[0].max() - slab(1.0)[0].max() > 40.0


def test_picard_meets_kirchhoffs_transform_for_a_conductivity_that_grows() -> None:
    """k = k0 (1 + b T): with T fixed by huge films, k0 (T + b T²/2) is linear in depth."""
    mesh = brick((1, 8, 1), (5.0, WALL, 5.0))
    slope = 2e-3
    terms = [
        assemble_film(mesh, Film("outside", _constant(1e6), _constant(GAS))),
        assemble_film(mesh, Film("inside", _constant(1e6), _constant(COOL))),
    ]
    temperature = solve_heat(mesh, lambda t: 0.01 * (1 + slope * t), terms, iterations=12)
    theta = temperature + slope * temperature**2 / 2
    ends = [t + slope * t**2 / 2 for t in (GAS, COOL)]
    exact = ends[0] + (ends[1] - ends[0]) * mesh.points[:, 1] / WALL
    assert np.abs(theta / exact - 1).max() < 1e-4


@pytest.fixture(scope="module")
def hot() -> dict[float, np.ndarray]:
    return {rate: metal_temperature(build_mesh("coarse"), 1.0, rate) for rate in (0.8, 0.9, 1.0)}


def test_heat_that_enters_outside_leaves_inside(hot: dict[float, np.ndarray]) -> None:
    mesh = build_mesh("coarse")
    entering = [
        assemble_film(mesh, film).heat_in(hot[0.9]) for film in films(1.0, 0.9, Properties())
    ]
    assert entering[0] > 5000.0  # W
    assert abs(sum(entering)) < 1e-10 * entering[0]


def test_mean_metal_temperature_follows_the_rate(hot: dict[float, np.ndarray]) -> None:
    means = [hot[rate].mean() - 273.15 for rate in (0.8, 0.9, 1.0)]
    assert means == pytest.approx([776, 808, 840], abs=3.0)


def test_the_metal_is_between_coolant_and_gas(hot: dict[float, np.ndarray]) -> None:
    assert hot[0.9].min() > 430 + 273.15
    assert hot[0.9].max() < 1125 + 273.15


def test_thicker_coating_or_weaker_gas_film_cools_every_node() -> None:
    mesh, p = build_mesh("coarse"), Properties()
    thin, thick = (metal_temperature(mesh, m, 0.9) for m in (2 / 3, 4 / 3))
    assert np.all(thick < thin)
    weak = replace(p, service=replace(p.service, gas_film=2500e-6, gas_film_leading=4000e-6))
    assert np.all(metal_temperature(mesh, 2 / 3, 0.9, weak) < thin)


def test_four_picard_iterations_are_within_a_hundredth_of_a_kelvin_of_twelve() -> None:
    mesh, m = build_mesh("coarse"), Properties().material
    terms = [assemble_film(mesh, film) for film in films(1.0, 1.0, Properties())]

    def k(t: np.ndarray) -> np.ndarray:
        return np.interp(t, m.temperature_k, m.conductivity)

    gap = solve_heat(mesh, k, terms) - solve_heat(mesh, k, terms, iterations=12)
    assert np.abs(gap).max() < 0.01
