"""Answers at points near each other: quadratics exactly, what is left as an error, else each."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from core.rng import stream
from core.surrogate.nearby import nearby

Array = NDArray[np.float64]
BLOCK = 16


class Followed:
    """Rows of a function, and which inputs it was asked for."""

    def __init__(self, mean: Callable[[Array], Array]) -> None:
        self.mean, self.asked = mean, 0

    def __call__(self, x: Array) -> Iterator[tuple[Array, Array]]:
        for start in range(0, len(x), BLOCK):
            own = x[start : start + BLOCK]
            self.asked += len(own)
            y = self.mean(own)
            yield y, 0.1 + 0.01 * own[:, :1, None] * np.ones_like(y)


def put(
    x: Array, mean: Callable[[Array], Array], shape: tuple[int, ...]
) -> tuple[Array, Array, int]:
    """All of `nearby`, in the points' order, and how many were followed."""
    followed, seen = Followed(mean), np.zeros(len(x), dtype=int)
    y, sd = np.full((len(x), *shape), np.nan), np.full((len(x), *shape), np.nan)
    for which, own, doubt in nearby(x, followed, BLOCK):
        seen[which] += 1
        y[which], sd[which] = own, doubt
    assert np.all(seen == 1)
    return y, sd, followed.asked


def points(n: int) -> Array:
    """Two inputs that go together, one far from zero, and one that stands still."""
    a, b = stream(3, "nearby").standard_normal((2, n))
    return np.stack([a, 1e4 + 0.01 * a + 0.001 * b, np.full(n, 7.0)], axis=1)


def quadratic(x: Array) -> Array:
    b = 1000.0 * (x[:, 1] - 1e4)
    y = np.stack([x[:, 0] ** 2 + b, 3.0 - x[:, 0] * b, 0.0 * b], axis=1)
    return y[:, :, None]


def test_quadratics_are_told_exactly_by_some() -> None:
    x = points(200)
    y, sd, asked = put(x, quadratic, (3, 1))
    assert asked == 32  # two directions, six monomials, three points each, in blocks
    assert y == pytest.approx(quadratic(x), abs=1e-6)
    assert sd == pytest.approx(0.1 + 0.01 * x[:, :1, None] * np.ones((1, 3, 1)), abs=1e-6)


def test_what_is_no_quadratic_is_an_error_and_no_variance_is_lost() -> None:
    """It is rather told too large: pivots lie in the tails."""
    x = points(400)
    y, sd, asked = put(x, lambda x: (x[:, :1] + 0.02 * x[:, :1] ** 3)[:, :, None], (1, 1))
    exact = x[:, 0] + 0.02 * x[:, 0] ** 3
    off = np.sqrt(np.mean((y[:, 0, 0] - exact) ** 2))
    own = np.sqrt(np.mean(sd[:, 0, 0] ** 2 - (0.1 + 0.01 * x[:, 0]) ** 2))
    assert asked == 32
    assert 0.05 * exact.std() < off < own < 1.5 * off
    assert 1.0 < np.sqrt(np.var(y) + own**2) / exact.std() < 1.08
    assert abs(y.mean() - exact.mean()) < 0.02 * exact.std()


def test_what_is_far_from_a_quadratic_is_followed_point_by_point() -> None:
    x = points(200)
    rough: Callable[[Array], Array] = lambda x: np.sin(4.0 * x[:, :1])[:, :, None]  # noqa: E731
    y, sd, asked = put(x, rough, (1, 1))
    assert asked == len(x), "and none twice"
    assert np.array_equal(y, rough(x))
    assert np.array_equal(sd[:, 0, 0], 0.1 + 0.01 * x[:, 0])


@pytest.mark.parametrize("n", [1, 5, 63])
def test_few_points_are_each_followed(n: int) -> None:
    x = points(n)
    y, _, asked = put(x, quadratic, (3, 1))
    assert asked == n
    assert np.array_equal(y, quadratic(x))


def test_points_that_are_one_point_are_told_by_one() -> None:
    x = np.repeat(points(1), 100, axis=0)
    y, _, asked = put(x, quadratic, (3, 1))
    assert asked == BLOCK
    assert y == pytest.approx(quadratic(x))
