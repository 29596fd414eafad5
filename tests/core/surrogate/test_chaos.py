from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss

from core.rng import stream
from core.surrogate.contest.chaos import Chaos, hyperbolic, legendre, penalty


def test_the_basis_is_orthonormal_under_the_uniform_density() -> None:
    x, w = leggauss(8)
    z = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2)
    psi = legendre(z, hyperbolic(2, 5, 1.0))
    gram = (psi * np.outer(w, w).reshape(-1, 1) / 4.0).T @ psi
    assert np.allclose(gram, np.eye(21), atol=1e-12)


def test_a_smaller_norm_drops_mixed_terms_and_no_others() -> None:
    full = {tuple(e) for e in hyperbolic(3, 4, 1.0).tolist()}
    few = {tuple(e) for e in hyperbolic(3, 4, 0.6).tolist()}
    assert few < full
    assert {e for e in full if np.count_nonzero(e) <= 1} <= few


def test_three_terms_among_126_are_found_from_forty_runs_and_no_fourth() -> None:
    z = stream(3, "chaos").uniform(-1, 1, (40, 4))
    table = hyperbolic(4, 5, 1.0)
    true = np.zeros((len(table), 1))
    true[[0, 7, 60], 0] = [2.5, -1.25, 0.375]
    made = Chaos.fit(z, legendre(z, table) @ true, 5)
    assert np.flatnonzero(np.abs(made.weights[:, 0]) > 1e-9).tolist() == [0, 7, 60]
    assert made.weights == pytest.approx(true, abs=1e-9)
    new = np.array([[0.3, -0.9, 0.1, 0.7]])
    assert made(new) == pytest.approx(legendre(new, table) @ true, abs=1e-9)


def test_the_closed_form_of_leaving_one_out_is_that_of_fitting_again() -> None:
    rng = stream(4, "chaos")
    z = rng.uniform(-1, 1, (30, 2))
    y = np.exp(z[:, :1]) + 0.1 * rng.standard_normal((30, 1))
    made = Chaos.fit(z, y, 2, sparse=False)
    again = [
        Chaos.fit(np.delete(z, i, 0), np.delete(y, i, 0), 2, sparse=False)(z[i : i + 1])[0, 0]
        for i in range(30)
    ]
    left = float(np.mean((np.array(again) - y[:, 0]) ** 2))
    assert float(made.error[0]) == pytest.approx(penalty(30, 6) * left, rel=1e-9)


def test_noise_is_told_from_a_smooth_response_by_the_error_that_is_left() -> None:
    """Negative control; some terms are always picked up, for the search looks at 70."""
    rng = stream(5, "chaos")
    z = rng.uniform(-1, 1, (60, 4))
    smooth, noise = np.exp(z @ [1.0, -0.5, 0.3, 0.8]), rng.standard_normal(60)
    y = np.column_stack([smooth, noise])
    made = Chaos.fit(z, y, 4)
    share = made.error / np.var(y, axis=0)
    assert share[0] < 1e-2
    assert share[1] > 0.5
    assert made.terms[1] < 0.5 * made.terms[0]
