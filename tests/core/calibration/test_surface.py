"""Weights of the nodes that agree with the surface through them."""

from __future__ import annotations

import numpy as np
import pytest

from core.calibration import surface
from core.calibration.space import SharedSpace
from core.calibration.surface import Surface, evening, tilt
from core.errors import InputError
from core.prior import Prior
from core.smc.particles import ess, log_sum_exp, normalised
from core.smc.placement import sobol
from core.smc.proposal import Proposal, rounded

MEAN, COV = np.array([0.45, 0.6]), np.array([[0.0016, 0.0006], [0.0006, 0.0009]])
SPACE = SharedSpace(("a", "b"), (Prior("uniform", 0.0, 1.0), Prior("uniform", -2.0, 2.0)))


def log_p(unit: np.ndarray) -> np.ndarray:
    """A normal, bent by a cubic: skew."""
    z = (unit - MEAN) @ np.linalg.inv(np.linalg.cholesky(COV)).T
    return np.asarray(-0.5 * np.sum(z**2, axis=1) + 0.08 * z[:, 0] ** 3 - 0.02 * z[:, 0] ** 4 - 7.0)


def moments_of(unit: np.ndarray, log_w: np.ndarray) -> np.ndarray:
    x, w = SPACE.to_x(unit), normalised(log_w)
    mean = w @ x
    return np.concatenate([mean, np.sqrt(w @ (x - mean) ** 2)])


def errors(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors of mean and sd, in sds, by plain and by evened weights; all against dense points."""
    proposal = rounded(MEAN, COV)
    dense, log_q = proposal.nodes(sobol(2**15, 2, 99))
    exact = moments_of(dense, log_p(dense) - log_q)
    unit, log_q = proposal.nodes(sobol(64, 2, seed))
    scale = np.tile(exact[2:], 2)
    added, error = evening(SPACE, proposal, unit, log_p(unit), log_q)
    assert error is not None
    log_w = log_p(unit) - log_q + added
    assert log_sum_exp(log_w) == pytest.approx(log_sum_exp(log_p(unit) - log_q), abs=1e-5)
    assert ess(log_w) > 0.8 * ess(log_p(unit) - log_q)
    plain = moments_of(unit, log_p(unit) - log_q)
    return (plain - exact) / scale, (moments_of(unit, log_w) - exact) / scale


def test_evened_weights_know_mean_and_spread_better() -> None:
    plain, even = (
        np.sqrt(np.mean(np.square(e), axis=0)) for e in zip(*map(errors, range(20)), strict=True)
    )
    assert np.all(even < 0.006)
    assert np.all(even < 0.5 * plain)


def test_a_surface_that_rises_between_the_nodes_changes_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    proposal = rounded(MEAN, COV)
    unit, log_q = proposal.nodes(sobol(64, 2, 1))
    assert evening(SPACE, proposal, unit, log_p(unit), log_q)[1] is not None

    def rising(u: np.ndarray) -> np.ndarray:
        z = (u - MEAN) / np.sqrt(COV.diagonal()) - np.array([1.5, 0.0])
        return log_p(u) + 4.0 * np.exp(-0.5 * np.sum((z / 0.2) ** 2, axis=1))

    monkeypatch.setattr(Surface, "through", staticmethod(lambda *_: (rising, 0.1)))
    added, error = evening(SPACE, proposal, unit, log_p(unit), log_q)
    assert error is None
    assert not added.any()


def test_a_surface_that_cannot_be_trusted_changes_nothing() -> None:
    proposal = Proposal(MEAN, np.linalg.cholesky(COV))
    unit, log_q = proposal.nodes(sobol(64, 2, 1))
    rough = log_p(unit) + 2.0 * np.random.default_rng(0).standard_normal(64)
    added, error = evening(SPACE, proposal, unit, rough, log_q)
    assert error is None
    assert not added.any()


def test_too_few_nodes_carry_no_surface() -> None:
    proposal = Proposal(MEAN, np.linalg.cholesky(COV))
    unit, log_q = proposal.nodes(sobol(4, 2, 1))
    assert evening(SPACE, proposal, unit, log_p(unit), log_q)[1] is None


def test_no_weights_lead_to_a_mean_outside_the_points() -> None:
    points = np.random.default_rng(0).random((30, 2)) + 0.1
    assert tilt(points, np.zeros(30)) is None


def test_length_and_nugget_may_be_chosen_at_a_part_of_many_nodes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The surface itself goes through all of them."""
    proposal = rounded(MEAN, COV)
    unit, log_q = proposal.nodes(sobol(256, 2, 1))
    dense = proposal.nodes(sobol(1024, 2, 2))[0]
    dense = dense[log_p(dense) > log_p(dense).max() - 6.0]
    w = normalised(log_p(unit) - log_q)
    for most in (512, 64):
        monkeypatch.setattr(surface, "CHOOSING", most)
        found, error = Surface.through(unit, log_p(unit), w)
        assert len(found.nodes) > 200
        assert error < 1e-3
        assert np.max(np.abs(found(dense) - log_p(dense))) < 0.01
    monkeypatch.setattr(surface, "_fitted", lambda z, *_: (z[:, 0], np.full(len(z), np.nan)))
    with pytest.raises(InputError, match="goes through no nodes"):
        Surface.through(unit, log_p(unit), w)
