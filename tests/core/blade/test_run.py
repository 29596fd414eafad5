from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.blade import BladeMesh, BladeRun, Properties, build_mesh, on_mesh, output_times, simulate
from core.blade.inputs import BOUNDS, check_inputs
from core.blade.integrate import Tolerance, Work
from core.blade.run import von_mises
from core.errors import InputError, RangeError

INPUTS = tuple(BOUNDS)
HOTTEST = dict(zip(INPUTS, (2 / 3, 1.0, 3.0, 3.0), strict=True))
COOLEST = dict(zip(INPUTS, (4 / 3, 0.8, -3.0, -3.0), strict=True))


# --- what comes out ---------------------------------------------------------------------------


def test_instants_are_zero_fifteen_logarithmic_and_thirty_eight_linear() -> None:
    t = output_times()
    assert np.diff(np.log10(t[1:16])) == pytest.approx(np.full(14, 3 / 14))
    assert np.diff(t[15:]) == pytest.approx(np.full(38, 49000 / 38))


def test_run_has_every_field_at_every_node_and_instant(coarse_run: BladeRun) -> None:
    assert coarse_run.ceeq.shape == coarse_run.creep_damage.shape == (54, 1536)
    assert coarse_run.mises.shape == (54, 1536)
    assert coarse_run.displacement.shape == coarse_run.deformation.shape == (54, 1536, 3)
    assert coarse_run.temperature.shape == (1536,)
    assert coarse_run.mesh == "coarse"
    with pytest.raises(ValueError, match="read-only"):
        coarse_run.ceeq[0, 0] = 1.0


def test_strain_and_damage_start_at_zero_and_only_grow(coarse_run: BladeRun) -> None:
    for values in (coarse_run.ceeq, coarse_run.creep_damage):
        assert not values[0].any()
        assert values[1].min() > 0
        assert np.diff(values, axis=0).min() >= 0


def test_elongation_is_the_permanent_part_of_the_tip_displacement(coarse_run: BladeRun) -> None:
    tip = build_mesh("coarse").named["tip"]
    assert coarse_run.elongation == pytest.approx(coarse_run.deformation[:, tip, 2], abs=1e-12)
    assert coarse_run.displacement[0, tip, 2] > 3 * coarse_run.elongation[-1] > 1.0


def test_elongation_after_50000_hours_is_the_declared_one(coarse_run: BladeRun) -> None:
    assert coarse_run.elongation[-1] == pytest.approx(0.374, abs=0.004)


def test_mean_stress_relaxes_towards_what_the_pull_needs(coarse_run: BladeRun) -> None:
    peak = coarse_run.mises.max(axis=1)
    assert peak[0] > 1.3 * peak[-1]
    assert coarse_run.mises[-1].mean() < coarse_run.mises[0].mean()


def test_von_mises_ignores_pressure_and_takes_shear_threefold() -> None:
    stress = np.array([[70.0, 70.0, 70.0, 0.0, 25.0, 0.0]])
    assert von_mises(stress) == pytest.approx([25 * np.sqrt(3)])


def test_a_run_repeats_bit_by_bit_and_tells_its_work_and_progress(base: dict[str, float]) -> None:
    instants = np.array([0.0, 2.0, 40.0])
    work, seen = Work(), []
    first = simulate(base, "coarse", time_h=instants, work=work, progress=seen.append)
    second = simulate(base, "coarse", time_h=instants)
    assert np.array_equal(first.displacement, second.displacement)
    assert first.ceeq.dtype == np.float32
    assert seen == pytest.approx([1 / 3, 2 / 3, 1.0])
    assert 2 * work.steps < work.evaluations < 400


def test_fields_on_another_mesh_keep_their_sign_and_their_values_at_common_points(
    coarse_run: BladeRun,
) -> None:
    coarse, default = build_mesh("coarse"), build_mesh("default")
    there = on_mesh(coarse_run, coarse, default)
    assert there.mesh == "default"
    assert there.displacement.shape == (54, 5600, 3)
    assert there.ceeq[1:].min() > 0
    for name in ("tip", "critical"):
        a, b = coarse.named[name], default.named[name]
        assert there.displacement[:, b] == pytest.approx(coarse_run.displacement[:, a], abs=1e-12)
        assert there.ceeq[:, b] == pytest.approx(coarse_run.ceeq[:, a], rel=1e-9)


# --- physics ----------------------------------------------------------------------------------

SWEEPS = {
    "tbc_thickness": ((2 / 3, 4 / 3), -1),
    "t1t_rate": ((0.8, 1.0), 1),
    "creep_transient": ((-3.0, 3.0), 1),
    "creep_steady": ((-3.0, 3.0), 1),
}
LATE = np.array([0.0, 2000.0, 8000.0, 20000.0])
LOOSE = Tolerance(relative=1e-2, absolute=5e-6)  # meshes and inputs are compared, not time steps


@pytest.fixture(scope="module")
def middle(base: dict[str, float]) -> np.ndarray:
    return simulate(base, "coarse", time_h=LATE, tolerance=LOOSE).elongation


