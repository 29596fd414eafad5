"""Posteriors, evidence and predictions against exact answers, off-centre."""

from __future__ import annotations

import numpy as np
import pytest

from core.calibration.online import update
from core.calibration.state import RotorSpec, blade_posterior, shared_posterior
from core.model import Model
from core.network import Network, Parameter, Quantity
from core.observation import Inspection
from core.prediction import predict
from core.prior import Prior
from core.surrogate.formula import FormulaInput, FormulaModel

SLOPES = (1.3, -0.7, 0.4)


def conjugate(n_local: int) -> Model:
    """y = 0.8 s + Σ c_j(t) l_j with normal priors: everything is jointly Gaussian."""

    def formula(x: np.ndarray, t: float) -> np.ndarray:
        return 0.8 * x[:, 0] + sum(SLOPES[j] * t**j * x[:, 1 + j] for j in range(n_local))

    shared = Parameter("s", "shared", Prior.gaussian(2.0, 0.5))
    local = [Parameter(f"l{j}", "local", Prior.gaussian(-1.0 + j, 0.6)) for j in range(n_local)]
    parameters = (shared, *local)
    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in parameters)
    quantity = Quantity("y", "1", "scalar", Prior("log_uniform", 0.01, 1.0), -50.0, 50.0)
    return Model(
        Network("conjugate", parameters, (quantity,)),
        FormulaModel(inputs, {"y": formula}, f"conjugate-{n_local}"),
    )


def readings(blades: int, times: list[float], seed: int, sigma: float) -> list[Inspection]:
    rng = np.random.default_rng(seed)
    return [
        Inspection(f"r{b}-{i}", f"b{b}", "y", t, np.array([1.5 + rng.normal()]), sigma=sigma)
        for b in range(blades)
        for i, t in enumerate(times)
    ]


def exact(model: Model, data: list[Inspection], blades: int, n_local: int) -> tuple:
    """Joint Gaussian of (s, l_b,j) by the textbook formula: mean, covariance, log evidence."""
    priors = [p.prior for p in model.network.parameters]
    mean = np.array([priors[0].mean, *([p.mean for p in priors[1:]] * blades)])
    cov = np.diag(np.array([priors[0].sd, *([p.sd for p in priors[1:]] * blades)]) ** 2)
    design = np.zeros((len(data), len(mean)))
    for row, reading in enumerate(data):
        b = int(reading.blade[1:])
        design[row, 0] = 0.8
        for j in range(n_local):
            design[row, 1 + b * n_local + j] = SLOPES[j] * reading.time_h**j
    y = np.array([r.values[0] for r in data])
    noise = np.diag([r.sigma**2 for r in data])
    spread = design @ cov @ design.T + noise
    gain = cov @ design.T @ np.linalg.inv(spread)
    miss = y - design @ mean
    evidence = -0.5 * (
        miss @ np.linalg.solve(spread, miss) + np.linalg.slogdet(2 * np.pi * spread)[1]
    )
    return mean + gain @ miss, cov - gain @ design @ cov, evidence


@pytest.mark.parametrize("n_local", [1, 2, 3])
def test_conjugate_network_has_its_exact_mean_variance_and_evidence(n_local: int) -> None:
    blades, sigma = 4, 0.15
    model = conjugate(n_local)
    data = readings(blades, [0.0, 0.5, 1.0], seed=n_local, sigma=sigma)
    spec = RotorSpec("r", tuple(f"b{b}" for b in range(blades)), particles=6400, seed=3)
    state = update(model, spec, data)
    mean, cov, evidence = exact(model, data, blades, n_local)
    assert state.meta["log_evidence"] == pytest.approx(evidence, abs=0.06)
    shared = shared_posterior(state.meta, state.arrays.__getitem__).particles
    sd = np.sqrt(cov[0, 0])
    assert abs(shared.mean[0] - mean[0]) < 0.1 * sd
    assert np.sqrt(shared.covariance[0, 0]) == pytest.approx(sd, rel=0.08)
    for b in range(blades):
        posterior = blade_posterior(state.meta, state.arrays.__getitem__, f"b{b}")
        size = posterior.particles.ess
        for j in range(n_local):
            k = 1 + b * n_local + j
            sd = np.sqrt(cov[k, k])
            tolerance = 4 * sd / np.sqrt(size) + 0.06 * sd
            i = posterior.names.index(f"l{j}")
            assert abs(posterior.particles.mean[i] - mean[k]) < tolerance
            got = np.sqrt(posterior.particles.covariance[i, i])
            assert got == pytest.approx(sd, rel=0.08)
            c = posterior.particles.covariance[i, posterior.names.index("s")]
            assert c == pytest.approx(cov[k, 0], abs=0.06 * sd * np.sqrt(cov[0, 0]))


