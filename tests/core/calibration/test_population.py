"""The population of a rotor's blades as hyperparameters, against enumerated answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr

from core.builtin.paper_network import rotor_blade_network
from core.calibration.online import update
from core.calibration.state import RotorSpec, RotorState, blade_posterior, shared_posterior
from core.errors import InputError
from core.model import Model
from core.network import Network, Parameter, Quantity
from core.observation import Inspection
from core.prior import Population, Prior
from core.surrogate.formula import FormulaInput, FormulaModel

SIGMA = 0.2
MEAN, SD = Prior.gaussian(1.0, 0.5), Prior("log_uniform", 0.1, 1.5)
BLADES = tuple(f"b{i}" for i in range(8))
SPEC = RotorSpec("r", (*BLADES, "new"), particles=12800, seed=2)


def hierarchical(low: float = -7.0, high: float = 9.0, mean: Prior = MEAN) -> Model:
    """y = s + l with l ~ N(mean, sd²) over the blades, cut at the bounds."""
    parameters = (
        Parameter("s", "shared", Prior.gaussian(2.0, 0.3)),
        Parameter("l", "local", Prior("uniform", low, high), population=Population(mean, SD)),
    )
    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in parameters)
    quantity = Quantity("y", "1", "scalar", Prior("log_uniform", 0.01, 1.0), -50.0, 50.0)
    return Model(
        Network("fleet", parameters, (quantity,)),
        FormulaModel(inputs, {"y": lambda x, t: x[:, 0] + x[:, 1]}, "fleet"),
    )


def readings(values: np.ndarray) -> list[Inspection]:
    return [
        Inspection(f"{b}-{i}", b, "y", float(i), np.array([v]), sigma=SIGMA)
        for b, own in zip(BLADES, values, strict=False)
        for i, v in enumerate(own)
    ]


def off_centre(seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return 2.4 + 1.7 + 0.5 * rng.normal(size=(8, 1)) + SIGMA * rng.normal(size=(8, 2))


def moments(state: RotorState, name: str) -> tuple[float, float]:
    posterior = shared_posterior(state.meta, state.arrays.__getitem__)
    x, w = posterior.column(name), posterior.particles.w
    return float(w @ x), float(np.sqrt(w @ (x - w @ x) ** 2))


def exact(values: np.ndarray) -> dict[str, tuple[float, float]]:
    """Conjugate in (s, mean) at each sd, and the sd on a grid; `new` is a blade without reading."""
    n, m = values.shape
    taus = np.exp(np.linspace(np.log(SD.low), np.log(SD.high), 2001))
    prior = np.array([2.0, 1.0]), np.diag([0.09, 0.25])
    average, log_w, means, covs = values.mean(axis=1), [], [], []
    within = np.sum((values - average[:, None]) ** 2)
    for tau in taus:
        var = tau**2 + SIGMA**2 / m
        design = np.ones((n, 2))
        spread = design @ prior[1] @ design.T + var * np.eye(n)
        miss = average - design @ prior[0]
        gain = prior[1] @ design.T @ np.linalg.inv(spread)
        means.append(prior[0] + gain @ miss)
        covs.append(prior[1] - gain @ design @ prior[1])
        log_w.append(
            -0.5 * (miss @ np.linalg.solve(spread, miss) + np.linalg.slogdet(2 * np.pi * spread)[1])
        )
    log_w = np.array(log_w)
    w = np.exp(log_w - log_w.max())
    # readings of a blade around their average, given any l
    constant = -0.5 * within / SIGMA**2 - n * (m - 1) / 2 * np.log(2 * np.pi * SIGMA**2)
    evidence = np.log(np.mean(w)) + log_w.max() + constant - n / 2 * np.log(m)
    w /= w.sum()
    means, covs = np.array(means), np.array(covs)

    def total(value: np.ndarray, var: np.ndarray) -> tuple[float, float]:
        centre = float(w @ value)
        return centre, float(np.sqrt(w @ var + w @ (value - centre) ** 2))

    return {
        "s": total(means[:, 0], covs[:, 0, 0]),
        "mean.l": total(means[:, 1], covs[:, 1, 1]),
        "sd.l": total(taus, np.zeros(len(taus))),
        "new": total(means[:, 1], covs[:, 1, 1] + taus**2),
        "evidence": (float(evidence), 0.0),
    }


@pytest.fixture(scope="module")
def state() -> RotorState:
    return update(hierarchical(), SPEC, readings(off_centre()))


def test_hyperparameters_and_evidence_are_exact(state: RotorState) -> None:
    want = exact(off_centre())
    for name in ("s", "mean.l", "sd.l"):
        mean, sd = moments(state, name)
        assert abs(mean - want[name][0]) < 0.12 * want[name][1], name
        assert sd == pytest.approx(want[name][1], rel=0.1), name
    assert state.meta["log_evidence"] == pytest.approx(want["evidence"][0], abs=0.06)


def new_blade(state: RotorState) -> tuple[float, float]:
    posterior = blade_posterior(state.meta, state.arrays.__getitem__, "new")
    x, w = posterior.column("l"), posterior.particles.w
    return float(w @ x), float(np.sqrt(w @ (x - w @ x) ** 2))


def test_a_blade_without_a_reading_starts_from_the_population(state: RotorState) -> None:
    mean, sd = new_blade(state)
    want = exact(off_centre())["new"]
    assert abs(mean - want[0]) < 0.08 * want[1]
    assert sd == pytest.approx(want[1], rel=0.08)
    few = update(hierarchical(), SPEC, readings(off_centre()[:1]))
    assert new_blade(few)[1] > 1.2 * sd, "fewer blades teach less"
    posterior = blade_posterior(state.meta, state.arrays.__getitem__, "new")
    i, j = posterior.names.index("l"), posterior.names.index("mean.l")
    want_sd = exact(off_centre())["mean.l"][1]
    assert posterior.particles.covariance[i, j] == pytest.approx(want_sd**2, rel=0.25)


def test_a_replaced_blade_keeps_informing(state: RotorState) -> None:
    """Leaving its readings out moves the successor's prior to the closed form without them."""
    without = update(hierarchical(), SPEC, readings(off_centre()[:7]))
    want = exact(off_centre()[:7])["new"]
    assert abs(new_blade(without)[0] - want[0]) < 0.08 * want[1]
    assert abs(want[0] - exact(off_centre())["new"][0]) > 0.02


