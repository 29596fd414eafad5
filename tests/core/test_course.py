"""Courses of inputs in time."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.course import Course, pieces
from core.errors import InputError

RAMP = Course.of([(1000.0, 1.0), (5000.0, 0.6)])
STEP = Course.of([(0.0, 0.9), (2000.0, 0.9), (2000.0, 0.95)])


def test_a_course_is_constant_beyond_its_points_and_linear_between() -> None:
    assert RAMP.at(np.array([0.0, 1000.0, 3000.0, 5000.0, 9e4])) == pytest.approx(
        [1.0, 1.0, 0.8, 0.6, 0.6]
    )
    assert Course.of(0.7).at(123.0) == 0.7
    assert Course.of(0.7).constant
    assert not RAMP.constant
    assert Course.of(RAMP) is RAMP


def test_a_step_counts_from_its_hour_on() -> None:
    assert STEP.at(np.array([1999.9, 2000.0, 3000.0])).tolist() == [0.9, 0.95, 0.95]


def test_a_step_at_the_end_of_an_interval_hides_nothing_that_was_before_it() -> None:
    there_and_back = Course.of([(0.0, 0.0), (50.0, 5.0), (50.0, -1.0)])
    assert (there_and_back.over(0.0, 50.0).min(), there_and_back.over(0.0, 50.0).max()) == (-1, 5)
    assert set(there_and_back.over(50.0, 60.0).tolist()) == {-1.0}, "before its start it may"


def test_pieces_end_where_any_course_has_a_point_and_hold_means() -> None:
    found = pieces({"a": RAMP, "b": STEP, "c": Course.of(1.0)}, 6000.0, 4)
    ends = [0.0, 1000.0, 2000.0, 3000.0, 4000.0, 5000.0, 6000.0]
    assert found == list(itertools.pairwise(ends))
    assert [RAMP.mean(*p) for p in found] == pytest.approx([1.0, 0.95, 0.85, 0.75, 0.65, 0.6])
    assert [STEP.mean(*p) for p in found] == [0.9, 0.9, 0.95, 0.95, 0.95, 0.95]
    assert pieces({"c": Course.of(1.0)}, 10.0, 4) == [(0.0, 10.0)]


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(0, 100_000), st.floats(-10, 10)),
        min_size=1,
        max_size=6,
        unique_by=lambda point: point[0],
    ),
    st.floats(1.0, 2e5),
    st.integers(1, 12),
)
def test_pieces_cover_the_time_once_and_keep_the_integral(
    points: list[tuple[int, float]], until: float, count: int
) -> None:
    course = Course.of(sorted(points))
    found = pieces({"a": course}, until, count)
    assert found[0][0] == 0.0
    assert found[-1][1] == until
    assert all(a[1] == b[0] for a, b in itertools.pairwise(found))
    total = sum((b - a) * course.mean(a, b) for a, b in found)
    corners = np.unique(np.clip([0.0, until, *(h for h, _ in course.points)], 0.0, until))
    exact = np.trapezoid(course.at(corners), corners)
    assert total == pytest.approx(exact, rel=1e-9, abs=1e-6 * until)


@pytest.mark.parametrize(
    "bad",
    [
        [],
        [(0.0, float("nan"))],
        [(1.0, 1.0), (0.0, 1.0)],
        [(0.0, 1.0), (0.0, 2.0), (0.0, 3.0)],
    ],
)
def test_what_is_no_course_is_refused(bad: list[tuple[float, float]]) -> None:
    with pytest.raises(InputError, match="course"):
        Course.of(bad)


def test_a_shifted_course_counts_from_an_hour_of_its_own() -> None:
    """What was at hour 3000 is at 1000 where the count began at 2000; before that it goes on."""
    late = RAMP.shifted(2000.0)
    assert late.points == ((-1000.0, 1.0), (3000.0, 0.6))
    hours = np.array([0.0, 1000.0, 2500.0, 9e4])
    assert late.at(hours) == pytest.approx([0.9, 0.8, 0.65, 0.6], abs=1e-12)
    assert late.at(hours) == pytest.approx(RAMP.at(hours + 2000.0), abs=1e-12)
    assert late.shifted(-2000.0) == RAMP


def test_a_shifted_step_counts_from_its_shifted_hour_on() -> None:
    early = STEP.shifted(-500.0)
    assert early.at(np.array([2499.9, 2500.0])).tolist() == [0.9, 0.95]
