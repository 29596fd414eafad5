"""Where further runs take most of the variance: against refitting by brute force."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from core.design import Region, choose, maximin_lhs, reductions
from core.errors import InputError
from core.surrogate.kernel import Hyper, SharedGP

Array = NDArray[np.float64]
LOW, HIGH = [-1.0] * 3, [1.0] * 3


def process(trend: int, lengths: tuple[float, ...] = (0.9, 1.7, 2.6), n: int = 24) -> SharedGP:
    z = maximin_lhs(n, LOW, HIGH, seed=11)
    targets = np.column_stack([np.sin(2 * z[:, 0]) + z[:, 1], z[:, 2] ** 2])
    return SharedGP.condition(z, targets, Hyper(lengths, 3e-5, trend))


def with_runs(before: SharedGP, at: Array) -> SharedGP:
    """Conditioned anew; what the further runs say does not matter to the variance."""
    z = np.vstack([before.z, at])
    return SharedGP.condition(z, np.random.default_rng(0).normal(size=(len(z), 1)), before.hyper)


def variance(one: SharedGP, z: Array) -> Array:
    return one.mean_and_variance(z, ())[1]


@pytest.fixture
def points() -> tuple[Array, Array, Array]:
    """Candidates (30, 3), reference points (50, 3), uneven weights."""
    rng = np.random.default_rng(4)
    weight = rng.gamma(0.5, size=50)
    return rng.uniform(-1, 1, (30, 3)), rng.uniform(-1, 1, (50, 3)), weight / weight.sum()


@pytest.mark.parametrize("trend", [0, 1, 2])
def test_a_reduction_is_what_refitting_with_the_run_takes(
    trend: int, points: tuple[Array, Array, Array]
) -> None:
    candidates, reference, weight = points
    before = process(trend)
    told = reductions(before, candidates, reference, weight)
    for k in (0, 7, 29):
        after = with_runs(before, candidates[k : k + 1])
        fallen = weight @ (variance(before, reference) - variance(after, reference))
        assert told[k] == pytest.approx(fallen, rel=1e-7)
    assert told.max() > 5 * np.median(told), "uneven enough to be a choice"


def test_a_batch_is_the_greedy_one_of_refitting_after_every_run(
    points: tuple[Array, Array, Array],
) -> None:
    candidates, reference, weight = points
    index, gains = choose(process(1), candidates, reference, weight, 4)
    now = process(1)
    for k, gain in zip(index, gains, strict=True):
        every = reductions(now, candidates, reference, weight)
        assert int(np.argmax(every)) == k
        assert gain == pytest.approx(every[k], rel=1e-6)
        now = with_runs(now, candidates[k : k + 1])
    first = np.argsort(reductions(process(1), candidates, reference, weight))[::-1][:4]
    assert set(first.tolist()) != set(index.tolist()), "the four best alone are not the best four"


def test_points_that_are_pending_count_as_run(points: tuple[Array, Array, Array]) -> None:
    candidates, reference, weight = points
    (best,), _ = choose(process(1), candidates, reference, weight, 1)
    index, gains = choose(
        process(1), candidates, reference, weight, 3, pending=candidates[[best, 5]]
    )
    again, same = choose(
        with_runs(process(1), candidates[[best, 5]]), candidates, reference, weight, 3
    )
    np.testing.assert_array_equal(index, again)
    np.testing.assert_allclose(gains, same, rtol=1e-6)
    assert best not in index


def test_no_run_is_made_where_the_weight_is_zero() -> None:
    rng = np.random.default_rng(8)
    here, there = rng.uniform(-1.0, -0.6, (40, 3)), rng.uniform(0.6, 1.0, (40, 3))
    short = process(0, (0.25, 0.25, 0.25))
    both = np.vstack([here, there])
    one_sided = np.repeat([1.0, 0.0], 40)
    index, _ = choose(short, both, both, one_sided, 12)
    assert np.all(index < 40)
    index, _ = choose(short, both, both, np.ones(80), 12)
    assert 3 <= np.count_nonzero(index < 40) <= 9, "control: even weight draws runs on both sides"


def test_the_order_of_candidates_and_points_decides_nothing(
    points: tuple[Array, Array, Array],
) -> None:
    candidates, reference, weight = points
    index, _ = choose(process(1), candidates, reference, weight, 5)
    rng = np.random.default_rng(2)
    a, b = rng.permutation(30), rng.permutation(50)
    other, _ = choose(process(1), candidates[a], reference[b], weight[b], 5)
    np.testing.assert_array_equal(candidates[index], candidates[a][other])


def test_equal_candidates_are_not_chosen_by_their_place() -> None:
    twins = np.array([[0.5, 0.0, 0.0], [-0.5, 0.0, 0.0]])
    even = SharedGP.condition(
        np.array([[0.0, 0.9, 0.0], [0.0, -0.9, 0.0], [0.0, 0.0, 0.9], [0.0, 0.0, -0.9]]),
        np.zeros((4, 1)),
        Hyper((1.0, 1.0, 1.0), 1e-6, 0),
    )
    for order in ([0, 1], [1, 0]):
        (index,), _ = choose(even, twins[order], twins, np.ones(2), 1)
        assert twins[order][index][0] == -0.5


def test_a_shuffled_weight_loses(points: tuple[Array, Array, Array]) -> None:
    candidates, reference, weight = points

    def left(by: Array) -> float:
        index, _ = choose(process(1), candidates, reference, by, 4)
        return float(weight @ variance(with_runs(process(1), candidates[index]), reference))

    rng = np.random.default_rng(6)
    shuffled = [left(rng.permutation(weight)) for _ in range(8)]
    assert left(weight) < min(shuffled)


def test_the_covariance_at_equal_points_is_the_variance_without_its_nugget(
    points: tuple[Array, Array, Array],
) -> None:
    z = points[0]
    one = process(2)
    c = one.cross_covariance(z, z)
    np.testing.assert_allclose(np.diag(c) + 3e-5, variance(one, z), rtol=1e-9)
    np.testing.assert_allclose(c, c.T, atol=1e-12)
    v, _, pairs = one.covariance(z[:5], z[5:10][:, None])
    apart = one.cross_covariance(z[:5], z[5:10])
    np.testing.assert_allclose(np.diag(apart), pairs[:, 0], atol=3e-5)
    assert v.shape == (5,)


def test_what_makes_no_choice_is_refused(points: tuple[Array, Array, Array]) -> None:
    candidates, reference, weight = points
    with pytest.raises(InputError, match="is not 1 … 30"):
        choose(process(1), candidates, reference, weight, 31)
    with pytest.raises(InputError, match="not all zero"):
        choose(process(1), candidates, reference, 0 * weight, 2)
    with pytest.raises(InputError, match="not the same inputs"):
        reductions(process(1), candidates[:, :2], reference, weight)


def test_a_share_of_the_weight_is_spread_over_the_box() -> None:
    low, high = np.array([2.0, -1.0]), np.array([4.0, 3.0])
    some = Region.of(np.array([[2.5, 0.0], [2.6, 0.5], [2.7, 0.1]]), np.array([2.0, 1.0, 1.0]))
    wide = some.mixed(low, high, 0.2, 64, seed=3)
    np.testing.assert_allclose(wide.weight[:3], [0.4, 0.2, 0.2])
    assert wide.weight.sum() == pytest.approx(1.0)
    even = wide.x[3:]
    assert len(even) == 64
    np.testing.assert_allclose(even.mean(axis=0), [3.0, 1.0], atol=0.05)
    assert np.all((even >= low) & (even <= high))
    assert some.mixed(low, high, 0.0, 64, seed=3) is some
    mean, sd = some.mean_and_sd()
    np.testing.assert_allclose(mean, [2.575, 0.15])
    np.testing.assert_allclose(sd, [0.08291562, 0.20615528], rtol=1e-6)


@pytest.mark.parametrize("weight", [[1.0, -0.1], [0.0, 0.0], [1.0], [np.nan, 1.0]])
def test_weights_that_are_none_are_refused(weight: list[float]) -> None:
    with pytest.raises(InputError, match="one weight, 0 or more"):
        Region.of(np.zeros((2, 3)), np.array(weight))
