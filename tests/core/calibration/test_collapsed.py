"""Messages of many local parameters by tempered particles, held to the quadrature's 0.01 nat."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from core.calibration import collapsed
from core.calibration.collapsed import CollapsedMessage
from core.calibration.collapsed_fit import average
from core.calibration.message import BladeMessage
from core.calibration.online import update
from core.calibration.space import shared_space
from core.calibration.state import RotorSpec, blade_posterior, shared_posterior
from core.calibration.target import assemble
from core.calibration.workspace import message_of
from core.errors import InputError
from core.model import Model
from core.observation import Inspection
from core.smc.tempered import Kernels
from core.validation.simulate import simulate
from core.validation.six_locals import three_stages
from core.validation.variants import model_of, plan
from tests.core.calibration.bar import bar, creep
from tests.core.calibration.linear import exact_column, exact_locals, linear


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def linear_readings(times: tuple[float, ...], sigma: float) -> list[Inspection]:
    rng = np.random.default_rng(5)
    return [
        Inspection(f"r{t}", "b0", "y", t, np.array([1.5 + rng.normal()]), sigma=sigma)
        for t in times
    ]


def message_for(
    model: Model, data: list[Inspection], kind: type[BladeMessage] = CollapsedMessage
) -> BladeMessage:
    rows = assemble(model, data)
    assert rows is not None
    return kind(model, rows, shared_space(model, [rows]), {})


@pytest.mark.parametrize(("many", "sigma"), [(4, 0.01), (6, 0.15), (8, 0.15)])
def test_a_linear_network_has_its_exact_message_and_local_moments(many: int, sigma: float) -> None:
    data = linear_readings((0.2, 0.9, 1.7), sigma)
    message = message_for(linear(many), data)
    unit = np.linspace(0.42, 0.6, 32)[:, None]
    s = 2.0 - 4.0 + 8.0 * unit[:, 0]
    column = message.column(unit)
    assert rms(column - exact_column(data, s, many)) < 0.01
    values, log_w = message.draws(unit[::8], 1200, np.random.default_rng(3), column[::8])
    for k, at in enumerate(s[::8]):
        mean, cov = exact_locals(data, float(at), many)
        w = np.exp(log_w[k])
        assert w.sum() == pytest.approx(1.0, abs=0.05)
        size = w.sum() ** 2 / (w @ w)
        off = (w / w.sum()) @ values[k] - mean
        assert np.all(np.abs(off) < 4 * np.sqrt(np.diag(cov) / size))
        spread = (w / w.sum()) @ (values[k] - mean) ** 2
        assert np.sqrt(spread) == pytest.approx(np.sqrt(np.diag(cov)), rel=0.15)


CASES = [
    ((1.0, 0.0, 0.0), (8e3, 16e3, 24e3), 0.03),
    ((0.93, -0.37, -0.76), (8e3, 16e3, 24e3, 32e3), 0.0018),  # a thin tube
    ((0.7, 2.8, -2.5), (8e3, 24e3, 50e3), 0.01),  # at the bounds
    ((0.99, -1.55, -1.46), (8e3,), 0.0028),  # a thin sheet through the box
    ((0.75, 0.0, 0.61), (8e3, 16e3, 24e3), 0.0011),
    ((0.77, 2.57, -2.58), (8e3, 16e3, 24e3, 32e3), 0.0018),
    ((1.3, 0.73, -0.79), (8e3, 24e3, 50e3), 0.0105),
    ((1.11, -1.35, -2.17), (8e3,), 0.0377),
    ((1.11, 0.07, 1.9), (8e3, 16e3), 0.0125),
    ((1.32, -1.77, 0.32), (8e3, 16e3, 24e3), 0.0093),
    ((0.9, 0.55, -1.59), (8e3, 16e3, 24e3, 32e3), 0.0402),
    ((1.24, -2.23, -0.2), (8e3, 24e3, 50e3), 0.0036),
]


def creep_message(case: tuple, kind: type[BladeMessage]) -> BladeMessage:
    truth, times, sigma = case
    rng, rate = np.random.default_rng(1), 0.93
    x = np.array([[truth[0], rate, truth[1], truth[2]]])
    data = [
        Inspection(f"i{t}", "b", "y", t, creep(x, t) + sigma * rng.standard_normal(1), sigma=sigma)
        for t in times
    ]
    return message_for(MODEL, data, kind)


MODEL = bar()
UNIT = np.linspace(0.6, 0.7, 32)[:, None]


def test_three_local_parameters_agree_with_the_quadrature() -> None:
    """Twelve cases: differences between nodes to 0.01 nat each, and the stated errors are honest.

    Of a column's error most is common to all nodes, which no posterior feels.
    """
    tilts, ratios = [], []
    for case in CASES:
        exact = creep_message(case, BladeMessage).column(UNIT)
        message = creep_message(case, CollapsedMessage)
        off = message.column(UNIT) - exact
        error, tilt = message.error(UNIT)
        tilts.append(rms(off - off.mean()))
        ratios.append((rms(off) / error, tilts[-1] / tilt))
        assert rms(off) < 0.02
        assert tilt < 0.02
    assert np.median(tilts) < 0.005
    assert max(tilts) < 0.015
    assert np.max(ratios) < 5
    assert np.all(np.sqrt(np.mean(np.square(ratios), axis=0)) < 2)


def test_an_estimate_is_unbiased_over_seeds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few points, many scrambles, one plan: the mean estimate of m is right, and its error."""
    monkeypatch.setattr(collapsed, "LEAST", 64)
    monkeypatch.setattr(collapsed, "MOST", 64)
    case, unit = CASES[9], UNIT[::16]
    exact = creep_message(case, BladeMessage).column(unit)
    message = creep_message(case, CollapsedMessage)
    plans, _, _ = message._planned(unit, 3, 1)
    (plan,) = plans
    ratio = np.array(
        [
            np.exp(
                average(
                    message._log_weights(
                        unit, plan.split, plan.proposal, message._base(64, 1000 * k)
                    )
                )[0]
                - exact
            )
            for k in range(200)
        ]
    )
    error = ratio.std(axis=0, ddof=1) / np.sqrt(len(ratio))
    assert np.all(ratio.std(axis=0) > 0.02)
    assert np.all(np.abs(ratio.mean(axis=0) - 1) < 4 * error)
    assert np.all(error < 0.02)


