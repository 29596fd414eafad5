"""Where nodes come to stand, and that weights at the nodes alone do not judge it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_t, norm, truncnorm
from scipy.stats import t as t_distribution

from core.calibration.surface import foreseen
from core.smc.particles import ess
from core.smc.placement import descend, improved, moments, pooled, sobol
from core.smc.proposal import FREEDOM, Proposal


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


@pytest.mark.parametrize("sds", [3.0, 5.9, 6.1, 8.0, 12.0, 50.0])
@pytest.mark.parametrize("heavy", [(), (0,)])
def test_a_box_above_the_middle_of_a_proposal_is_known_as_well_as_one_below(
    sds: float, heavy: tuple[int, ...]
) -> None:
    """1 − P(z < 8) has no digits left: nodes stood all at the bound, log q was 650 nats off."""
    spread, base = np.array([[0.1]]), sobol(64, 1, 0)
    below = Proposal(np.array([1.0 + 0.1 * sds]), spread, heavy)
    above = Proposal(np.array([-0.1 * sds]), spread, heavy)
    (down, log_down), (up, log_up) = below.nodes(1.0 - base), above.nodes(base)
    assert up == pytest.approx(1.0 - down, rel=1e-5)
    assert log_up == pytest.approx(log_down, abs=1e-5)
    assert above.log_density(up) == pytest.approx(log_up, abs=1e-6)
    if heavy:
        own = t_distribution(FREEDOM, -0.1 * sds, 0.1)
        exact = own.logpdf(up[:, 0]) - np.log(own.sf(0.0) - own.sf(1.0))
    else:
        exact = truncnorm.logpdf(up[:, 0], sds, sds + 10.0, loc=-0.1 * sds, scale=0.1)
    assert log_up == pytest.approx(exact, abs=1e-5)
    grid = ((np.arange(20_000) + 0.5) / 20_000)[:, None]
    assert np.exp(above.log_density(grid)).mean() == pytest.approx(1.0, abs=1e-3)
    assert len(np.unique(up)) == len(up)


def test_a_coordinate_with_long_tails_has_nodes_there_and_the_same_density() -> None:
    """A t-distribution, cut at the box and conditional on what comes before, by scipy."""
    turn = np.array([[0.01, 0.0], [0.005, 0.008]])
    normal = Proposal(np.array([0.5, 0.6]), turn)
    heavy = Proposal(normal.mean, turn, (1,))
    unit, log_q = heavy.nodes(sobol(1024, 2, 0))
    assert heavy.log_density(unit) == pytest.approx(log_q, abs=1e-6)
    z = (unit - heavy.mean) @ np.linalg.inv(turn).T
    own = norm.logpdf(z[:, 0]) + t_distribution.logpdf(z[:, 1], FREEDOM)
    assert log_q == pytest.approx(own - np.log(0.01 * 0.008), abs=1e-4)
    beyond = np.abs(z[:, 1]) > 4.0
    assert beyond.mean() == pytest.approx(2 * t_distribution.sf(4.0, FREEDOM), abs=0.004)
    apart = (normal.nodes(sobol(1024, 2, 0))[0] - normal.mean) @ np.linalg.inv(turn).T
    assert np.abs(apart[:, 1]).max() < 4.0
    assert heavy.key != normal.key
    assert heavy.spread(2.0).heavy == (1,)
    following = improved(heavy, unit, -0.5 * np.sum(z**2, axis=1), log_q, 0.3)
    assert following.heavy == (1,)


def test_where_all_coordinates_have_long_tails_they_have_them_together() -> None:
    """The joint t-distribution by scipy, cut at the box: not the product of t-distributions."""
    turn = np.array([[0.01, 0.0, 0.0], [0.005, 0.008, 0.0], [0.0, -0.002, 0.006]])
    place = Proposal(np.array([0.5, 0.6, 0.4]), turn, (0, 1, 2))
    unit, log_q = place.nodes(sobol(1024, 3, 0))
    assert place.log_density(unit) == pytest.approx(log_q, abs=1e-6)
    joint = multivariate_t(place.mean, turn @ turn.T, df=FREEDOM)
    assert log_q == pytest.approx(joint.logpdf(unit), abs=1e-3)  # the box cuts a little
    z = (unit - place.mean) @ np.linalg.inv(turn).T
    apart = t_distribution.logpdf(z, FREEDOM).sum(axis=1) - np.log(np.diag(turn)).sum()
    assert np.abs(log_q - apart).max() > 1.0
    cut = Proposal(np.array([0.02, 1.3]), np.array([[0.1, 0.0], [0.05, 0.1]]), (0, 1))
    grid = (np.stack(np.meshgrid(*2 * [np.arange(800)]), axis=-1).reshape(-1, 2) + 0.5) / 800
    assert np.exp(cut.log_density(grid)).mean() == pytest.approx(1.0, abs=2e-3)


def test_a_noise_told_thrice_is_integrated_by_nodes_with_long_tails_alone() -> None:
    """Its second moment against the exact one, over seeds; nodes of a normal miss it (control).

    p(log sigma) ∝ sigma^-3 exp(−S / 2 sigma²) on [1e-5, 1e-2]: half of E sigma² lies beyond the
    99 % quantile.
    """
    width = np.log(1e-2) - np.log(1e-5)

    def log_p(unit: np.ndarray) -> np.ndarray:
        sigma = np.exp(np.log(1e-5) + width * unit[:, 0])
        return np.asarray(-3 * np.log(sigma) - 0.5 * 3 * (7e-5 / sigma) ** 2)

    grid = ((np.arange(200_000) + 0.5) / 200_000)[:, None]
    w = np.exp(log_p(grid) - log_p(grid).max())
    sigma = np.exp(np.log(1e-5) + width * grid[:, 0])
    exact = np.sqrt(w @ sigma**2 / w.sum())
    mean, spread = (
        (w @ grid[:, 0]) / w.sum(),
        np.sqrt((w @ grid[:, 0] ** 2) / w.sum() - ((w @ grid[:, 0]) / w.sum()) ** 2),
    )
    worst = {}
    for heavy in ((0,), ()):
        place, off = Proposal(np.array([mean]), np.array([[1.4 * spread]]), heavy), []
        for seed in range(30):
            unit, log_q = place.nodes(sobol(128, 1, seed))
            own = np.exp(log_p(unit) - log_q)
            s = np.exp(np.log(1e-5) + width * unit[:, 0])
            off.append(np.sqrt(own @ s**2 / own.sum()) / exact - 1.0)
        worst[heavy] = float(np.sqrt(np.mean(np.square(off))))
    assert worst[(0,)] < 0.02
    assert worst[()] > 2.0 * worst[(0,)], worst


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
