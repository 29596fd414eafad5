from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import null_space

from core.errors import ModelError
from core.monomials import monomials
from core.surrogate.kernel import Hyper, SharedGP, correlation
from core.surrogate.likelihood import fit_hyper, log_likelihood
from core.surrogate.near import nearness

Array = NDArray[np.float64]
HYPER = Hyper((0.9, 2.3), 1e-4, 1)


def points(n: int, seed: int = 3) -> Array:
    return np.random.default_rng(seed).uniform(-1, 1, (n, 2))


def targets(z: Array) -> Array:
    first = np.sin(2 * z[:, 0]) + 0.3 * z[:, 1]
    return np.column_stack([first, np.exp(z[:, 1]) * z[:, 0]])


def textbook(z: Array, c: Array, new: Array, hyper: Hyper) -> tuple[Array, Array]:
    """Universal kriging as one linear system with Lagrange multipliers."""
    lengths = np.array(hyper.lengths)
    h = monomials(z, hyper.trend)
    n, p = h.shape
    system = np.zeros((n + p, n + p))
    system[:n, :n] = correlation(z, z, lengths) + hyper.nugget * np.eye(n)
    system[:n, n:], system[n:, :n] = h, h.T
    right = np.vstack([correlation(z, new, lengths), monomials(new, hyper.trend).T])
    solved = np.linalg.solve(system, right)
    v = 1 + hyper.nugget - np.sum(solved * right, axis=0)
    return solved[:n].T @ c, v


@pytest.mark.parametrize("trend", [0, 1, 2])
def test_mean_and_variance_are_those_of_universal_kriging(trend: int) -> None:
    z, new = points(25), points(6, seed=8)
    hyper = Hyper(HYPER.lengths, HYPER.nugget, trend)
    (mean,), v = SharedGP.condition(z, targets(z), hyper).mean_and_variance(new)
    expected_mean, expected_v = textbook(z, targets(z), new, hyper)
    np.testing.assert_allclose(mean, expected_mean, rtol=1e-8)
    np.testing.assert_allclose(v, expected_v, rtol=1e-6)


def test_leave_one_out_equals_conditioning_without_that_run() -> None:
    z = points(22)
    c = targets(z)
    e, v = SharedGP.condition(z, c, HYPER).left_out()
    for i in (0, 7, 21):
        kept = np.delete(np.arange(22), i)
        without = SharedGP.condition(z[kept], c[kept], HYPER)
        (mean,), alone = without.mean_and_variance(z[i : i + 1])
        np.testing.assert_allclose(c[i] - mean[0], e[i], rtol=1e-7)
        np.testing.assert_allclose(alone[0], v[i], rtol=1e-7)


def test_the_restricted_likelihood_is_that_of_the_contrasts() -> None:
    """Contrasts N^T c, N^T H = 0, have no trend: an ordinary likelihood, up to |H^T H|."""
    z = points(18)
    c, share = targets(z), np.array([0.7, 0.3])
    h = monomials(z, HYPER.trend)
    basis = null_space(h.T)
    r = correlation(z, z, np.array(HYPER.lengths)) + HYPER.nugget * np.eye(18)
    small = basis.T @ r @ basis
    contrast = basis.T @ c
    variance = np.sum(contrast * np.linalg.solve(small, contrast), axis=0) / len(small)
    expected = -0.5 * (len(small) * share @ np.log(variance) + np.linalg.slogdet(small)[1])
    expected -= 0.5 * np.linalg.slogdet(h.T @ h)[1]
    assert log_likelihood(z, c, share, HYPER)[0] == pytest.approx(expected, rel=1e-9)


def test_the_slopes_of_the_likelihood_are_its_differences() -> None:
    z = points(18)
    c, share = targets(z), np.array([0.7, 0.3])
    theta = np.log([0.9, 2.3, 1e-4])

    def at(values: Array) -> tuple[float, Array]:
        lengths, nugget = np.exp(values[:2]), float(np.exp(values[2]))
        return log_likelihood(z, c, share, Hyper((lengths[0], lengths[1]), nugget, 1))

    slopes = at(theta)[1]
    for i, step in enumerate(1e-4 * np.eye(3)):
        difference = (at(theta + step)[0] - at(theta - step)[0]) / 2e-4
        assert slopes[i] == pytest.approx(difference, rel=1e-5)
        assert abs(difference) > 1e-3


def test_a_matrix_that_is_not_positive_definite_is_infinitely_unlikely() -> None:
    z = np.vstack([points(8), points(8)])
    value, _ = log_likelihood(z, targets(z), np.array([0.5, 0.5]), Hyper((1.0, 1.0), 0.0, 0))
    assert value == -np.inf


def test_the_variance_is_the_nugget_at_a_run_and_large_far_away() -> None:
    z = points(20)
    process = SharedGP.condition(z, targets(z), Hyper((0.4, 0.4), 1e-6, 0))
    _, v = process.mean_and_variance(np.vstack([z[:3], [[9.0, 9.0]]]))
    assert np.all(v[:3] < 3e-6)
    assert v[3] > 0.9