def test_particles_that_are_not_moved_do_not_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    """Negative control: broad parameters from the prior, and a bell in all parameters at once."""
    case = ((0.7, 2.8, -2.5), (8e3, 24e3, 50e3), 0.005)  # at the bounds
    exact = creep_message(case, BladeMessage).column(UNIT)
    assert rms(creep_message(case, CollapsedMessage).column(UNIT) - exact) < 0.01
    with monkeypatch.context() as patch:
        patch.setattr(collapsed, "tempered", lambda target, d, n, seed: (Kernels.uniform(d), False))
        patch.setattr(collapsed, "CARRIED", 0.0)
        off = creep_message(case, CollapsedMessage).column(UNIT) - exact
        assert rms(off) > 0.04
    case = CASES[1]
    exact = creep_message(case, BladeMessage).column(UNIT)
    monkeypatch.setattr(collapsed, "OFF_BELL", np.inf)
    off = creep_message(case, CollapsedMessage).column(UNIT) - exact
    assert rms(off) > 0.1


def test_a_column_depends_on_readings_and_nodes_alone() -> None:
    first, other = (creep_message(CASES[0], CollapsedMessage) for _ in range(2))
    other.column(UNIT[::2])
    other.draws(UNIT[::2], 24, np.random.default_rng(1), other.column(UNIT[::2]))
    assert np.array_equal(first.column(UNIT), other.column(UNIT))
    column = first.column(UNIT)
    drawn = [m.draws(UNIT, 24, np.random.default_rng(7), column) for m in (first, other)]
    assert np.array_equal(drawn[0][0], drawn[1][0])
    assert np.array_equal(drawn[0][1], drawn[1][1])