@pytest.mark.parametrize("name", INPUTS)
def test_elongation_is_monotone_in_each_input_at_every_late_instant(
    name: str, base: dict[str, float], middle: np.ndarray
) -> None:
    (low, high), sign = SWEEPS[name]
    ends = [
        simulate({**base, name: value}, "coarse", time_h=LATE, tolerance=LOOSE).elongation
        for value in (low, high)
    ]
    steps = sign * np.diff([ends[0], middle, ends[1]], axis=0)[:, 1:]
    assert np.all(steps > 0.05 * middle[1:])


def test_a_starved_coolant_makes_the_blade_longer(
    base: dict[str, float], middle: np.ndarray
) -> None:
    p = Properties()
    starved = replace(p, service=replace(p.service, coolant_film=0.9 * p.service.coolant_film))
    longer = simulate(base, "coarse", starved, time_h=LATE[:2], tolerance=LOOSE).elongation
    assert longer[1] > 1.2 * middle[1]


EXTREMES = {
    "centre": ({**HOTTEST, "tbc_thickness": 1.0, "t1t_rate": 0.9}, 600.0),
    "hottest": (HOTTEST, 60.0),
    "coolest": (COOLEST, 10000.0),
}
# mm, by `elongation_at(place, "fine")`, which takes 10 s each; where the physics changes, the
# default mesh leaves these, too, and they are to be made again
FINE = {"centre": 0.105561, "hottest": 0.151305, "coolest": 0.0217736}


@pytest.fixture(scope="module")
def stretched() -> dict[str, float]:
    """Elongation of the default mesh at the end of each of the EXTREMES."""
    return {place: elongation_at(place, "default") for place in EXTREMES}


def elongation_at(place: str, mesh: str | BladeMesh) -> float:
    point, until = EXTREMES[place]
    run = simulate(point, mesh, time_h=np.array([0.0, until]), tolerance=LOOSE)
    return float(run.elongation[-1])


@pytest.mark.parametrize("place", EXTREMES)
def test_default_mesh_elongates_within_one_percent_of_the_finer_one(
    place: str, stretched: dict[str, float]
) -> None:
    assert stretched[place] == pytest.approx(FINE[place], rel=0.01)


def test_one_element_through_the_wall_misses_that_percent(stretched: dict[str, float]) -> None:
    single = elongation_at("coolest", build_mesh((40, 1, 12)))
    assert abs(single / stretched["coolest"] - 1) > 0.02


# --- what is refused --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "what", "problem"),
    [
        ({"t1t_rate": 90.0}, "t1t_rate", "outside 0.8 … 1"),
        ({"tbc_thickness": 0.6}, "tbc_thickness", "outside 0.6667 … 1.333"),
        ({"creep_steady": float("nan")}, "creep_steady", "not finite"),
        ({"creep_transient": float("-inf")}, "creep_transient", "not finite"),
        ({"creep_steady": "fast"}, "creep_steady", "not a number"),
        ({"coating": 1.0}, "coating", "not an input"),
    ],
)
def test_an_impossible_input_is_refused_by_name_with_its_value(
    change: dict[str, float], what: str, problem: str, base: dict[str, float]
) -> None:
    with pytest.raises(InputError, match=problem) as caught:
        simulate({**base, **change}, "coarse")
    assert caught.value.what == what
    assert caught.value.value is change[what] or caught.value.value == change[what]


def test_a_missing_input_is_refused(base: dict[str, float]) -> None:
    with pytest.raises(InputError, match="creep_steady = None is missing"):
        check_inputs({k: v for k, v in base.items() if k != "creep_steady"})


def test_wider_bounds_admit_what_the_box_refuses(base: dict[str, float]) -> None:
    hot = {**base, "t1t_rate": 1.05}
    with pytest.raises(RangeError):
        check_inputs(hot)
    assert check_inputs(hot, {**BOUNDS, "t1t_rate": (0.7, 1.1)})["t1t_rate"] == 1.05


@pytest.mark.parametrize("bad", [[0.0], [1.0, 2.0], [0.0, 5.0, 5.0], [0.0, float("nan")]])
def test_instants_that_do_not_increase_from_zero_are_refused(
    bad: list[float], base: dict[str, float]
) -> None:
    with pytest.raises(InputError) as caught:
        simulate(base, "coarse", time_h=np.array(bad))
    assert caught.value.what == "time_h"


def test_an_unknown_mesh_is_refused(base: dict[str, float]) -> None:
    with pytest.raises(InputError, match="choose one of coarse, default, fine, paper"):
        simulate(base, "medium")


def test_the_papers_size_of_mesh_agrees_with_the_refined_one(base: dict[str, float]) -> None:
    """At 300 h; over the whole horizon by `tests/benchmarks/bench_blade.py paper`."""
    hours = np.array([0.0, 300.0])
    runs = {
        mesh: simulate(base, mesh, time_h=hours, tolerance=LOOSE) for mesh in ("paper", "coarse")
    }
    assert runs["paper"].ceeq.shape[1] == 27_360
    fine = 0.032693  # mm, by the mesh `fine` in the same steps
    assert abs(runs["paper"].elongation[-1] / fine - 1) < 0.002
    assert abs(runs["coarse"].elongation[-1] / fine - 1) > 0.002  # negative control
