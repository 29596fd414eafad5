"""Runs whose inputs change in time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from core.blade import MESHES, BladeRun, Properties, build_mesh, simulate, simulate_history
from core.blade.inputs import DORMANT, check_inputs, declared
from core.course import Course
from core.errors import InputError, RangeError

POINT = {"tbc_thickness": 1.0, "t1t_rate": 0.95, "creep_transient": 0.0, "creep_steady": 1.0}
TIMES = np.array([0.0, 100.0, 2000.0, 4000.0, 8000.0])


@pytest.fixture(scope="module", autouse=True)
def small() -> Iterator[None]:
    """A mesh of 416 nodes: only runs on the same mesh are compared."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(MESHES, "small", (8, 2, 4))
        yield


@pytest.fixture(scope="module")
def unwoken() -> BladeRun:
    return simulate(POINT, "small", time_h=TIMES)


def test_inputs_that_do_not_change_give_the_constant_run(unwoken: BladeRun) -> None:
    constant = unwoken
    same = [(0.0, 0.95), (2500.0, 0.95), (2500.0, 0.95), (4500.0, 0.95)]
    history = simulate_history({**POINT, "t1t_rate": same}, "small", time_h=TIMES)
    assert history.elongation == pytest.approx(constant.elongation, rel=1e-3)
    assert history.ceeq == pytest.approx(constant.ceeq, rel=1e-2, abs=1e-7)
    assert history.displacement == pytest.approx(constant.displacement, abs=1e-3)
    assert history.inputs == constant.inputs
    assert history.temperature == pytest.approx(constant.temperature)


def test_a_step_leaves_the_past_alone_and_no_growth_by_heat_counts() -> None:
    """Just after the gas got 30 K hotter the blade is no longer, cold; then it creeps faster."""
    times = np.array([0.0, 100.0, 3999.0, 4001.0, 8000.0])
    before = simulate(POINT, "small", time_h=times)
    hotter = Course.of([(0.0, 0.95), (4000.0, 0.95), (4000.0, 1.0)])
    after = simulate_history({**POINT, "t1t_rate": hotter}, "small", time_h=times)
    assert after.elongation[:3] == pytest.approx(before.elongation[:3], rel=1e-3)
    across = after.elongation[3] - after.elongation[2]
    assert 0 < across < 1e-3 * after.elongation[2] + 1e-4
    grown = after.elongation[4] - after.elongation[3]
    assert grown > 2 * (before.elongation[4] - before.elongation[3])


def test_a_ramp_ends_between_the_runs_at_its_ends() -> None:
    low, high = (simulate({**POINT, "t1t_rate": r}, "small", time_h=TIMES) for r in (0.9, 1.0))
    ramp = simulate_history(
        {**POINT, "t1t_rate": [(0.0, 0.9), (8000.0, 1.0)]}, "small", time_h=TIMES, parts=6
    )
    tip = build_mesh("small").named["critical"]
    assert low.creep_damage[-1, tip] < ramp.creep_damage[-1, tip] < high.creep_damage[-1, tip]
    assert low.elongation[-1] < ramp.elongation[-1] < high.elongation[-1]
    assert np.all(np.diff(ramp.ceeq, axis=0) >= 0)


def test_more_pieces_of_a_ramp_change_little_and_ever_less() -> None:
    worn = {**POINT, "tbc_thickness": [(0.0, 1.0), (8000.0, 0.7)]}
    found = [
        simulate_history(worn, "small", time_h=TIMES, parts=n).elongation[-1] for n in (3, 6, 12)
    ]
    assert abs(found[1] - found[2]) < 0.5 * abs(found[0] - found[2])
    assert found[1] == pytest.approx(found[2], rel=2e-3)


@pytest.mark.parametrize(
    ("name", "value", "longer"),
    [
        ("cooling_flow", 0.9, True),
        ("tertiary", 4.0, True),
        ("gas_profile_peak", 0.55, None),
        ("wall_loss", 0.1, True),
    ],
)
def test_each_dormant_input_acts(
    name: str, value: float, longer: bool | None, unwoken: BladeRun
) -> None:
    woken = simulate({**POINT, name: value}, "small", time_h=TIMES)
    nominal = simulate({**POINT, name: DORMANT[name].nominal}, "small", time_h=TIMES)
    assert nominal.elongation == pytest.approx(unwoken.elongation, rel=1e-12)
    change = woken.elongation[-1] - unwoken.elongation[-1]
    assert abs(change) > 1e-3
    assert longer is None or (change > 0) == longer
    assert woken.inputs == {**POINT, name: value}


def test_the_declared_blade_changes_only_where_it_is_told() -> None:
    plain = Properties()
    assert declared(plain, POINT) == plain
    thin = declared(plain, {"wall_loss": 0.1})
    assert thin.geometry.wall_root == pytest.approx(0.9 * plain.geometry.wall_root)
    assert thin.service == plain.service
    assert declared(plain, {"cooling_flow": 0.9}).service.coolant_film == pytest.approx(
        plain.service.coolant_film * 0.9**0.8
    )


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(RangeError, match="cooling_flow"):
        check_inputs({**POINT, "cooling_flow": 2.0})
    with pytest.raises(InputError, match=r"wall_loss.*cannot change in time"):
        simulate_history({**POINT, "wall_loss": [(0.0, 0.0), (1e4, 0.1)]}, "small")
    with pytest.raises(RangeError, match="t1t_rate"):
        simulate_history({**POINT, "t1t_rate": [(0.0, 0.9), (1e4, 1.2)]}, "small")
    with pytest.raises(InputError, match="t1t_rate"):
        simulate_history({k: v for k, v in POINT.items() if k != "t1t_rate"}, "small")