def test_a_rotor_with_six_local_parameters_updates_quick_and_sealed() -> None:
    model, data = linear(6), linear_readings((0.2, 0.9), 0.15)
    spec = RotorSpec("r", ("b0", "b1"), particles=2400, seed=3)
    before = update(model, spec, data[:1])
    quick = update(model, spec, data, before, quick=True)
    assert not quick.sealed
    sealed = update(model, spec, data, quick)
    assert sealed.digest == update(model, spec, data[::-1]).digest
    health = sealed.meta["health"]
    assert 0 <= health["message_tilt_nat"] <= health["message_error_nat"] < 0.02
    get = sealed.arrays.__getitem__
    grid = np.linspace(-2.0, 6.0, 4001)
    log_p = exact_column(data, grid, 6) - 0.5 * ((grid - 2.0) / 0.5) ** 2
    w = np.exp(log_p - log_p.max()) / np.exp(log_p - log_p.max()).sum()
    mean = w @ grid
    sd = np.sqrt(w @ (grid - mean) ** 2)
    shared = shared_posterior(sealed.meta, get).particles
    assert abs(shared.mean[0] - mean) < 0.1 * sd
    assert np.sqrt(shared.covariance[0, 0]) == pytest.approx(sd, rel=0.08)
    blade = blade_posterior(sealed.meta, get, "b0").particles
    assert blade.psi.shape[1] == 7


def test_the_path_follows_the_number_of_local_parameters() -> None:
    data = linear_readings((0.2,), 0.15)
    for many, kind in ((3, BladeMessage), (4, CollapsedMessage)):
        model = linear(many)
        rows = assemble(model, data)
        assert rows is not None
        assert type(message_of(model, rows, shared_space(model, [rows]), {})) is kind
    with pytest.raises(InputError, match="more than 10"):
        linear(11)


@pytest.mark.parametrize("rotor", [0, 2, 5])
def test_six_local_parameters_agree_with_a_mean_over_the_prior(rotor: int) -> None:
    """An independent answer by brute force: 400,000 draws of the prior, weighted by the likelihood.

    Messages at three nodes, and mean and spread of every local parameter.
    """
    variant = plan("six-locals")
    model = model_of(variant)
    made = simulate(model, variant, rotor, 7)
    data = [r for r in made.readings if r.blade == "B001"]
    message = message_for(model, data)
    priors = [p.prior for p in model.network.of_level("local")]
    rng = np.random.default_rng(5)
    local = np.stack([p.quantile(rng.random(400_000)) for p in priors], axis=1)
    sigma = made.shared["sigma_obs.elongation"]
    low, high = model.network.quantity("elongation").sigma_obs.box
    unit = np.array([[u, (np.log(sigma) - low) / (high - low)] for u in (0.2, 0.5, 0.8)])
    column = message.column(unit)
    values, log_w = message.draws(unit, 960, np.random.default_rng(3), column)
    for k, rate in enumerate(0.8 + 0.2 * unit[:, 0]):
        x = np.column_stack([np.full(len(local), rate), local])
        w = np.ones(len(local))
        for r in data:
            w *= norm.pdf(r.values[0], three_stages(x, r.time_h), sigma)
        error = np.hypot(message.error(unit)[0], w.std() / w.mean() / np.sqrt(len(w)))
        assert abs(column[k] - np.log(w.mean())) < 4 * error
        own, exact = np.exp(log_w[k]) / np.exp(log_w[k]).sum(), w / w.sum()
        size = min(1 / np.sum(own**2), 1 / np.sum(exact**2))
        mean = exact @ local
        sd = np.sqrt(exact @ (local - mean) ** 2)
        assert size > 100
        assert np.all(np.abs(own @ values[k] - mean) < 4 * sd / np.sqrt(size / 2))
        spread = np.sqrt(own @ (values[k] - own @ values[k]) ** 2)
        assert spread == pytest.approx(sd, rel=0.1)
