"""A posterior that is nearly known from another: found in fewer steps, and the same."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from core.calibration.online import RotorSpec, Workspace, begun
from core.calibration.start import Start
from core.calibration.state import shared_posterior
from core.calibration.step import Step
from tests.core.calibration.bar import bar, measured

MODEL = bar()
READINGS = measured(14, (0.6e4, 1.5e4), seed=5)
SPEC = RotorSpec("r", tuple(f"b{b}" for b in range(14)), 1000, 3)


def made(start: Start | None = None) -> tuple[Step, int]:
    """The update, its nodes weighed, and how many columns that took."""
    work = Workspace()
    step = begun(MODEL, SPEC, READINGS, workspace=work, start=start)
    step.weighed  # noqa: B018
    return step, work.columns.computed


@pytest.fixture(scope="module")
def nothing() -> tuple[Step, int]:
    """From no start: what the others are held against."""
    return made()


@pytest.fixture(scope="module")
def near(nothing: tuple[Step, int]) -> tuple[Step, int]:
    """From where it is expected, twice as wide."""
    return made(Start.of(MODEL, nothing[0].sealed()).wider(2.0))


def far(alone: Step) -> Start:
    known = Start.of(MODEL, alone.sealed())
    sd = np.sqrt(np.diag(known.covariance))
    return replace(known, mean=known.mean + np.array([-12.0, 8.0]) * sd)


@pytest.fixture(scope="module")
def misled(nothing: tuple[Step, int]) -> tuple[Step, int]:
    """From a start that is far off."""
    return made(far(nothing[0]))


def test_from_where_it_is_expected_the_same_posterior_is_found_in_a_quarter_of_the_columns(
    nothing: tuple[Step, int], near: tuple[Step, int]
) -> None:
    (alone, many), (again, few) = nothing, near
    assert again.log_evidence == pytest.approx(alone.log_evidence, abs=0.05)
    mine, other = (
        shared_posterior(one.meta, one.arrays.__getitem__).particles
        for one in (again.sealed(), alone.sealed())
    )
    sd = np.sqrt(other.w @ (other.psi - other.mean) ** 2)
    assert np.all(np.abs(mine.mean - other.mean) < 0.05 * sd)
    assert 4 * few <= many


def test_a_start_that_is_far_off_costs_time_and_changes_nothing(
    nothing: tuple[Step, int], misled: tuple[Step, int]
) -> None:
    alone, _ = nothing
    assert misled[0].log_evidence == pytest.approx(alone.log_evidence, abs=0.1)


def test_where_a_start_is_to_be_alone_nothing_is_looked_for_elsewhere(
    nothing: tuple[Step, int], near: tuple[Step, int], misled: tuple[Step, int]
) -> None:
    known = Start.of(MODEL, nothing[0].sealed())
    (found, many), (lost, few) = misled, made(replace(far(nothing[0]), alone=True))
    assert 2 * few < many
    assert 2 * lost.weighed.ess_ratio < found.weighed.ess_ratio, "and its share tells"
    there = made(replace(known.wider(2.0), alone=True))
    assert near[1] == there[1]
    assert near[0].sealed().digest == there[0].sealed().digest


def test_what_may_be_served_is_carried_by_as_many_nodes_as_from_nothing(
    nothing: tuple[Step, int],
) -> None:
    """From a start of four times the variances a third of the nodes is enough to compare."""
    known = Start.of(MODEL, nothing[0].sealed()).wider(4.0)
    compared, served = made(known)[0], made(replace(known, served=True))[0]
    assert 0.3 <= compared.weighed.ess_ratio < 0.5 <= served.weighed.ess_ratio
    assert compared.question != served.question, "one is no answer to the other"


def test_what_was_found_before_is_not_searched_again(nothing: tuple[Step, int]) -> None:
    """By another process, from JSON: the same bits for a part of the columns; other readings, or
    another start, are another question."""
    places: dict[str, Any] = {}
    work = Workspace(places)
    step = begun(MODEL, SPEC, READINGS, workspace=work)
    first = step.sealed()
    kept = json.loads(json.dumps(places))
    assert len(kept) == 1
    again = Workspace(kept)
    other = begun(MODEL, SPEC, READINGS, workspace=again)
    assert other.sealed().digest == first.digest == nothing[0].sealed().digest
    assert 2 * again.columns.computed < work.columns.computed
    known = Start.of(MODEL, first)
    for more in (
        begun(MODEL, SPEC, READINGS[1:], workspace=again),
        begun(MODEL, SPEC, READINGS, workspace=again, start=known),
        begun(MODEL, replace(SPEC, seed=4), READINGS, workspace=again),
    ):
        assert more.question not in kept
    begun(MODEL, SPEC, READINGS[1:], workspace=again).weighed  # noqa: B018
    assert len(kept) == 2


def test_a_start_for_other_parameters_is_none(nothing: tuple[Step, int]) -> None:
    alone, many = nothing
    known = Start.of(MODEL, alone.sealed())
    other = replace(known, names=("rate", "sigma_obs.z"))
    assert other.on(alone.space) is None
    step, columns = made(other)
    assert columns == many - len(SPEC.blades), "near messages at the nodes do for a comparison"
    step.sealed()
    assert step.work.columns.computed == many, "and exact ones are there once it is sealed"
    assert step.log_evidence == pytest.approx(alone.log_evidence, abs=0.1)


def test_the_moments_are_those_of_the_particles_on_the_scale_of_the_prior(
    nothing: tuple[Step, int],
) -> None:
    state = nothing[0].sealed()
    known, shared = Start.of(MODEL, state), shared_posterior(state.meta, state.arrays.__getitem__)
    w, x = shared.particles.w, shared.particles.psi.copy()
    noise = shared.names.index("sigma_obs.y")
    x[:, noise] = np.log(x[:, noise])
    assert known.mean == pytest.approx(w @ x, rel=1e-12)
    off = x - w @ x
    assert known.covariance == pytest.approx((off * w[:, None]).T @ off, rel=1e-9)


def test_a_parameter_that_is_held_leaves_the_others_as_they_are_given_it() -> None:
    """Three normal ones, two held: against the joint precision matrix."""
    rng = np.random.default_rng(2)
    root = rng.normal(size=(3, 3))
    whole = Start(("a", "b", "c"), np.array([0.3, -1.1, 2.0]), root @ root.T)
    left = whole.held({"a": 0.7, "c": 1.4})
    precision = np.linalg.inv(root @ root.T)
    pull = precision[1, [0, 2]] @ (np.array([0.7, 1.4]) - whole.mean[[0, 2]])
    assert left.names == ("b",)
    assert left.covariance[0, 0] == pytest.approx(1 / precision[1, 1], rel=1e-9)
    assert left.mean[0] == pytest.approx(-1.1 - pull / precision[1, 1], rel=1e-9)
