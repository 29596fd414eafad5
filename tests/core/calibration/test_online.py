"""The online update: what it reads, what it may differ in, and what it must never."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.calibration import quick as quickly
from core.calibration import sets
from core.calibration.message import BladeMessage
from core.calibration.online import RotorSpec, RotorState, Workspace, begun, update
from core.calibration.smooth import NEARLY
from core.calibration.space import shared_space
from core.calibration.state import shared_posterior
from core.calibration.surface import Surface
from core.calibration.target import assemble
from core.errors import InputError
from core.observation import Inspection
from core.smc.particles import normalised
from core.smc.placement import moments, sobol
from tests.core.calibration.bar import bar, measured

MODEL = bar()
BLADES = 6
SPEC = RotorSpec("r", tuple(f"b{i}" for i in range(BLADES)), 6000, 3)
READINGS = measured(BLADES, (8e3, 16e3), 0)
ROWS = [assemble(MODEL, [r for r in READINGS if r.blade == b]) for b in SPEC.blades]
SPACE = shared_space(MODEL, [rows for rows in ROWS if rows is not None])
LATE = measured(BLADES, (24e3,), 1)[2]


@pytest.fixture(scope="module")
def before() -> RotorState:
    return update(MODEL, SPEC, READINGS)


@pytest.fixture(scope="module")
def with_late() -> RotorState:
    """Of the late reading, too, calibrated from nothing."""
    return update(MODEL, SPEC, [*READINGS, LATE])


def stored(state: RotorState, asked: list[str]) -> RotorState:
    """The state as another process finds it: arrays are fetched by name."""

    def get(name: str) -> np.ndarray:
        asked.append(name)
        return state.arrays[name]

    return RotorState.restore(state.meta, get)


def test_a_sealed_state_has_the_moments_of_its_surface(before: RotorState) -> None:
    arrays = before.arrays
    unit, log_w = arrays["shared/unit"], arrays["shared/log_p"] - arrays["shared/log_q"]
    assert np.any(arrays["shared/tilt"])
    np.testing.assert_allclose(
        normalised(arrays["shared/log_w"]), normalised(log_w + arrays["shared/tilt"]), rtol=1e-9
    )
    at = arrays["shared/x"]
    surface, error = Surface.through(unit, arrays["shared/log_p"], normalised(log_w), at)
    assert before.meta["health"]["surface_error_nat"] == pytest.approx(error, abs=1e-4)
    box = np.clip(moments(unit, normalised(log_w))[0] + [[-0.5], [0.5]], 0.0, 1.0)
    grid = box[0] + sobol(2**15, unit.shape[1], 5) * (box[1] - box[0])
    w, tilted = normalised(surface(grid)), normalised(arrays["shared/log_w"])
    x, dense = at[:, 0], SPACE.to_x(grid)[:, 0]
    sd = np.sqrt(w @ (dense - w @ dense) ** 2)
    assert tilted @ x == pytest.approx(w @ dense, abs=0.01 * sd)
    assert np.sqrt(tilted @ (x - tilted @ x) ** 2) == pytest.approx(sd, rel=0.01)


def test_a_quick_update_reads_and_makes_the_touched_blade_only(before: RotorState) -> None:
    asked: list[str] = []
    state = update(MODEL, SPEC, [*READINGS, LATE], stored(before, asked), quick=True)
    assert not state.sealed
    assert state.meta["provisional"] == [LATE.blade]
    shared = {"shared/unit", "shared/log_p", "shared/log_q", "shared/tilt"}
    assert set(asked) == shared | {f"column/{LATE.blade}"}
    own = {f"column/{LATE.blade}", f"blade/{LATE.blade}/local", f"blade/{LATE.blade}/log_w"}
    assert state.fresh == own | {"shared/log_p", "shared/log_w"}
    assert set(state.meta["arrays"]) == set(state.arrays) == set(before.arrays)


def test_a_quick_update_weighs_as_if_every_message_were_new(before: RotorState) -> None:
    """Differences of columns lead where the sum of all columns leads."""
    late = measured(BLADES, (32e3,), 2)[:3]
    state = before
    for i in range(3):
        state = update(MODEL, SPEC, [*READINGS, *late[: i + 1]], stored(state, []), quick=True)
        assert not state.sealed
    total = sum(state.arrays[f"column/{b}"] for b in SPEC.blades)
    space_prior = before.arrays["shared/log_p"] - sum(
        before.arrays[f"column/{b}"] for b in SPEC.blades
    )
    assert state.arrays["shared/log_p"] == pytest.approx(total + space_prior, abs=1e-9)


def test_a_quick_update_says_that_its_messages_are_nearly_known(before: RotorState) -> None:
    """Computed at some of the nodes, within `NEARLY` of all of them; the health counts that."""
    work = Workspace()
    state = update(MODEL, SPEC, [*READINGS, LATE], before, quick=True, workspace=work)
    (column,) = work.columns.kept.values()
    assert column.computed < len(column.values)
    rows = assemble(MODEL, [r for r in [*READINGS, LATE] if r.blade == LATE.blade])
    assert rows is not None
    exact = BladeMessage(MODEL, rows, SPACE, {}).column(state.arrays["shared/unit"])
    left = state.arrays[f"column/{LATE.blade}"] - exact
    assert 0.0 < np.sqrt(np.mean(left**2)) < NEARLY
    assert state.meta["health"]["message_error_nat"] > NEARLY
    assert before.meta["health"]["message_error_nat"] < NEARLY


def test_sealed_states_remember_no_path(before: RotorState, with_late: RotorState) -> None:
    """Late, shuffled, over quick states of fewer draws, from another process: bit-identical."""
    readings, alone = [*READINGS, LATE], with_late
    quick = update(MODEL, SPEC, readings, before, quick=True)
    assert alone.meta["provisional"] == []
    shuffled = [readings[i] for i in np.random.default_rng(5).permutation(len(readings))]
    work = Workspace()
    for previous in (quick, stored(quick, []), before, None):
        again = update(MODEL, SPEC, shuffled, previous, workspace=work)
        assert again.sealed
        assert again.digest == alone.digest
    retracted = update(MODEL, SPEC, READINGS, alone)
    assert retracted.digest == before.digest


def test_rotors_with_equal_readings_share_no_column_in_one_workspace() -> None:
    """Their proposals may be equal, their nodes are not: the seed is the rotor's own."""
    work, few = Workspace(), replace(SPEC, blades=SPEC.blades[:3], particles=600)
    readings = [r for r in READINGS if r.blade in few.blades]
    for number in range(4):
        spec = replace(few, seed=number)
        alone, beside = (update(MODEL, spec, readings, workspace=w) for w in (None, work))
        assert set(alone.arrays) == set(beside.arrays)
        for name in alone.arrays:
            np.testing.assert_array_equal(alone.arrays[name], beside.arrays[name], err_msg=name)