def test_a_linear_function_is_continued_by_a_linear_trend_and_not_by_a_constant() -> None:
    z = points(15)
    c = (2.0 + 3.0 * z[:, :1] - z[:, 1:]).copy()
    far = np.array([[6.0, -4.0]])
    (linear,), _ = SharedGP.condition(z, c, HYPER).mean_and_variance(far)
    (constant,), _ = SharedGP.condition(z, c, Hyper(HYPER.lengths, 1e-4, 0)).mean_and_variance(far)
    assert linear[0, 0] == pytest.approx(24.0, rel=1e-9)
    assert abs(constant[0, 0] - 24.0) > 4


def test_columns_asked_for_are_those_of_the_whole() -> None:
    z = points(15)
    process = SharedGP.condition(z, targets(z), HYPER)
    (both,), _ = process.mean_and_variance(z[:4])
    (second, first), _ = process.mean_and_variance(z[:4], [slice(1, 2), slice(0, 1)])
    np.testing.assert_allclose(np.hstack([first, second]), both, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("function", "shorter"),
    [
        (lambda z: np.sin(6 * z[:, :1]) + 0.2 * z[:, 1:], 0),
        (lambda z: 0.2 * z[:, :1] + np.sin(6 * z[:, 1:]), 1),
    ],
)
def test_the_wigglier_input_gets_the_shorter_length(
    function: Callable[[Array], Array], shorter: int
) -> None:
    z = points(40)
    hyper = fit_hyper(z, function(z), np.ones(1), trend=0)
    assert hyper.lengths[shorter] < 0.4 * hyper.lengths[1 - shorter]
    assert hyper == fit_hyper(z, function(z), np.ones(1), trend=0)


def test_noise_goes_to_the_nugget() -> None:
    z = points(60)
    noise = 0.1 * np.random.default_rng(5).standard_normal((60, 1))
    clean = fit_hyper(z, z[:, :1] ** 2, np.ones(1), trend=0)
    noisy = fit_hyper(z, z[:, :1] ** 2 + noise, np.ones(1), trend=0)
    assert clean.nugget < 1e-7
    assert noisy.nugget > 1e-4


def test_a_trend_that_the_runs_cannot_carry_is_refused() -> None:
    z = points(7)
    with pytest.raises(ModelError, match="7 runs do not carry a trend of 6 terms"):
        SharedGP.condition(z, targets(z), Hyper((1.0, 1.0), 1e-6, 2))


def star(levels: tuple[float, ...] = (-1.0, -0.5, 0.5, 1.0)) -> Array:
    """One input changed at a time, about the middle."""
    axes = [np.eye(2)[j] * level for j in range(2) for level in levels]
    return np.array([np.zeros(2), *axes])


@pytest.mark.parametrize(
    "z",
    [
        star((-1.0, -0.6, -0.3, 0.2, 0.5, 0.8, 1.0)),
        np.column_stack([points(14)[:, 0], [-1, 1] * 7]),
    ],
    ids=["one at a time", "two levels"],
)
def test_runs_that_carry_no_trend_so_high_get_a_lower_one(z: Array) -> None:
    """Where products and squares cannot be told apart from the rest: no error, and no worse."""
    c = targets(z)
    made = SharedGP.condition(z, c, Hyper((0.9, 2.3), 1e-6, 2))
    assert made.hyper.trend == 1
    (mean,), v = made.mean_and_variance(z)
    np.testing.assert_allclose(mean, c, atol=1e-3)
    assert np.all(np.isfinite(v))
    lower = SharedGP.condition(z, c, Hyper((0.9, 2.3), 1e-6, 1))
    np.testing.assert_array_equal(made.beta, lower.beta)


def test_coefficients_that_are_nothing_in_every_run_do_not_count() -> None:
    z = points(20)
    c, share = targets(z), np.array([0.5, 0.5])
    with_nothing = np.column_stack([c, np.zeros(20)])
    found = fit_hyper(z, with_nothing, np.array([0.5, 0.5, 0.0]), 1)
    plain = fit_hyper(z, c, share, 1)  # three columns and two are multiplied in other orders
    assert found.lengths == pytest.approx(plain.lengths, rel=1e-4)
    assert (found.nugget, found.trend) == (pytest.approx(plain.nugget, rel=1e-4), plain.trend)
    assert found != Hyper((0.7, 0.7), 1e-5, 1)


@pytest.mark.parametrize(("n", "m"), [(1, 1), (7, 30), (1030, 64)])
def test_correlations_have_the_same_bits_without_numba(
    n: int, m: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(n)
    z, other = rng.uniform(-1, 1, (n, 5)), rng.uniform(-1, 1, (m, 5))
    other[0], lengths = z[0], np.full(5, 0.7)  # a distance of zero, which rounding makes negative
    compiled = correlation(z, other, lengths)
    assert nearness.signatures  # that is what made them
    monkeypatch.delitem(sys.modules, "numba")
    assert np.array_equal(compiled, correlation(z, other, lengths))
