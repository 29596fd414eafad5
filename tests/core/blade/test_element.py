from __future__ import annotations

import numpy as np
import pytest

from core.blade.element import EDGES, NODES, face_points, gauss, shape, trilinear

POINTS = np.random.default_rng(3).uniform(-1, 1, (40, 3))


def quadratic(x: np.ndarray) -> np.ndarray:
    a, b, c = np.moveaxis(x, -1, 0)
    return 1.7 + 2 * a - b + 0.3 * c + a * a - 2 * b * c + 0.5 * a * b * c + a * a * b


def test_each_shape_function_is_one_at_its_own_node_and_zero_at_the_others() -> None:
    assert np.abs(shape(NODES)[0] - np.eye(20)).max() < 1e-15


def test_a_field_of_the_serendipity_space_is_reproduced_exactly() -> None:
    assert np.abs(shape(POINTS)[0] @ quadratic(NODES) - quadratic(POINTS)).max() < 1e-14


def test_a_field_outside_the_space_is_not_reproduced() -> None:
    outside = (NODES**2).prod(axis=1)
    assert np.abs(shape(POINTS)[0] @ outside - (POINTS**2).prod(axis=1)).max() > 0.1


def test_gradients_are_the_central_differences_of_the_values() -> None:
    h = 1e-5
    for axis in range(3):
        step = h * np.eye(3)[axis]
        numeric = (shape(POINTS + step)[0] - shape(POINTS - step)[0]) / (2 * h)
        assert np.abs(shape(POINTS)[1][:, :, axis] - numeric).max() < 1e-9


def test_corner_integrals_are_minus_one_and_trilinear_ones_plus_one() -> None:
    points, weights = gauss(3)
    assert weights @ shape(points)[0][:, :8] == pytest.approx(-np.ones(8), abs=1e-14)
    assert weights @ trilinear(points) == pytest.approx(np.ones(8), abs=1e-14)


def test_mid_edge_nodes_lie_midway_between_the_two_corners_of_their_edge() -> None:
    for node, (a, b) in enumerate(EDGES, start=8):
        assert NODES[node] == pytest.approx((NODES[a] + NODES[b]) / 2)


@pytest.mark.parametrize(("axis", "side"), [(0, -1), (1, 1), (2, -1)])
def test_face_points_integrate_a_quartic_on_the_face(axis: int, side: int) -> None:
    points, weights, (b, c) = face_points(axis, side)
    assert np.all(points[:, axis] == side)
    assert weights @ (points[:, b] ** 4 * points[:, c] ** 2) == pytest.approx(2 / 5 * 2 / 3)
