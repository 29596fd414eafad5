"""Forgetting: older readings of a blade lose weight, by a stated half-life."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.builtin.paper_network import rotor_blade_network
from core.calibration.online import update
from core.calibration.state import RotorSpec, RotorState, blade_posterior
from core.errors import InputError
from core.model import Model
from core.network import Network, Parameter, Quantity
from core.observation import Inspection
from core.prior import Prior
from core.surrogate.formula import FormulaInput, FormulaModel

SIGMA, HALF_LIFE = 0.2, 8e3
TIMES = np.arange(1, 9) * 4e3
BLADES = tuple(f"b{i}" for i in range(24))
SPEC = RotorSpec("r", BLADES, particles=3200, seed=5)


def level_model(forgetting_h: float | None = HALF_LIFE) -> Model:
    """y = s + l: every blade has a level of its own."""
    parameters = (
        Parameter("s", "shared", Prior.gaussian(1.0, 0.05)),
        Parameter("l", "local", Prior.gaussian(0.5, 1.0)),
    )
    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in parameters)
    quantity = Quantity("y", "1", "scalar", Prior("log_uniform", 0.01, 1.0), -50.0, 50.0)
    return Model(
        Network("levels", parameters, (quantity,), forgetting_h=forgetting_h),
        FormulaModel(inputs, {"y": lambda x, t: x[:, 0] + x[:, 1]}, "levels"),
    )


def measured(walk: float, blades: int = 24) -> tuple[list[Inspection], np.ndarray]:
    """Readings of levels that walk by `walk` per outage, and the last levels."""
    rng = np.random.default_rng(11)
    levels = 0.8 + 0.5 * rng.normal(size=(blades, 1))
    levels = levels + np.cumsum(walk * rng.normal(size=(blades, len(TIMES))), axis=1)
    y = 1.0 + levels + SIGMA * rng.normal(size=levels.shape)
    data = [
        Inspection(f"{b}-{t:g}", b, "y", float(t), y[i, [k]], sigma=SIGMA)
        for i, b in enumerate(BLADES[:blades])
        for k, t in enumerate(TIMES)
    ]
    return data, levels[:, -1]


def estimates(state: RotorState, blades: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """Mean and sd of each blade's level."""
    found = []
    for b in BLADES[:blades]:
        posterior = blade_posterior(state.meta, state.arrays.__getitem__, b)
        x, w = posterior.column("l"), posterior.particles.w
        found.append((w @ x, np.sqrt(w @ (x - w @ x) ** 2)))
    mean, sd = np.array(found).T
    return mean, sd


def test_discounted_readings_have_their_exact_posterior() -> None:
    data, _ = measured(0.0, 3)
    state = update(level_model(), SPEC, data)
    var = SIGMA**2 * 2 ** ((TIMES[-1] - TIMES) / HALF_LIFE)
    design = np.zeros((len(data), 4))
    for i, r in enumerate(data):
        design[i, [0, 1 + BLADES.index(r.blade)]] = 1.0
    prior, cov = np.array([1.0, 0.5, 0.5, 0.5]), np.diag([0.05**2, 1.0, 1.0, 1.0])
    spread = design @ cov @ design.T + np.diag(np.tile(var, 3))
    gain = cov @ design.T @ np.linalg.inv(spread)
    miss = np.array([r.values[0] for r in data]) - design @ prior
    mean, sd = prior + gain @ miss, np.sqrt(np.diag(cov - gain @ design @ cov))
    got, spread_got = estimates(state, 3)
    assert np.all(np.abs(got - mean[1:]) < 0.12 * sd[1:])
    assert spread_got == pytest.approx(sd[1:], rel=0.1)
    evidence = -0.5 * (
        miss @ np.linalg.solve(spread, miss) + np.linalg.slogdet(2 * np.pi * spread)[1]
    )
    assert state.meta["log_evidence"] == pytest.approx(evidence, abs=0.06)


