from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.blade import BladeRun, Properties, run_campaign, simulate
from core.errors import InputError, ModelError, RangeError

INSTANTS = np.array([0.0, 5.0, 50.0])


@pytest.fixture(scope="module")
def points(base: dict[str, float]) -> list[dict[str, float]]:
    return [{**base, "t1t_rate": rate} for rate in (0.82, 0.87, 0.92, 0.97)]


def test_a_cut_campaign_resumes_with_the_runs_that_are_missing(
    points: list[dict[str, float]],
) -> None:
    got: dict[int, BladeRun] = {}
    told: list[tuple[int, int]] = []

    def cut(index: int, run: BladeRun) -> None:
        if got:
            raise KeyboardInterrupt
        got[index] = run

    with pytest.raises(KeyboardInterrupt):
        run_campaign(points, cut, mesh="coarse", processes=1, time_h=INSTANTS)
    assert len(got) == 1
    first = set(got)

    result = run_campaign(
        points,
        got.__setitem__,
        mesh="coarse",
        done=first,
        processes=2,
        progress=lambda done, total, left: told.append((done, total)) if left >= 0 else None,
        time_h=INSTANTS,
    )
    assert sorted([*first, *result.completed]) == [0, 1, 2, 3]
    assert told == [(2, 4), (3, 4), (4, 4)]
    for index, point in enumerate(points):
        alone = simulate(point, "coarse", time_h=INSTANTS)
        assert np.array_equal(got[index].displacement, alone.displacement)
        assert got[index].inputs == point


def test_truth_runs_arrive_on_the_nodes_of_the_other_mesh(points: list[dict[str, float]]) -> None:
    got: dict[int, BladeRun] = {}
    run_campaign(
        points[:1],
        got.__setitem__,
        mesh="default",
        onto="coarse",
        processes=1,
        time_h=INSTANTS[:2],
    )
    assert got[0].mesh == "coarse"
    assert got[0].ceeq.shape == (2, 1536)


def test_a_run_that_fails_is_reported_and_the_others_go_on(points: list[dict[str, float]]) -> None:
    got: dict[int, BladeRun] = {}
    result = run_campaign(
        points[:2],
        got.__setitem__,
        mesh="coarse",
        properties=[exploding(), Properties()],
        processes=1,
        time_h=INSTANTS,
    )
    assert [failure.index for failure in result.failures] == [0]
    assert "times the allowed error" in result.failures[0].reason
    assert list(got) == [1]
    with pytest.raises(ModelError, match="all 1 runs failed"):
        run_campaign(
            points[:1],
            got.__setitem__,
            mesh="coarse",
            properties=exploding(),
            processes=1,
            time_h=INSTANTS,
        )


def exploding() -> Properties:
    """A rupture line so low that the first hour ends every part of the blade."""
    p = Properties()
    return replace(p, creep=replace(p.creep, larson_miller_c=45.0, tertiary_exponent=8.0))


def test_a_bad_point_is_refused_before_any_process_starts(points: list[dict[str, float]]) -> None:
    def never(index: int, run: BladeRun) -> None:
        raise AssertionError

    with pytest.raises(RangeError, match=r"t1t_rate = 1\.4"):
        run_campaign([*points, {**points[0], "t1t_rate": 1.4}], never)
    with pytest.raises(InputError, match="choose one of"):
        run_campaign(points, never, onto="hexagons")
    with pytest.raises(InputError, match="does not fit 4 runs"):
        run_campaign(points, never, properties=[Properties()])


def test_a_campaign_with_nothing_left_starts_nothing(points: list[dict[str, float]]) -> None:
    result = run_campaign(points, lambda i, run: None, done={0, 1, 2, 3})
    assert result.completed == result.failures == ()
