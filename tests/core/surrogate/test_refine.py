"""Runs where they are needed: the loop, its accuracy, its memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from core.archive import Archive, Input, Mesh, Quantity, Run
from core.design import Region
from core.design.region import sobol
from core.errors import InputError, ModelError
from core.surrogate import Surrogate
from core.surrogate.accuracy import Goal, accuracy, cost, relative_error
from core.surrogate.refine import Regions, refine
from core.surrogate.rounds import LOG, Plan, Refined, Round, read_log
from tests.exchanger import HIGH, LOW, TIME_H, drop

Array = NDArray[np.float64]
L, H = np.array(LOW), np.array(HIGH)
HOURS = (4000.0, 16_000.0)


def begun(folder: Path) -> Archive:
    return Archive.create(
        folder,
        inputs=[Input("roughness", LOW[0], HIGH[0]), Input("fouling_rate", LOW[1], HIGH[1])],
        time_h=TIME_H,
        mesh=Mesh.none(),
        seed=0,
        command="tests",
        quantities=[Quantity("drop", "kPa", "scalar")],
    )


def by_formula(archive: Archive, points: Mapping[int, Array], done: Callable[[int], None]) -> dict:
    for count, (k, x) in enumerate(points.items(), 1):
        archive.write(k, Run(dict(zip(("roughness", "fouling_rate"), x, strict=True)),
                             {"drop": drop(x, TIME_H)}))  # fmt: skip
        done(count)
    return {}


def corner(share: float = 0.2, count: int = 128) -> Regions:
    """Smooth tubes that foul fast, `share` of the box along each input."""
    x = sobol(count, np.array([L[0], H[1] - share * (H - L)[1]]), L + share * (H - L) * [1, 0]
              + (H - L) * [0, 1], 3)  # fmt: skip

    return lambda surrogate: (Region.of(x), "corner")


def whole(surrogate: Surrogate) -> tuple[Region, str]:
    return Region.box(L, H, 128, 3), "whole box"


def refined(
    folder: Path, wanted: float = 2e-3, regions: Regions | None = None, **plan: int
) -> Refined:
    plan = {"most": 30, "batch": 3} | plan
    return refine(
        begun(folder), by_formula, regions or corner(), [Goal("drop", wanted, HOURS)], Plan(**plan)
    )


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Refined]:
    folder = tmp_path_factory.mktemp("whole")
    return folder, refined(folder)


def test_it_ends_when_the_accuracy_is_reached_and_the_errors_keep_to_it(
    done: tuple[Path, Refined],
) -> None:
    _, found = done
    assert found.reached
    last = found.rounds[-1]
    assert found.verdict.startswith(f"accuracy reached after {last.runs} runs: drop 0.")
    assert 9 < last.runs < 30
    assert last.points == ()
    assert all(not one.accuracy[0].met for one in found.rounds[1:-1])
    region, _ = corner(count=400)(found.surrogate)
    true = np.array([drop(x, np.array(HOURS)) for x in region.x])
    mean, _ = found.surrogate.predict(region.x, "drop", HOURS)
    off = np.sqrt(np.mean((mean / true - 1) ** 2, axis=1))
    assert np.quantile(off, 0.95) < 2 * 2e-3


def test_further_runs_gather_where_the_weight_is(
    tmp_path: Path, done: tuple[Path, Refined]
) -> None:
    def new(found: Refined) -> Array:
        return np.array([x for one in found.rounds[1:] for x in one.points])

    near = np.mean(new(done[1])[:, 0] < L[0] + 0.35 * (H - L)[0])
    even = refined(tmp_path, wanted=1e-6, regions=whole, most=21)
    assert near > 0.6
    assert near > np.mean(new(even)[:, 0] < L[0] + 0.35 * (H - L)[0]) + 0.2


def test_a_refinement_that_was_cut_ends_with_the_same_runs(
    tmp_path: Path, done: tuple[Path, Refined]
) -> None:
    archive, made = begun(tmp_path), 0

    def cut(at: int) -> Callable[..., dict]:
        def runs(
            archive: Archive, points: Mapping[int, Array], told: Callable[[int], None]
        ) -> dict:
            nonlocal made
            for k, x in points.items():
                if made == at:
                    raise KeyboardInterrupt
                by_formula(archive, {k: x}, told)
                made += 1
            return {}

        return runs

    for at in (5, 11):
        with pytest.raises(KeyboardInterrupt):
            refine(archive, cut(at), corner(), [Goal("drop", 2e-3, HOURS)], Plan(most=30, batch=3))
        assert len(archive.done()) == at
    again = refined(tmp_path)
    folder, whole_one = done
    assert archive.done() == Archive.open(folder).done()
    np.testing.assert_array_equal(archive.inputs(), Archive.open(folder).inputs())
    assert [one.points for one in again.rounds] == [one.points for one in whole_one.rounds]
    assert read_log(tmp_path) == again.rounds


def test_what_falls_short_says_by_how_much_and_goes_on_with_more(tmp_path: Path) -> None:
    short = refined(tmp_path, wanted=1e-5, most=12)
    assert not short.reached
    p95 = short.rounds[-1].accuracy[0].p95
    assert short.verdict.startswith(f"fell short by a factor of {p95 / 1e-5:.3g} after 12 runs")
    assert [one.runs for one in short.rounds] == [0, 9, 12]
    more = refined(tmp_path, wanted=1e-5, most=15)
    assert [one.runs for one in more.rounds] == [0, 9, 12, 15]
    assert more.rounds[2].points != (), "the end of the first call is where the second one goes on"


def test_runs_that_fail_are_named_counted_and_tried_again(tmp_path: Path) -> None:
    def failing(archive: Archive, points: Mapping[int, Array], told: Callable[[int], None]) -> dict:
        bad = {k: "no convergence" for k in points if k in (10, 11)}
        by_formula(archive, {k: x for k, x in points.items() if k not in bad}, told)
        return bad

    goals, plan = [Goal("drop", 1e-5, HOURS)], Plan(most=18, batch=3)
    found = refine(begun(tmp_path), failing, corner(), goals, plan)
    assert dict(found.failed) == {10: "no convergence", 11: "no convergence"}
    assert found.rounds[-1].runs == 16, "18 in all, two of them failed"
    points = np.array([x for one in found.rounds for x in one.points])
    assert len(points) == len(np.unique(points, axis=0)) == 18
    again = refine(begun(tmp_path), by_formula, corner(), goals, plan)
    assert again.failed == {}
    assert again.rounds[-1].runs == 18
    np.testing.assert_allclose(Archive.open(tmp_path).inputs(), points)


def test_a_damaged_log_and_a_plan_without_sense_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="start with 9 or more"):
        refined(tmp_path / "a", start=5)
    with pytest.raises(
        InputError, match=r"most = 8 runs are too few for 2 inputs.*allow 9 or more"
    ):
        refined(tmp_path / "a", most=8)
    with pytest.raises(InputError, match="start = 12 runs are more than there may be in all, 10"):
        refined(tmp_path / "a", start=12, most=10)
    assert not read_log(tmp_path / "a"), "none of them has begun"
    with pytest.raises(InputError, match="batch = 0"):
        refined(tmp_path / "a", batch=0)
    with pytest.raises(InputError, match="names no quantity"):
        refine(begun(tmp_path / "a"), by_formula, corner(), [], Plan())
    (tmp_path / "a" / LOG).write_text('{"rounds": [{"runs": 3}]}')
    with pytest.raises(ModelError, match="move it away"):
        refined(tmp_path / "a")
    with pytest.raises(InputError, match="is not positive"):
        Goal("drop", 0.0)


def test_a_first_design_is_no_larger_than_all_runs_may_be(tmp_path: Path) -> None:
    """Of five inputs four each would be 20."""
    assert Plan(most=19).first(5) == 19
    assert Plan(most=21).first(5) == 20
    assert Plan(start=18, most=19).first(5) == 18


def test_a_round_is_read_as_it_was_written(done: tuple[Path, Refined]) -> None:
    folder, found = done
    assert read_log(folder) == found.rounds
    assert Round.from_json(found.rounds[1].to_json()) == found.rounds[1]


def test_the_relative_error_is_held_against_the_value_or_a_tenth_of_its_usual_size(
    done: tuple[Path, Refined],
) -> None:
    model, region = (
        done[1].surrogate,
        Region.of(np.array([[1.0, 2e-5], [9.0, 2e-4], [9.0, 1.9e-4]])),
    )
    goal = Goal("drop", 0.02, (250.0, 16_000.0))
    e = relative_error(model, region, goal)
    mean, sd = model.predict(region.x, "drop", goal.times_h)
    usual = np.sqrt(np.mean(mean**2, axis=0))
    held = np.maximum(np.abs(mean), 0.1 * usual)
    assert mean[0, 0] < held[0, 0], "the slow one's first value is below a tenth"
    np.testing.assert_allclose(e, np.sqrt(np.mean((sd / held) ** 2, axis=1)), rtol=1e-12)
    (told,) = accuracy(model, region, [goal])
    assert e.min() < told.median <= told.p95 <= e.max()
    _, v = model.process.mean_and_variance(model.scaled(region.x), ())
    np.testing.assert_allclose(cost(model, region, [goal]), (e / 0.02) ** 2 / v, rtol=1e-12)
    np.testing.assert_allclose(
        cost(model, region, [goal, Goal("drop", 0.01, goal.times_h)]),
        2.5 * cost(model, region, [goal]),
    )
    with pytest.raises(InputError, match="is unknown"):
        relative_error(model, region, Goal("lift", 0.1))