def test_draws_of_a_provisional_blade_are_not_sealed_in(before: RotorState) -> None:
    """The mutant takes over every draw at the same nodes: the digest shows it."""
    readings = [*READINGS, replace(LATE, sigma=0.5)]  # hardly moves the nodes
    alone = update(MODEL, SPEC, readings)
    quick = update(MODEL, SPEC, readings, before, quick=True)
    assert alone.meta["placement"] == quick.meta["placement"], "the case needs unmoved nodes"
    assert update(MODEL, SPEC, readings, quick).digest == alone.digest
    mutant = RotorState({**quick.meta, "provisional": []}, quick.arrays)
    assert update(MODEL, SPEC, readings, mutant).digest != alone.digest


def test_draws_that_a_workspace_keeps_from_a_quick_step_are_not_sealed_in(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The quick step has as many draws here, of a column that it knows only nearly."""
    few = replace(SPEC, particles=quickly.PROVISIONAL // 2)
    readings = [*READINGS, replace(LATE, sigma=0.5)]
    first, alone = update(MODEL, few, READINGS), update(MODEL, few, readings)

    def sealed_over_a_quick_step() -> RotorState:
        work = Workspace()
        quick = update(MODEL, few, readings, first, quick=True, workspace=work)
        assert quick.meta["placement"] == alone.meta["placement"], "the case needs unmoved nodes"
        return update(MODEL, few, readings, quick, workspace=work)

    assert sealed_over_a_quick_step().digest == alone.digest
    monkeypatch.setattr(sets, "array_digest", lambda column: "")
    assert sealed_over_a_quick_step().digest != alone.digest, "mutant"


def test_a_reading_that_too_few_nodes_carry_is_sealed_at_once(before: RotorState) -> None:
    far = [replace(r, values=r.values * 1.12) for r in measured(BLADES, (24e3,), 0)]
    state = update(MODEL, SPEC, [*READINGS, *far], before, quick=True)
    assert state.sealed
    assert state.meta["health"]["ess_ratio"] >= 0.3


def test_a_surprising_reading_tempers_the_shared_level_until_it_is_sealed(
    before: RotorState,
) -> None:
    surprise = replace(LATE, values=LATE.values * 0.77)
    readings = [*READINGS, surprise]
    state = update(MODEL, SPEC, readings, before, quick=True)
    assert not state.sealed
    health = state.meta["health"]
    assert 0.2 <= health["tempered"] < 1.0
    assert health["ess_ratio"] == pytest.approx(quickly.QUICK_ESS, abs=0.01)
    part = {name: state.arrays[f"shared/{name}"] for name in ("log_p", "log_q", "tilt")}
    whole = part["log_p"] - part["log_q"] + part["tilt"]
    evidence = float(np.logaddexp.reduce(whole)) - np.log(len(whole))
    assert state.meta["log_evidence"] == pytest.approx(evidence, abs=1e-9), "of p, not of p^beta"
    exact = update(MODEL, SPEC, readings)
    assert exact.meta["health"]["tempered"] == 1.0
    assert update(MODEL, SPEC, readings, state).digest == exact.digest

    def moments(of: RotorState) -> tuple[float, float]:
        shared = shared_posterior(of.meta, of.arrays.__getitem__).particles
        return float(shared.mean[0]), float(np.sqrt(shared.covariance[0, 0]))

    (mean, sd), (true_mean, true_sd) = moments(state), moments(exact)
    assert sd > 0.8 * true_sd, "tempered: not falsely sharp"
    assert abs(mean - true_mean) < 3 * sd


def test_a_state_of_another_algorithm_is_not_built_upon(
    before: RotorState, with_late: RotorState
) -> None:
    old = RotorState({**before.meta, "algorithm_version": "older"}, before.arrays)
    state = update(MODEL, SPEC, [*READINGS, LATE], old, quick=True)
    assert state.digest == with_late.digest


def test_a_blade_that_joins_gets_its_prior_and_what_the_others_told(before: RotorState) -> None:
    more = replace(SPEC, blades=(*SPEC.blades, "new"))
    state = update(MODEL, more, READINGS, before, quick=True)
    assert state.arrays["blade/new/local"].shape[0] == len(before.arrays["shared/log_w"])
    assert np.array_equal(state.arrays["shared/log_w"], before.arrays["shared/log_w"])
    sealed = update(MODEL, more, READINGS, state)
    assert sealed.digest == update(MODEL, more, READINGS).digest


def test_particles_are_at_least_as_many_as_asked_for(before: RotorState) -> None:
    k, m, dim = before.arrays["blade/b0/local"].shape
    assert dim == 3
    assert k * m == before.meta["particles"] >= SPEC.particles
    quick = update(MODEL, SPEC, [*READINGS, LATE], before, quick=True)
    k, m, _ = quick.arrays[f"blade/{LATE.blade}/local"].shape
    assert quickly.PROVISIONAL <= k * m < SPEC.particles


def test_a_reading_of_an_unknown_blade_is_refused() -> None:
    stray = Inspection("x", "b99", "y", 8e3, np.array([0.1]))
    with pytest.raises(InputError, match="b99"):
        update(MODEL, SPEC, [stray])


def test_a_sealed_state_of_the_same_readings_is_the_answer(before: RotorState) -> None:
    for quick in (True, False):
        state = update(MODEL, SPEC, list(reversed(READINGS)), before, quick=quick)
        assert state.meta is before.meta
        assert state.arrays is before.arrays
        assert not state.fresh, "nothing is to be written anew"
    fewer, more = replace(SPEC, particles=400), replace(SPEC, blades=(*SPEC.blades, "new"))
    for spec, readings in ((fewer, READINGS), (more, READINGS), (SPEC, READINGS[1:])):
        state = update(MODEL, spec, readings, before)
        assert state.arrays is not before.arrays
        assert state.digest == update(MODEL, spec, readings).digest
    quick = update(MODEL, SPEC, [*READINGS, LATE], before, quick=True)
    assert update(MODEL, SPEC, [*READINGS, LATE], quick).sealed


def test_where_a_few_blades_leave_too_few_nodes_no_other_is_looked_at(
    before: RotorState, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(quickly, "FIRST", 2)
    after = [replace(r, values=r.values * 1.3) for r in measured(BLADES, (24e3,), 0)]

    def looked_at(readings: list[Inspection]) -> int:
        work = Workspace()
        quickly.reweighted(begun(MODEL, SPEC, readings, workspace=work), before)
        return len({name for name, _, _ in work.columns.kept})

    assert looked_at([*READINGS, *after]) == 2
    gentle = [replace(r, sigma=0.5) for r in measured(BLADES, (24e3,), 0)]
    assert looked_at([*READINGS, *gentle]) == BLADES
    monkeypatch.setattr(quickly, "FIRST_ESS", 0.0)
    assert looked_at([*READINGS, *after]) == BLADES, "control"


def test_particles_drawn_side_by_side_are_those_drawn_one_after_the_other(
    before: RotorState, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sets, "PARTS", BLADES + 1)
    assert update(MODEL, SPEC, READINGS).digest == before.digest


@pytest.mark.parametrize("after", [1, 3])
def test_an_update_ends_where_what_it_heeds_raises_and_loses_nothing(
    before: RotorState, after: int
) -> None:
    """And the same workspace then makes the same state."""
    calls: list[bool] = []

    def heed() -> None:
        calls.append(True)
        if len(calls) == after:
            raise StopAsyncIteration

    work = Workspace(heed=heed)
    with pytest.raises(StopAsyncIteration):
        update(MODEL, SPEC, READINGS, workspace=work)
    assert len(calls) == after
    assert update(MODEL, SPEC, READINGS, workspace=work).digest == before.digest
    known = len(calls)
    update(MODEL, SPEC, READINGS, workspace=work)
    assert len(calls) == known, "nothing was computed"
