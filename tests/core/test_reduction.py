from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from core.errors import InputError
from core.reduction import Basis, randomized_svd

Array = NDArray[np.float64]


def decaying(m: int, n: int, ratio: float) -> tuple[Array, Array]:
    """A matrix with singular values ratio^k, and those values."""
    rng = np.random.default_rng(3)
    u, _ = np.linalg.qr(rng.standard_normal((m, 30)))
    v, _ = np.linalg.qr(rng.standard_normal((n, 30)))
    s = ratio ** np.arange(30.0)
    return (u * s) @ v.T, s


def test_the_leading_singular_values_and_spaces_are_those_of_the_full_decomposition() -> None:
    matrix, s = decaying(120, 400, 0.6)
    u, found, vt = randomized_svd(matrix, 8, seed=1)
    np.testing.assert_allclose(found, s[:8], rtol=1e-9)
    exact = np.linalg.svd(matrix, full_matrices=False)[2][:8]
    np.testing.assert_allclose(np.abs(np.sum(vt * exact, axis=1)), 1.0, rtol=1e-9)
    np.testing.assert_allclose(u.T @ u, np.eye(8), atol=1e-12)


def test_power_iterations_are_what_makes_a_slow_decay_accurate() -> None:
    matrix, s = decaying(120, 400, 0.9)
    with_power = randomized_svd(matrix, 8, seed=1)[1]
    without = randomized_svd(matrix, 8, seed=1, oversample=0, iterations=0)[1]
    assert np.max(np.abs(with_power / s[:8] - 1)) < 1e-3
    assert np.max(np.abs(without / s[:8] - 1)) > 0.1


def test_a_rank_above_the_shape_gives_what_there_is() -> None:
    u, s, vt = randomized_svd(np.diag([5.0, 3.0, 2.0]), 9, seed=1)
    np.testing.assert_allclose(s, [5.0, 3.0, 2.0], rtol=1e-12)
    assert u.shape == vt.shape == (3, 3)


def test_energy_and_residual_of_known_singular_values() -> None:
    snapshots = np.diag([4.0, 2.0, 1.0])
    basis = Basis.of(snapshots, 2, seed=1)
    np.testing.assert_allclose(basis.energy, [16 / 21, 20 / 21], rtol=1e-12)
    np.testing.assert_allclose(basis.residual(), [np.sqrt(5), 1.0], rtol=1e-12)


def test_rows_asked_for_are_those_of_the_whole_field() -> None:
    matrix, _ = decaying(60, 90, 0.5)
    basis = Basis.of(matrix, 12, seed=2)
    code = basis.encode(matrix[7:9])
    whole = basis.decode(code)
    np.testing.assert_allclose(basis.decode(code, [83, 4]), whole[:, [83, 4]], atol=1e-15)
    np.testing.assert_allclose(whole, matrix[7:9], atol=1e-3)


def test_held_out_snapshots_of_the_same_space_are_reconstructed_and_others_are_not() -> None:
    rng = np.random.default_rng(8)
    modes = rng.standard_normal((5, 200))
    basis = Basis.of(rng.standard_normal((40, 5)) @ modes, 5, seed=1)
    assert basis.held_out_error(rng.standard_normal((6, 5)) @ modes) < 1e-12
    assert basis.held_out_error(rng.standard_normal((6, 200))) > 0.95


def test_one_seed_gives_one_result() -> None:
    matrix, _ = decaying(50, 70, 0.7)
    np.testing.assert_array_equal(
        randomized_svd(matrix, 4, seed=3)[2], randomized_svd(matrix, 4, seed=3)[2]
    )


def test_a_vector_is_refused() -> None:
    with pytest.raises(InputError, match="give a matrix"):
        randomized_svd(np.ones(4), 2, seed=1)
