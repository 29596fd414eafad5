from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from core.surrogate.tucker import Ranks, factorise

Array = NDArray[np.float64]
TIME_H = np.concatenate([np.geomspace(1, 1000, 15), np.linspace(1000, 50_000, 39)[1:]])


def tensor(n: int = 12, rows: int = 40) -> tuple[Array, Array]:
    """y = sum_k c_ik tau_k(t) phi_k(r) of rank 3, and its coefficients."""
    rng = np.random.default_rng(6)
    c = rng.standard_normal((n, 3)) * [3.0, 1.0, 0.2]
    tau = np.column_stack([TIME_H**0.3, np.log(TIME_H), np.exp(-TIME_H / 9000)])
    return np.einsum("ik,tk,kr->itr", c, tau, rng.standard_normal((3, rows))), c


def test_a_tensor_of_rank_three_is_reproduced_with_rank_three() -> None:
    y, _ = tensor()
    factors, c = factorise(y, TIME_H, Ranks(9, 9, 9, 1e-5), seed=1)
    assert factors.space.shape == (40, 3)
    assert factors.time.shape == (53, 3)
    assert factors.coefficients == c.shape[1] == 3
    np.testing.assert_allclose(factors.decode(c, TIME_H, np.arange(40)), y, atol=2e-5)


def test_runs_not_seen_are_encoded_and_decoded_if_they_lie_in_the_same_spaces() -> None:
    y, _ = tensor(20)
    factors, _ = factorise(y[:12], TIME_H, Ranks(9, 9, 9, 1e-5), seed=1)
    back = factors.decode(factors.encode(y[12:]), TIME_H, np.arange(40))
    np.testing.assert_allclose(back, y[12:], atol=1e-4)
    strange = np.random.default_rng(2).standard_normal((1, 53, 40))
    lost = factors.decode(factors.encode(strange), TIME_H, np.arange(40)) - strange
    assert np.linalg.norm(lost) > 0.9 * np.linalg.norm(strange)


def test_the_tolerance_drops_what_is_smaller() -> None:
    y, _ = tensor()
    small = Ranks(9, 9, 9, 0.3 * float(np.std(y)))
    factors, c = factorise(y, TIME_H, small, seed=1)
    assert factors.coefficients < 3
    lost = factors.decode(c, TIME_H, np.arange(40)) - y
    assert 1e-3 < np.sqrt(np.mean(lost**2)) < 0.5 * np.std(y)


def test_caps_hold() -> None:
    y, _ = tensor()
    factors, c = factorise(y, TIME_H, Ranks(2, 1, 2, 0.0), seed=1)
    assert (factors.space.shape[1], factors.time.shape[1], c.shape[1]) == (2, 1, 2)


def test_few_rows_and_all_rows_agree() -> None:
    y, _ = tensor()
    factors, c = factorise(y, TIME_H, Ranks(9, 9, 9, 1e-9), seed=1)
    whole = factors.decode(c[:5], TIME_H[[3, 30]], np.arange(40))
    few = factors.decode(c[:5], TIME_H[[3, 30]], np.array([31, 8]))
    np.testing.assert_allclose(few, whole[:, :, [31, 8]], rtol=1e-10, atol=1e-12)


def test_between_instants_splines_in_log_time_beat_straight_lines_a_hundredfold() -> None:
    c = np.linspace(1, 2, 8)[:, None]
    y = (c * TIME_H**0.37)[:, :, None]
    factors, code = factorise(y, TIME_H, Ranks(1, 3, 3, 1e-10), seed=1)
    between = np.array([1.7, 55.0, 700.0, 1700.0, 12_345.0, 48_000.0])
    exact = c * between**0.37
    spline = np.abs(factors.decode(code, between, np.zeros(1, int))[:, :, 0] / exact - 1)
    straight = np.abs(c * np.interp(between, TIME_H, TIME_H**0.37) / exact - 1)
    assert spline.max() < 3e-4
    assert straight.max() > 100 * spline.max()


def test_before_the_first_instant_the_value_there_is_kept() -> None:
    y, _ = tensor()
    factors, c = factorise(y, TIME_H, Ranks(9, 9, 9, 1e-9), seed=1)
    early = factors.decode(c, np.array([0.0, 0.4, 1.0]), np.arange(40))
    np.testing.assert_array_equal(early[:, 0], early[:, 2])
    np.testing.assert_array_equal(early[:, 1], early[:, 2])


def test_a_part_with_a_value_at_zero_is_exact_there() -> None:
    time = np.concatenate([[0.0], TIME_H])
    y = (np.linspace(1, 2, 8)[:, None] * (100 - 4 * np.log1p(time)))[:, :, None]
    factors, c = factorise(y, time, Ranks(1, 3, 3, 1e-10), seed=1)
    found = factors.decode(c, np.array([0.0, 0.5]), np.zeros(1, int))[:, :, 0]
    np.testing.assert_allclose(found[:, 0], y[:, 0, 0], rtol=1e-10)
    np.testing.assert_allclose(found[-1, 1], 2 * (100 - 4 * np.log(1.5)), rtol=1e-9)


@pytest.mark.parametrize("hours", [[0, 500, 1000, 4000], [0, 1, 500, 1000, 2000, 4000]])
def test_a_straight_course_does_not_swing_before_a_late_instant(hours: list[float]) -> None:
    time = np.array(hours, dtype=float)
    y = (np.linspace(1, 2, 8)[:, None] * (100 - 0.01 * time))[:, :, None]
    factors, c = factorise(y, time, Ranks(1, 3, 3, 1e-10), seed=1)
    between = np.array([0.2, 5.0, 20.0, 100.0, 400.0])
    found = factors.decode(c, between, np.zeros(1, int))[-1, :, 0]
    np.testing.assert_allclose(found, 2 * (100 - 0.01 * between), atol=1e-3)


def test_a_part_without_time_is_the_same_at_all_times() -> None:
    y = np.random.default_rng(1).standard_normal((7, 1, 20))
    factors, c = factorise(y, np.zeros(1), Ranks(9, 1, 9, 1e-9), seed=1)
    found = factors.decode(c, np.array([0.0, 9.0]), np.arange(20))
    np.testing.assert_allclose(found[:, 1], y[:, 0], atol=1e-5)
    np.testing.assert_array_equal(found[:, 0], found[:, 1])


def test_one_seed_gives_one_result() -> None:
    y, _ = tensor()
    first, again = (factorise(y, TIME_H, Ranks(9, 9, 9, 1e-9), seed=4)[1] for _ in range(2))
    np.testing.assert_array_equal(first, again)
