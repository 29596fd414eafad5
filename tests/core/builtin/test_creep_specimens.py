"""The law of creep specimens, and calibrations of it that have an exact answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import logsumexp

from core.builtin import creep_specimens as built
from core.builtin.creep_specimens import QUANTITY, STRESS0, strain
from core.calibration.online import RotorSpec, update
from core.calibration.state import RotorState, blade_posterior, shared_posterior
from core.model import Model
from core.network import Level, Network
from core.observation import Inspection
from core.prediction import predict
from core.prior import Prior

Array = NDArray[np.float64]
RATE, N, PRIMARY, PRIMARY_STRAIN, TERTIARY, STRESS = range(6)
BOTH: dict[str, Level] = {"primary": "shared", "primary_strain": "shared", "tertiary": "shared"}


def inputs(**given: float) -> Array:
    """A specimen at 180 MPa that creeps 0.01 %/h, primary and tertiary asleep."""
    own = {
        "log_rate": np.log(0.01),
        "n": 7.0,
        "primary": 0.0,
        "primary_strain": 0.04,
        "tertiary": 0.0,
        "stress": STRESS0,
    }
    return np.array([(own | given)[i.name] for i in built.INPUTS])


TIMES = np.geomspace(0.1, 4000, 30)


def test_norton_alone_is_a_straight_line_whose_slope_goes_as_stress_to_the_n() -> None:
    assert strain(inputs(), TIMES) == pytest.approx(0.01 * TIMES, rel=1e-14)
    twice = strain(inputs(stress=2 * STRESS0), TIMES) / strain(inputs(), TIMES)
    assert twice == pytest.approx(np.full(30, 2.0**7), rel=1e-12)
    assert strain(inputs(stress=2 * STRESS0, n=6.0), 100.0) == pytest.approx(64.0, rel=1e-12)


@pytest.mark.parametrize("name", ["primary", "tertiary"])
def test_each_amplitude_has_norton_as_its_limit_and_goes_there_in_proportion(name: str) -> None:
    alone = strain(inputs(), TIMES)
    off = [np.abs(strain(inputs(**{name: a}), TIMES) - alone).max() for a in (1e-9, 1e-10)]
    assert off[1] == pytest.approx(off[0] / 10, rel=0.05)
    assert off[0] < 1e-6
    assert np.abs(strain(inputs(**{name: 0.1}), TIMES) - alone).max() > 0.05


def test_at_the_start_nothing_has_crept_and_the_rate_is_raised_by_primary_creep_alone() -> None:
    x = inputs(primary=0.8, tertiary=40.0)
    assert strain(x, 0.0) == 0.0
    h = 1e-4
    assert strain(x, h) / h == pytest.approx(0.01 * (1 + 0.8 / 0.04), rel=1e-4)


def test_after_long_times_primary_creep_is_its_amplitude_and_tertiary_creep_an_exponential() -> (
    None
):
    late = 3000.0
    gained = strain(inputs(primary=0.8), late) - strain(inputs(), late)
    assert gained == pytest.approx(0.8, rel=1e-12)
    c = 0.5
    rise = np.log(strain(inputs(tertiary=c), late) / strain(inputs(tertiary=c), late - 100.0))
    assert rise == pytest.approx(c * 0.01 * 100.0, rel=1e-5)


def test_strain_stays_finite_and_rises_with_rate_and_amplitude_at_every_corner() -> None:
    """Beyond an exponent of 60 a cut would let the strain fall as 1/c: the control."""
    low, high = built.formula().low, built.formula().high
    corners = low + (np.indices((2,) * 6).reshape(6, -1).T) * (high - low)
    values = strain(corners[:, None, :], np.array([0.0, 1.0, built.HORIZON_H]))
    assert np.isfinite(values**2).all()
    fast = inputs(log_rate=-1.0, stress=300.0)
    steps = []
    for c in (20.0, 40.0, 80.0):
        own = fast.copy()
        own[TERTIARY] = c
        steps.append(float(strain(own, 4000.0)))
    assert steps[0] < steps[1] < steps[2]
    assert np.expm1(built.MOST) / 80.0 < np.expm1(built.MOST) / 40.0


def simulated(
    freed: dict[str, Level], truth: Array, stresses: list[float], scatter: float, noise: float
) -> tuple[list[Inspection], dict[str, dict[str, float]]]:
    """Ten readings of each specimen, up to a steady strain that ends near 4 %."""
    rng, readings, known = np.random.default_rng(4), [], {}
    for b, stress in enumerate(stresses):
        own = truth.copy()
        own[STRESS] = stress
        own[RATE] += scatter * rng.normal()
        end = np.exp(-own[RATE]) * (stress / STRESS0) ** -own[N] * (1.5 if freed else 4.0)
        for i, t in enumerate(np.linspace(0.04, 1.0, 10) * end):
            y = np.array([strain(own, t) + noise * rng.normal()])
            readings.append(Inspection(f"{b}-{i}", f"s{b}", QUANTITY, float(t), y))
        known[f"s{b}"] = {"stress": stress}
    return readings, known


def moments(state: RotorState) -> dict[str, tuple[float, float]]:
    shared = shared_posterior(state.meta, state.arrays.__getitem__)
    sd = np.sqrt(np.diag(shared.particles.covariance))
    return dict(zip(shared.names, zip(shared.particles.mean, sd, strict=True), strict=True))


@pytest.fixture(scope="module")
def recovered() -> tuple[Model, RotorState, dict[str, dict[str, float]]]:
    model = Model(built.freed(built.network(), BOTH), built.formula())
    truth = inputs(log_rate=-4.5, n=7.0, primary=0.3, tertiary=0.6)
    stresses = [140.0, 140.0, 170.0, 170.0, 200.0, 200.0]
    readings, known = simulated(BOTH, truth, stresses, 0.1, 0.02)
    known["new"] = {"stress": 185.0}
    return model, update(model, RotorSpec("r", tuple(known), 1536, 1, known), readings), known


def test_known_parameters_are_recovered_with_every_dormant_one_freed(
    recovered: tuple[Model, RotorState, dict[str, dict[str, float]]],
) -> None:
    """Seven shared parameters on a ridge; held to 2.5 sd each, and the state to its own floor."""
    _, state, _ = recovered
    truth = {
        "n": 7.0,
        "primary": 0.3,
        "primary_strain": 0.04,
        "tertiary": 0.6,
        "mean.log_rate": -4.5,
        "sd.log_rate": 0.1,
        "sigma_obs.creep_strain": 0.02,
    }
    found = moments(state)
    assert found.keys() == truth.keys()
    off = {name: (found[name][0] - true) / found[name][1] for name, true in truth.items()}
    assert max(map(abs, off.values())) < 2.5, off
    assert found["tertiary"][1] < 0.15
    assert found["primary"][1] < 0.03
    assert state.meta["health"]["status"] == "ok"


def test_a_new_specimens_band_holds_what_its_stress_gives_and_is_wider_than_a_read_ones(
    recovered: tuple[Model, RotorState, dict[str, dict[str, float]]],
) -> None:
    model, state, known = recovered
    truth = inputs(log_rate=-4.5, n=7.0, primary=0.3, tertiary=0.6, stress=185.0)
    bands = {}
    for blade in ("new", "s4"):
        posterior = blade_posterior(state.meta, state.arrays.__getitem__, blade)
        bands[blade] = predict(model, posterior, QUANTITY, [60.0], known=known[blade])
    assert bands["new"].lower[0] < strain(truth, 60.0) < bands["new"].upper[0]
    assert bands["new"].sd["parameters"][0] > 3 * bands["s4"].sd["parameters"][0]


def conjugate() -> Network:
    """Local rates with a normal prior in place of a population."""
    own = built.network()
    rate = Prior("normal", -6.5, -2.5, -4.6, 0.3)
    parameters = tuple(
        replace(p, prior=rate, population=None) if p.name == "log_rate" else p
        for p in own.parameters
    )
    return replace(own, parameters=parameters)


def test_one_specimen_and_a_shared_n_agree_with_brute_force() -> None:
    """Posterior of n, of the rate and the evidence, against a grid of 601 × 4,001 points."""
    model, stress, sigma = Model(conjugate(), built.formula()), 230.0, 0.05
    readings, known = simulated({}, inputs(log_rate=-4.4), [stress], 0.0, sigma)
    readings = [replace(r, sigma=sigma) for r in readings]
    state = update(model, RotorSpec("one", ("s0",), 8192, 1, known), readings)
    n, rate = np.linspace(1.0, 16.0, 601), np.linspace(-6.5, -2.5, 4001)
    log_p = -0.5 * ((rate[None, :] + 4.6) / 0.3) ** 2 * np.ones((len(n), 1))
    log_p -= logsumexp(log_p[0]) + np.log(rate[1] - rate[0])
    steady = rate[None, :] + n[:, None] * np.log(stress / STRESS0)
    for r in readings:
        log_p += -0.5 * ((np.exp(steady) * r.time_h - r.values[0]) / sigma) ** 2
        log_p -= np.log(sigma * np.sqrt(2 * np.pi))
    edge = np.ones(len(n))
    edge[[0, -1]] = 0.5
    log_p += np.log(edge / (len(n) - 1))[:, None]
    evidence = logsumexp(log_p) + np.log(rate[1] - rate[0])
    w = np.exp(log_p - logsumexp(log_p))
    exact = {"n": (n, w.sum(axis=1)), "log_rate": (rate, w.sum(axis=0))}
    posterior = blade_posterior(state.meta, state.arrays.__getitem__, "s0")
    for name, (x, own) in exact.items():
        mean = own @ x
        sd = np.sqrt(own @ (x - mean) ** 2)
        drawn, weight = posterior.column(name), posterior.particles.w
        assert abs(weight @ drawn - mean) < 0.06 * sd, name
        assert np.sqrt(weight @ (drawn - weight @ drawn) ** 2) == pytest.approx(sd, rel=0.06)
    assert state.meta["log_evidence"] == pytest.approx(evidence, abs=0.03)
    (i, j), c = (posterior.names.index(x) for x in exact), posterior.particles.covariance
    centred = (n - exact["n"][1] @ n)[:, None] * (rate - exact["log_rate"][1] @ rate)
    ridge = np.sum(w * centred) / (0.3 * np.sqrt(exact["n"][1] @ (n - exact["n"][1] @ n) ** 2))
    assert ridge < -0.9  # what two marginals alone would miss
    assert c[i, j] / np.sqrt(c[i, i] * c[j, j]) == pytest.approx(ridge, abs=0.02)


def test_any_order_of_arrival_ends_in_the_same_sealed_state() -> None:
    model = Model(built.network(), built.formula())
    readings, known = simulated({}, inputs(log_rate=-4.5), [150.0, 200.0], 0.1, 0.03)
    spec = RotorSpec("r", tuple(known), 256, 3, known)
    whole = update(model, spec, readings)
    first = update(model, spec, readings[::-1][:11])
    later = update(model, spec, readings[::-1], first, quick=True)
    assert update(model, spec, readings[::-1], later).digest == whole.digest
    other = {"s0": {"stress": 151.0}, "s1": known["s1"]}
    assert update(model, replace(spec, known=other), readings).digest != whole.digest
