from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from core.design import criterion, maximin_lhs
from core.errors import InputError

LOW, HIGH = [2 / 3, 0.8, -3.0], [4 / 3, 1.0, 3.0]


def test_every_axis_has_one_point_in_the_middle_of_each_cell() -> None:
    x = maximin_lhs(21, LOW, HIGH, seed=5)
    cells = (x - LOW) / (np.array(HIGH) - LOW) * 21 - 0.5
    for column in cells.T:
        np.testing.assert_allclose(np.sort(column), np.arange(21), atol=1e-9)


def test_the_criterion_of_two_known_distances_is_exact() -> None:
    points = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 0.0]])  # distances 5, 3, 4
    expected = (5.0**-2 + 3.0**-2 + 4.0**-2) ** 0.5
    assert criterion(points, power=2) == pytest.approx(expected, rel=1e-14)


def test_points_keep_further_apart_than_in_the_best_of_100_random_hypercubes() -> None:
    n = 30
    x = maximin_lhs(n, [0.0] * 4, [1.0] * 4, seed=2)
    rng = np.random.default_rng(0)
    random = [
        (np.column_stack([rng.permutation(n) for _ in range(4)]) + 0.5) / n for _ in range(100)
    ]
    assert criterion(x) < 0.8 * min(criterion(r) for r in random)
    assert pdist(x).min() > 1.2 * max(pdist(r).min() for r in random)


def test_the_reported_optimum_is_not_a_drifted_sum() -> None:
    """The annealing updates sums in place; an error there would prefer a worse design."""
    short = maximin_lhs(12, [0.0, 0.0], [1.0, 1.0], seed=9)
    assert len(np.unique(short, axis=0)) == 12
    assert np.isfinite(criterion(short))
    assert criterion(short) < 5.4


def test_the_seed_alone_decides() -> None:
    first, again = (maximin_lhs(17, LOW, HIGH, seed=4) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, maximin_lhs(17, LOW, HIGH, seed=5))


@pytest.mark.parametrize(
    ("n", "low", "high"), [(1, [0.0], [1.0]), (5, [1.0], [1.0]), (5, [0.0, 0.0], [1.0])]
)
def test_a_design_without_points_or_box_is_refused(
    n: int, low: list[float], high: list[float]
) -> None:
    with pytest.raises(InputError):
        maximin_lhs(n, low, high, seed=1)
