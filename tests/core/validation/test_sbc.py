"""Ranks, bands and controls against exact posteriors and simulated false alarms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import chi2

from core.smc.particles import normalised, weighted_quantile
from core.smc.placement import sobol
from core.smc.proposal import WIDEN, Proposal
from core.validation.sbc import (
    CONTROLS,
    PROBABILITIES,
    coverage,
    ecdf,
    mean_and_error,
    node_pit,
    published_cdf,
    randomised_pit,
    wrong_pits,
)
from core.validation.verdict import PARTS, curves, summary
from service.handlers import moments
from service.ports import Draws

PRIOR_MEAN, PRIOR_SD, NOISE = 1.0, 2.0, 1.5
GAIN = PRIOR_SD**2 / (PRIOR_SD**2 + NOISE**2)
SD = np.sqrt(GAIN) * NOISE


def conjugate(rng: np.random.Generator) -> tuple[float, float]:
    """A truth from N(1, 2²), and the exact posterior mean after one reading with noise 1.5."""
    truth = PRIOR_MEAN + PRIOR_SD * rng.standard_normal()
    reading = truth + NOISE * rng.standard_normal()
    return truth, PRIOR_MEAN + GAIN * (reading - PRIOR_MEAN)


def not_uniform(u: np.ndarray, bins: int = 20) -> float:
    """p value of a chi-squared test of uniformity."""
    counts = np.histogram(u, bins, (0, 1))[0]
    expected = len(u) / bins
    return float(chi2.sf(np.sum((counts - expected) ** 2 / expected), bins - 1))


def test_the_randomised_pit_of_six_exact_draws_is_uniform_and_the_plain_sum_is_not() -> None:
    rng = np.random.default_rng(5)
    w = np.full(6, 1 / 6)
    right, plain = [], []
    for _ in range(12_000):
        truth, mean = conjugate(rng)
        draws = mean + SD * rng.standard_normal(6)
        right.append(randomised_pit(draws, w, truth, rng.random()))
        plain.append(w @ (draws < truth))
    assert not_uniform(np.array(right)) > 0.01
    assert not_uniform(np.array(plain)) < 1e-6


def test_weighted_nodes_of_a_wide_proposal_give_uniform_pits() -> None:
    """64 nodes from a normal 1.5 times too wide: effective size 45, as shared nodes have it."""
    rng = np.random.default_rng(6)
    u, sizes = [], []
    for _ in range(12_000):
        truth, mean = conjugate(rng)
        z = 1.5 * rng.standard_normal(64)
        w = np.exp(-0.5 * z**2 + 0.5 * (z / 1.5) ** 2)
        w /= w.sum()
        sizes.append(1 / (w @ w))
        u.append(randomised_pit(mean + SD * z, w, truth, rng.random()))
    assert 35 < np.mean(sizes) < 55
    assert not_uniform(np.array(u)) > 0.01


def test_ranks_among_sobol_nodes_of_an_exact_normal_are_uniform_to_their_ends() -> None:
    """The shared level's own nodes, of a normal in the middle of the box; the control is the rank
    that counts the truth's own weight in, right for independent particles alone."""
    mean, sd = np.array([0.5, 0.5]), 0.05
    cases = []
    for seed in range(8):
        proposal = Proposal(mean, np.diag([WIDEN * sd, WIDEN * sd]))
        u, log_q = proposal.nodes(sobol(64, 2, seed))
        log_w = -0.5 * np.sum((u - mean) ** 2, axis=1) / sd**2 - log_q
        w = np.exp(log_w - log_w.max())
        cases.append((u[:, 0], w / w.sum()))
    rng = np.random.default_rng(8)
    own, counted = [], []
    for k in range(16_000):
        values, w = cases[k % len(cases)]
        truth, draw = 0.5 + sd * rng.standard_normal(), rng.random()
        own.append(node_pit(values, w, truth, draw))
        counted.append(randomised_pit(values, w, truth, draw))
    ends = (0.01, 0.02, 0.98, 0.99)
    off = [float(np.mean(np.array(own) <= z)) - z for z in ends]
    control = [float(np.mean(np.array(counted) <= z)) - z for z in ends]
    assert np.abs(off).max() < 0.0035, off
    outwards = np.array([-1, -1, 1, 1]) * control
    assert np.all(outwards > 0.0035), control


def test_ties_are_shared_out() -> None:
    """A truth that sits on a node of weight one half falls anywhere in that half."""
    values, w = np.array([0.0, 1.0, 1.0, 2.0]), np.full(4, 0.25)
    ends = [randomised_pit(values, w, 1.0, u) for u in (0.0, 1.0)]
    assert ends == [0.2, 0.8]


