from __future__ import annotations

import numpy as np
import pytest

from core.blade import BladeMesh, build_mesh
from core.blade.element import gauss, shape
from core.blade.geometry import brick, jacobians
from core.blade.projection import Projection
from core.errors import InputError


def projection(mesh: BladeMesh) -> tuple[Projection, np.ndarray]:
    """The projection and the places (G, 3) of its points."""
    local, weight = gauss(2)
    at = np.einsum("pn,enx->epx", shape(local)[0], mesh.points[mesh.cells]).reshape(-1, 3)
    volume = (jacobians(mesh.points, mesh.cells, 2) * weight).ravel()
    return Projection(mesh, volume, 2), at


def test_consistent_projection_keeps_a_linear_field_to_rounding() -> None:
    mesh = brick((3, 2, 3), (10.0, 8.0, 12.0))
    project, at = projection(mesh)
    weights = np.array([[2.0, -1.0], [0.5, 3.0], [-1.0, 0.2]])
    gap = project.consistent(at @ weights + 7.0) - (mesh.points @ weights + 7.0)
    assert np.abs(gap).max() < 1e-12


def test_weighted_mean_keeps_constants_and_flattens_a_linear_field() -> None:
    mesh = brick((3, 2, 3), (10.0, 8.0, 12.0))
    project, at = projection(mesh)
    assert project.positive(np.full((len(at), 1), 0.37)) == pytest.approx(0.37, rel=1e-13)
    assert np.ptp(project.positive(at)[:, 1]) < 0.9 * 8.0


def test_weighted_mean_of_a_spike_is_positive_where_the_consistent_one_is_not() -> None:
    mesh = build_mesh("coarse")
    project, at = projection(mesh)
    spike = np.full((len(at), 1), 1e-9)
    spike[700] = 0.02
    assert project.positive(spike).min() > 0
    assert project.positive(spike).max() < 0.02
    assert project.consistent(spike).min() < -1e-4


def test_a_field_of_the_wrong_length_is_refused() -> None:
    project, at = projection(brick((1, 1, 2), (1.0, 1.0, 2.0)))
    with pytest.raises(InputError, match="one row per Gauss point"):
        project.positive(at[:-1])