def test_arrival_order_and_quick_states_do_not_matter(state: RotorState) -> None:
    data = readings(off_centre())
    before = update(hierarchical(), SPEC, data[:-1])
    quick = update(hierarchical(), SPEC, data, before, quick=True)
    assert not quick.sealed
    assert abs(new_blade(quick)[0] - new_blade(state)[0]) < 0.15 * new_blade(state)[1]
    assert update(hierarchical(), SPEC, data[::-1], quick).digest == state.digest


def test_bounds_cut_the_population_exactly() -> None:
    """l in [0, 1] with mean and sd enumerated: the cut's mass counts."""
    bounds = Prior("uniform", 0.0, 1.0)
    model = hierarchical(0.0, 1.0, bounds)
    pinned = replace(model.network.parameters[0], prior=Prior.gaussian(2.0, 1e-3))
    model = Model(
        replace(model.network, parameters=(pinned, model.network.parameters[1])),
        replace(model.surrogate, inputs=(FormulaInput("s", 1.99, 2.01), model.surrogate.inputs[1])),
    )
    values = np.array([[2.05, 2.2], [2.1, 1.95], [2.45, 2.5], [2.0, 1.9]])
    state = update(model, SPEC, readings(values))
    mu = (np.arange(120) + 0.5) / 120
    taus = np.exp(np.log(0.1) + (np.arange(160) + 0.5) / 160 * np.log(15.0))
    ell = (np.arange(600) + 0.5) / 600
    m, t = np.meshgrid(mu, taus, indexing="ij")
    z = (ell - m[..., None]) / t[..., None]
    prior = np.exp(-0.5 * z**2) / (t[..., None] * np.sqrt(2 * np.pi))
    mass = ndtr((1 - m) / t) - ndtr(-m / t)
    log_p, log_uncut = np.zeros(m.shape), np.zeros(m.shape)
    for own in values:
        like = np.prod(
            np.exp(-0.5 * ((own[:, None] - 2.0 - ell) / SIGMA) ** 2) / SIGMA / np.sqrt(2 * np.pi),
            axis=0,
        )
        integral = np.log(np.mean(prior * like, axis=2))
        log_p += integral - np.log(mass)
        log_uncut += integral
    for log_density, right in ((log_p, True), (log_uncut, False)):
        w = np.exp(log_density - log_density.max())
        evidence = np.log(w.mean()) + log_density.max()
        w /= w.sum()
        mean = float(np.sum(w * m))
        sd = float(np.sqrt(np.sum(w * (m - mean) ** 2)))
        near = abs(moments(state, "mean.l")[0] - mean) < 0.12 * sd
        near &= abs(state.meta["log_evidence"] - evidence) < 0.06
        assert near == right, "the cut's mass counts; without it the control fails"


def test_declarations_are_data_and_bad_ones_are_refused() -> None:
    network = hierarchical().network
    assert Network.from_json(network.to_json()) == network
    assert "population" not in str(rotor_blade_network().to_json())
    with pytest.raises(InputError, match="population of a"):
        Parameter("a", "shared", Prior("uniform", 0, 1), population=Population(MEAN, SD))
    with pytest.raises(InputError, match="population of a"):
        Parameter("a", "local", Prior.gaussian(0, 1), population=Population(MEAN, SD))
    with pytest.raises(InputError, match="population mean of a"):
        Parameter("a", "local", Prior("uniform", 0, 1), population=Population(MEAN, SD))
    with pytest.raises(InputError, match="population sd"):
        Population(MEAN, Prior("uniform", 0, 1))