def test_the_published_distribution_function_inverts_published_quantiles() -> None:
    rng = np.random.default_rng(7)
    values, w = rng.standard_normal(50), rng.random(50)
    w /= w.sum()
    for p in (0.05, 0.3, 0.77, 0.95):
        q = float(weighted_quantile(values, w, np.array([p]))[0])
        assert published_cdf(values, w, q) == pytest.approx(p, abs=1e-12)
    assert published_cdf(values, w, 9.0) == 1.0


def test_the_quantiles_of_a_posterior_are_those_whose_coverage_is_counted() -> None:
    """The API told the node at which the weights pass a share, and studies counted another one."""
    rng = np.random.default_rng(4)
    values, log_w = rng.normal(size=(64, 1)), 0.5 * rng.normal(size=64)
    told = moments.summary(Draws(("T1T",), values, log_w, np.arange(64)))
    for p, q in told["parameters"]["T1T"]["quantiles"].items():
        assert published_cdf(values[:, 0], normalised(log_w), q) == pytest.approx(float(p))


@pytest.mark.parametrize("size", [60, 2000])
def test_the_band_of_independent_uniforms_alarms_falsely_once_in_twenty(size: int) -> None:
    rng = np.random.default_rng(size)
    alarms = [not ecdf(rng.random(size), np.arange(size)).inside for _ in range(400)]
    assert 0.02 < np.mean(alarms) < 0.09


def clustered(rng: np.random.Generator, clusters: int, size: int, rho: float) -> np.ndarray:
    """Uniforms whose normal scores correlate by rho within a cluster."""
    common = rng.standard_normal((clusters, 1))
    own = rng.standard_normal((clusters, size))
    return ndtr(np.sqrt(rho) * common + np.sqrt(1 - rho) * own).ravel()


@pytest.mark.parametrize("rho", [0.0, 0.3])
def test_the_band_knows_that_blades_of_a_rotor_are_alike(rho: float) -> None:
    """Blades taken for independent would alarm falsely again and again: the negative control."""
    rng = np.random.default_rng(8)
    cluster = np.repeat(np.arange(40), 20)
    alarms, naive = [], []
    for _ in range(200):
        u = clustered(rng, 40, 20, rho)
        alarms.append(not ecdf(u, cluster).inside)
        naive.append(not ecdf(u, np.arange(len(u))).inside)
    assert np.mean(alarms) < 0.09
    if rho > 0:
        assert np.mean(naive) > 0.3


def test_too_few_clusters_claim_nothing() -> None:
    one = ecdf(np.linspace(0, 0.1, 50), np.repeat(np.arange(5), 10))
    assert one.inside
    assert np.isinf(one.design)


def test_a_study_that_claims_nothing_does_not_pass() -> None:
    """Held-out readings of five rotors have no band, of eight rotors they have one."""

    def told(clusters: int) -> dict[str, Any]:
        records = []
        for number in range(clusters):
            pit = ((np.arange(4) + (number + 0.5) / clusters) / 4).tolist()
            held: dict[str, Any] = {"pit": pit, **dict.fromkeys(PARTS, [1.0] * 4)}
            held |= {f"in {c}": [abs(p - 0.5) < c / 2 for p in pit] for c in PROBABILITIES}
            facts = {"rotor": number, "cluster": number, "seconds": 1.0, "ess_ratio": 0.9}
            records.append(facts | {"truths": {}, "held": {"held-out y": held}})
        return summary(records, curves(records), parameters=False)

    some, few = told(8), told(5)
    assert some["passed"]
    assert some["table"]["held-out y"]["band_inside"]
    assert not few["passed"]
    assert few["table"]["held-out y"]["band_inside"] is None
    assert few["outside_band"] == few["not_covering"] == []


@pytest.mark.parametrize("control", CONTROLS)
def test_each_control_leaves_the_band_where_the_right_posterior_stays(control: str) -> None:
    """200 rotors with one skewed posterior each: an exponential, of which the normal is far."""
    rng = np.random.default_rng(9)
    right, wrong = [], []
    w = np.full(300, 1 / 300)
    for _ in range(200):
        draws, truth, u = rng.exponential(size=300), rng.exponential(), rng.random()
        right.append(randomised_pit(draws, w, truth, u))
        wrong.append(wrong_pits(draws, w, truth, u)[control])
    number = np.arange(200)
    assert ecdf(np.array(right), number).inside
    assert not ecdf(np.array(wrong), number).inside


def test_shares_and_their_errors_count_rotors_not_blades() -> None:
    """Ten rotors of five equal blades know as much as ten."""
    cdf = np.repeat(np.linspace(0.05, 0.95, 10), 5)
    share, error = coverage(cdf, np.repeat(np.arange(10), 5), 0.68)
    assert share == pytest.approx(0.6)
    alone = mean_and_error((np.abs(cdf[::5] - 0.5) < 0.34).astype(float), np.arange(10))[1]
    assert error == pytest.approx(alone)
