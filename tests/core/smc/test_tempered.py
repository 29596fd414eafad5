"""Tempered particles against exact evidences and moments, off-centre."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr

from core.smc.placement import sobol
from core.smc.tempered import Kernels, effective, temperatures, tempered


def evidence(log_target, d: int, seed: int = 1) -> tuple[float, np.ndarray, np.ndarray]:  # type: ignore[no-untyped-def]
    """log Z, weights and points of the first target by importance from the tempered proposal."""
    proposal, reached = tempered(log_target, d, 256, seed)
    assert reached
    x, log_q = proposal.points(sobol(2048, d, seed + 99))
    log_w = log_target(x)[0] - log_q
    top = log_w.max()
    w = np.exp(log_w - top)
    return top + float(np.log(w.mean())), w / w.sum(), x


def gauss(x: np.ndarray, mean: np.ndarray, sd: np.ndarray) -> np.ndarray:
    z = (x - mean) / sd
    return np.asarray(-0.5 * np.sum(z**2, axis=1) - np.sum(np.log(sd * np.sqrt(2 * np.pi))))


@pytest.mark.parametrize("d", [1, 3, 5])
def test_a_narrow_gaussian_has_its_evidence_and_moments(d: int) -> None:
    mean, sd = np.linspace(-0.4, 0.5, d), np.linspace(0.02, 0.1, d)
    log_z, w, x = evidence(lambda x: 3.0 + gauss(x, mean, sd)[None], d)
    assert log_z == pytest.approx(3.0, abs=0.05)
    assert np.all(np.abs(w @ x - mean) < 0.1 * sd)
    assert np.sqrt(w @ (x - mean) ** 2) == pytest.approx(sd, rel=0.1)


def test_a_gaussian_cut_by_the_box_has_the_mass_inside() -> None:
    mean, sd = np.array([1.1, -0.9, 0.2]), np.array([0.2, 0.1, 0.3])
    log_z, _, x = evidence(lambda x: gauss(x, mean, sd)[None], 3)
    exact = np.log(ndtr((1 - mean) / sd) - ndtr((-1 - mean) / sd)).sum()
    assert log_z == pytest.approx(exact, abs=0.04)
    assert np.abs(x).max() <= 1.0


def test_two_modes_keep_their_shares() -> None:
    low, high, sd = np.array([-0.6, -0.5]), np.array([0.7, 0.4]), np.array([0.05, 0.05])

    def target(x: np.ndarray) -> np.ndarray:
        return np.logaddexp(np.log(0.3) + gauss(x, low, sd), np.log(0.7) + gauss(x, high, sd))[None]

    log_z, w, x = evidence(target, 2)
    assert log_z == pytest.approx(0.0, abs=0.04)
    assert w @ (x[:, 0] > 0) == pytest.approx(0.7, abs=0.03)


def test_one_proposal_serves_several_targets() -> None:
    sd = np.array([0.1, 0.1])
    means = [np.array([-0.5, 0.3]), np.array([0.4, -0.6])]

    def target(x: np.ndarray) -> np.ndarray:
        return np.stack([gauss(x, mean, sd) for mean in means])

    proposal, _ = tempered(target, 2, 256, 4)
    x, log_q = proposal.points(sobol(2048, 2, 7))
    ratio = np.exp(target(x) - log_q).mean(axis=1)
    assert np.log(ratio) == pytest.approx(np.zeros(2), abs=0.05)


def test_points_that_never_move_miss_the_evidence() -> None:
    """Negative control: one round from the uniform box."""
    mean, sd = np.array([0.3, -0.2, 0.5]), np.array([0.01, 0.01, 0.01])
    proposal = Kernels.uniform(3)
    x, log_q = proposal.points(sobol(2048, 3, 1))
    log_w = gauss(x, mean, sd) - log_q
    top = log_w.max()
    assert abs(top + np.log(np.exp(log_w - top).mean())) > 0.5


def test_a_proposal_is_a_density_on_the_box() -> None:
    rng = np.random.default_rng(2)
    proposal = Kernels.around(rng.uniform(-1, 0.2, (40, 2)), np.full(40, 1 / 40))
    x, log_q = proposal.points(sobol(4096, 2, 3))
    inside = (x[:, 0] < -0.3) & (x[:, 1] > -0.5)  # E_q [1/q] over a region is its area
    area = np.mean(np.where(inside, np.exp(-log_q), 0.0))
    assert area == pytest.approx(0.7 * 1.5, rel=0.03)


def test_temperatures_keep_the_points_asked_for() -> None:
    log_w = np.stack([np.zeros(100), -0.5 * np.linspace(-30, 30, 100) ** 2])
    beta = temperatures(log_w, 20.0)
    assert beta[0] == 1.0
    assert effective(beta[1:, None] * log_w[1:])[0] == pytest.approx(20.0, rel=0.01)