def test_conjugate_prediction_has_its_exact_mean_and_band() -> None:
    model = conjugate(2)
    data = readings(3, [0.0, 0.6], seed=9, sigma=0.2)
    spec = RotorSpec("r", ("b0", "b1", "b2"), particles=12800, seed=1)
    state = update(model, spec, data)
    mean, cov, _ = exact(model, data, 3, 2)
    row = np.zeros(7)
    row[0], row[3], row[4] = 0.8, SLOPES[0], SLOPES[1] * 2.0  # blade b1 at t = 2
    posterior = blade_posterior(state.meta, state.arrays.__getitem__, "b1")
    got = predict(model, posterior, "y", [2.0], noise=False)
    sd = np.sqrt(row @ cov @ row)
    assert got.mean[0] == pytest.approx(row @ mean, abs=0.1 * sd)
    assert got.sd["parameters"][0] == pytest.approx(sd, rel=0.06)
    assert got.upper[0] == pytest.approx(row @ mean + 1.96 * sd, abs=0.15 * sd)


def curved() -> Model:
    """A nonlinear network small enough to enumerate: y = exp(l) + s t, sigma_obs unknown."""
    parameters = (
        Parameter("s", "shared", Prior("uniform", 0.0, 2.0)),
        Parameter("l", "local", Prior("uniform", -1.0, 1.5)),
    )
    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in parameters)

    def formula(x: np.ndarray, t: float) -> np.ndarray:
        return np.exp(x[:, 1]) + t * x[:, 0]

    quantity = Quantity("y", "1", "scalar", Prior("log_uniform", 0.02, 1.0), -50.0, 50.0)
    return Model(
        Network("curved", parameters, (quantity,)),
        FormulaModel(inputs, {"y": formula}, "curved"),
    )


def enumerate_curved(data: dict[str, list[tuple[float, float]]]) -> tuple:
    """Every combination on a grid: s × log sigma × l for each blade."""
    s = (np.arange(240) + 0.5) / 240 * 2.0
    logs = np.log(0.02) + (np.arange(160) + 0.5) / 160 * np.log(50.0)
    ell = -1.0 + (np.arange(900) + 0.5) / 900 * 2.5
    log_p = np.zeros((len(s), len(logs)))
    for blade in data.values():
        for i, sigma in enumerate(np.exp(logs)):
            ll = sum(
                -0.5 * ((np.exp(ell)[None] + t * s[:, None] - y) / sigma) ** 2
                - np.log(sigma * np.sqrt(2 * np.pi))
                for t, y in blade
            )
            top = ll.max(axis=1, keepdims=True)
            log_p[:, i] += top[:, 0] + np.log(np.exp(ll - top).mean(axis=1))
    evidence = np.log(np.exp(log_p - log_p.max()).mean()) + log_p.max()
    w = np.exp(log_p - log_p.max())
    w /= w.sum()
    mean_s, mean_g = w.sum(1) @ s, w.sum(0) @ logs
    return mean_s, np.sqrt(w.sum(1) @ (s - mean_s) ** 2), mean_g, evidence


def test_enumerated_network_has_its_exact_posterior_and_evidence() -> None:
    rng = np.random.default_rng(4)
    truth = {"b0": 0.9, "b1": -0.4, "b2": 1.3}
    data = {
        b: [(t, np.exp(v) + 0.7 * t + 0.1 * rng.normal()) for t in (0.0, 1.0, 2.0)]
        for b, v in truth.items()
    }
    inspections = [
        Inspection(f"{b}-{i}", b, "y", t, np.array([y]))
        for b, rows in data.items()
        for i, (t, y) in enumerate(rows)
    ]
    state = update(curved(), RotorSpec("r", tuple(truth), 6400, 5), inspections)
    mean_s, sd_s, mean_g, evidence = enumerate_curved(data)
    assert state.meta["log_evidence"] == pytest.approx(evidence, abs=0.06)
    posterior = shared_posterior(state.meta, state.arrays.__getitem__).particles
    assert abs(posterior.mean[0] - mean_s) < 0.1 * sd_s
    assert np.sqrt(posterior.covariance[0, 0]) == pytest.approx(sd_s, rel=0.1)
    assert posterior.w @ np.log(posterior.psi[:, 1]) == pytest.approx(mean_g, abs=0.06)


