"""Where nodes come to stand, and that weights at the nodes alone do not judge it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import truncnorm

from core.calibration.surface import foreseen
from core.smc.particles import ess
from core.smc.placement import Proposal, descend, improved, moments, pooled, sobol


def ridge(d: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance on the unit box: correlated, standard deviations from 3e-4 to 0.2."""
    rng = np.random.default_rng(d)
    turn = np.linalg.qr(rng.standard_normal((d, d)))[0]
    inner = turn * np.linspace(0.4, 1.6, d) @ turn.T
    sd = np.geomspace(3e-4, 0.2, d)
    return 0.3 + 0.4 * rng.random(d), inner * np.outer(sd, sd)


@pytest.mark.parametrize(("d", "scouts"), [(2, 16), (4, 32), (8, 128)])
def test_a_descent_finds_a_narrow_ridge_from_the_whole_box(d: int, scouts: int) -> None:
    mean, cov = ridge(d)
    half = np.linalg.inv(np.linalg.cholesky(cov))

    def log_p(unit: np.ndarray, key: bytes = b"") -> np.ndarray:
        z = (unit - mean) @ half.T
        return np.asarray(-0.5 * np.sum(z**2, axis=1) - 0.02 * np.sum(z**4, axis=1) ** 0.5)

    start = Proposal(np.full(d, 0.5), np.eye(d))
    base = sobol(512, d, 3)
    found = descend(log_p, start, base[:scouts], enough=min(0.3, 1.2 / d))
    unit, log_q = found.nodes(base)
    assert ess(log_p(unit) - log_q) > 0.2 * len(unit)
    w = np.exp(log_p(unit) - log_q)
    middle, _ = moments(unit, w / w.sum())
    assert np.all(np.abs(middle - mean) < 0.2 * np.sqrt(np.diag(cov)))
    unit, log_q = start.nodes(base)
    assert ess(log_p(unit) - log_q) < 4, "the start alone does not do"


def test_the_density_of_a_proposal_is_that_of_its_nodes_and_integrates_to_one() -> None:
    proposal = Proposal(np.array([0.05, 0.6]), np.array([[0.1, 0.0], [0.05, 0.08]]))
    unit, log_q = proposal.nodes(sobol(256, 2, 0))
    assert proposal.log_density(unit) == pytest.approx(log_q, abs=1e-6)
    grid = (np.arange(800) + 0.5) / 800
    places = np.stack([v.ravel() for v in np.meshgrid(grid, grid)], axis=1)
    assert np.exp(proposal.log_density(places)).mean() == pytest.approx(1.0, abs=1e-3)
    own = truncnorm.logpdf(unit[:, 0], -0.5, 9.5, loc=0.05, scale=0.1)
    beside = unit[:, 1] - 0.6 - 0.5 * (unit[:, 0] - 0.05)
    low, high = ((edge - 0.6 - 0.5 * (unit[:, 0] - 0.05)) / 0.08 for edge in (0.0, 1.0))
    assert log_q == pytest.approx(own + truncnorm.logpdf(beside / 0.08, low, high) - np.log(0.08))


def test_nodes_beside_the_posterior_have_even_weights_and_are_found_out() -> None:
    def log_p(unit: np.ndarray) -> np.ndarray:
        return np.asarray(-0.5 * np.sum(((unit - 0.5) / 0.1) ** 2, axis=1))

    beside = Proposal(np.array([0.45, 0.45]), np.diag([0.07, 0.07]))
    unit, log_q = beside.nodes(sobol(64, 2, 1))
    assert ess(log_p(unit) - log_q) > 0.35 * 64, "weights alone call it fair"
    share, further = foreseen(beside, unit, log_p(unit), log_q)
    assert share < 0.01
    assert further.mean == pytest.approx([0.5, 0.5], abs=0.02)
    right = Proposal(np.array([0.5, 0.5]), np.diag([0.14, 0.14]))
    unit, log_q = right.nodes(sobol(64, 2, 1))
    share, _ = foreseen(right, unit, log_p(unit), log_q)
    assert share == pytest.approx(ess(log_p(unit) - log_q) / 64, abs=0.1)


def test_pooled_nodes_find_a_ridge_of_seven_parameters_that_single_placements_do_not() -> None:
    """Correlations of 0.97, started three spreads away; the control is the plain iteration."""
    d = 7
    rng = np.random.default_rng(5)
    turn = np.linalg.qr(rng.normal(size=(d, d)))[0]
    root = turn * (0.02 * np.array([1.0, 0.5, 0.3, 0.2, 0.1, 0.05, 0.03]))
    centre = np.full(d, 0.45)

    def target(u: np.ndarray) -> np.ndarray:
        z = np.linalg.solve(root, (u - centre).T).T
        return np.asarray(
            -0.5 * np.sum(z**2, axis=1) - 0.02 * np.sum(z**2, axis=1) * np.sin(z[:, 0])
        )

    start = Proposal(centre + 0.02, 0.02 * np.eye(d))
    base = sobol(512, d, 1)

    def share(proposal: Proposal, seed: int) -> float:
        u, log_q = proposal.nodes(sobol(512, d, seed))
        return ess(target(u) - log_q) / 512

    assert share(start, 2) < 0.01
    found = pooled(target, start, base, 256)
    assert share(found, 2) > 0.35
    single = start
    for _ in range(10):
        u, log_q = single.nodes(base[:256])
        single = improved(single, u, target(u), log_q, 0.17)
    assert share(single, 2) < share(found, 2)