def test_a_drifting_truth_is_tracked_better() -> None:
    data, last = measured(walk=0.25)
    rms = {}
    for half_life in (HALF_LIFE, None):
        mean, sd = estimates(update(level_model(half_life), SPEC, data))
        rms[half_life] = np.sqrt(np.mean((mean - last) ** 2))
        if half_life is None:
            assert np.mean(np.abs(mean - last) < 2 * sd) < 0.6, "falsely sharp without"
    assert rms[HALF_LIFE] < 0.75 * rms[None]


def test_a_constant_truth_costs_the_stated_width() -> None:
    data, last = measured(walk=0.0)
    state = update(level_model(), SPEC, data)
    kept = update(level_model(None), SPEC, data)
    effective = sum(0.5 ** ((TIMES[-1] - TIMES) / HALF_LIFE))
    told = state.meta["forgetting"]
    assert told["half_life_h"] == HALF_LIFE
    assert set(told["effective_readings"]) == set(BLADES)
    assert told["effective_readings"]["b3"] == pytest.approx(effective, abs=1e-3)
    assert "forgetting" not in kept.meta
    (mean, sd), (_, sharp) = estimates(state), estimates(kept)
    own = sd**2 - np.mean(sharp**2) + SIGMA**2 / len(TIMES)
    assert np.mean(own) == pytest.approx(SIGMA**2 / effective, rel=0.15)
    assert np.mean(np.abs(mean - last) < 2 * sd) > 0.8


def test_age_is_a_function_of_the_set_of_readings() -> None:
    data, _ = measured(0.1, 4)
    model, work = level_model(), None
    whole = update(model, SPEC, data)
    before = update(model, SPEC, [r for r in data if r.time_h < TIMES[-1]])
    rng = np.random.default_rng(3)
    shuffled = [data[i] for i in rng.permutation(len(data))]
    assert update(model, SPEC, shuffled, before, workspace=work).digest == whole.digest
    quick = update(model, SPEC, shuffled, before, quick=True)
    assert update(model, SPEC, data, quick).digest == whole.digest
    assert update(model, SPEC, [r for r in data if r.time_h < TIMES[-1]], whole).digest == (
        before.digest
    )


def test_a_single_reading_and_the_latest_outage_are_not_discounted() -> None:
    one = measured(0.0, 3)[0][::8]
    plain = update(level_model(None), SPEC, one)
    state = update(level_model(), SPEC, one)
    assert state.meta["log_evidence"] == pytest.approx(plain.meta["log_evidence"], abs=1e-9)


def test_what_was_read_a_thousand_half_lives_ago_counts_for_nothing() -> None:
    """2^3500 is no number; 2^400 is, and the product of a few such variances is none."""
    data, _ = measured(0.0, 2)
    latest, spec = [r for r in data if r.time_h == TIMES[-1]], replace(SPEC, blades=BLADES[:2])
    for half_life in (8.0, 30.0):
        model = level_model(half_life)
        all_of_them, alone = update(model, spec, data), update(model, spec, latest)
        for got, want in zip(estimates(all_of_them, 2), estimates(alone, 2), strict=True):
            assert got == pytest.approx(want, rel=0.02)
        # each of the others: N(y | l, sigma² 2^100)
        forgotten = len(data) - len(latest)
        nothing = -forgotten * np.log(SIGMA * 2.0**50 * np.sqrt(2 * np.pi))
        apart = all_of_them.meta["log_evidence"] - alone.meta["log_evidence"]
        assert apart == pytest.approx(nothing, abs=0.1)
        assert all_of_them.meta["forgetting"]["effective_readings"]["b0"] == pytest.approx(1.0)


def test_half_lives_are_declared_and_checked() -> None:
    network = level_model().network
    assert Network.from_json(network.to_json()) == network
    assert "forgetting_h" not in rotor_blade_network().to_json()
    for wrong in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match="forgetting_h"):
            replace(network, forgetting_h=wrong)