def test_a_flipped_sign_would_not_pass() -> None:
    """Negative control: the same comparison with the reading's sign turned is far off."""
    model = conjugate(1)
    data = readings(4, [0.0, 0.5, 1.0], seed=1, sigma=0.15)
    flipped = [
        Inspection(r.id, r.blade, r.quantity, r.time_h, -r.values, sigma=r.sigma) for r in data
    ]
    mean, cov, evidence = exact(model, data, 4, 1)
    state = update(model, RotorSpec("r", ("b0", "b1", "b2", "b3"), 6400, 3), flipped)
    shared = shared_posterior(state.meta, state.arrays.__getitem__).particles
    assert abs(shared.mean[0] - mean[0]) > np.sqrt(cov[0, 0])
    assert abs(state.meta["log_evidence"] - evidence) > 1


def alone() -> Model:
    """y = Σ c_j(t) l_j with two local parameters and nothing that blades share."""

    def formula(x: np.ndarray, t: float) -> np.ndarray:
        return np.asarray(SLOPES[0] * x[:, 0] + SLOPES[1] * t * x[:, 1])

    parameters = tuple(Parameter(f"l{j}", "local", Prior.gaussian(-1.0 + j, 0.6)) for j in range(2))
    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in parameters)
    quantity = Quantity("y", "1", "scalar", Prior("log_uniform", 0.01, 1.0), -50.0, 50.0)
    return Model(
        Network("alone", parameters, (quantity,)), FormulaModel(inputs, {"y": formula}, "alone")
    )


@pytest.mark.parametrize("told", [0, 1, 3])
def test_blades_that_share_nothing_each_have_their_own_exact_posterior(told: int) -> None:
    """Of three blades `told` have readings, of known noise: not even a noise is shared."""
    model, sigma = alone(), 0.15
    data = readings(told, [0.0, 0.5, 1.0], seed=told, sigma=sigma)
    spec = RotorSpec("r", ("b0", "b1", "b2"), particles=6400, seed=3)
    state = update(model, spec, data)
    assert state.meta["sealed"]
    evidence = 0.0
    for b in range(3):
        own = [r for r in data if r.blade == f"b{b}"]
        mean, cov = np.array([-1.0, 0.0]), 0.36 * np.eye(2)
        if own:
            design = np.array([[SLOPES[0], SLOPES[1] * r.time_h] for r in own])
            spread = design @ cov @ design.T + sigma**2 * np.eye(len(own))
            miss = np.array([r.values[0] for r in own]) - design @ mean
            gain = cov @ design.T @ np.linalg.inv(spread)
            evidence -= 0.5 * miss @ np.linalg.solve(spread, miss)
            evidence -= 0.5 * np.linalg.slogdet(2 * np.pi * spread)[1]
            mean, cov = mean + gain @ miss, cov - gain @ design @ cov
        posterior = blade_posterior(state.meta, state.arrays.__getitem__, f"b{b}")
        for j in range(2):
            i, sd = posterior.names.index(f"l{j}"), np.sqrt(cov[j, j])
            tolerance = 4 * sd / np.sqrt(posterior.particles.ess) + 0.06 * sd
            assert abs(posterior.particles.mean[i] - mean[j]) < tolerance
            got = np.sqrt(posterior.particles.covariance[i, i])
            assert got == pytest.approx(sd, rel=0.08)
    assert state.meta["log_evidence"] == pytest.approx(evidence, abs=0.06)
    more = [*data, Inspection("late", "b2", "y", 0.7, np.array([0.2]), sigma=sigma)]
    again = update(model, spec, more, state, quick=True)
    assert again.meta["health"]["ess_ratio"] > 0.5
