"""Algorithm 1 against closed forms: what it gets right, and what too narrow, by which factor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from core.builtin import inspection_plan
from core.calibration.layout import readings_at
from core.calibration.online import update
from core.calibration.schedule import Schedule, calibrate, instants
from core.calibration.schedule_readings import Readings
from core.calibration.space import shared_space
from core.calibration.state import RotorSpec, shared_posterior
from core.calibration.target import assemble
from core.errors import InputError
from core.model import Model, rotor_blade
from core.network import Network, Parameter
from core.observation import Inspection
from core.prediction import predict
from core.prior import Population, Prior
from core.validation.schedule_rotors import DISCREPANCIES, model_with, plan_readings
from tests.core.calibration.bar import LOCAL, bar, creep
from tests.core.calibration.test_exact import SLOPES, conjugate, exact, readings

TIMES = [0.0, 0.5, 1.0]
SLOPE, SIGMA, BLADES = 0.8, 0.4, 3
SPEC = RotorSpec("r", tuple(f"b{i}" for i in range(BLADES)), 4000, 3)
TOY = Schedule(multi=("y",), threshold=2e-3)


def design(n_local: int) -> np.ndarray:
    return np.array([[SLOPES[j] * t**j for j in range(n_local)] for t in TIMES])


def without(model: Model, name: str, value: float) -> Model:
    """The model with one parameter known beforehand."""
    parameters = tuple(
        Parameter(p.name, "dormant", p.prior, nominal=value) if p.name == name else p
        for p in model.network.parameters
    )
    return Model(Network("fixed", parameters, model.network.quantities), model.surrogate)


@pytest.mark.parametrize("n_local", [1, 2])
def test_the_shared_interval_is_too_narrow_by_the_computed_factor(n_local: int) -> None:
    """sd² = 1 / Lambda_ss in place of (Lambda^-1)_ss, around the right mean."""
    model, data = conjugate(n_local), readings(BLADES, TIMES, seed=n_local, sigma=SIGMA)
    mean, cov, _ = exact(model, data, BLADES, n_local)
    precision = np.linalg.inv(cov)
    factor = np.sqrt(cov[0, 0] * precision[0, 0])
    assert factor > 2, "the case needs a ridge"
    got = calibrate(model, SPEC, data, TOY)
    assert got.converged == {"all": True}
    shared = got.shared.particles
    sd = np.sqrt(shared.covariance[0, 0])
    assert sd * factor == pytest.approx(np.sqrt(cov[0, 0]), rel=0.05)
    assert abs(shared.mean[0] - mean[0]) < 0.15 * np.sqrt(cov[0, 0])
    state = update(model, SPEC, data)  # the joint calibration of the same readings is not narrow
    joint = shared_posterior(state.meta, state.arrays.__getitem__).particles
    assert np.sqrt(joint.covariance[0, 0]) == pytest.approx(np.sqrt(cov[0, 0]), rel=0.08)
    covered = 2 * norm.cdf(norm.ppf(0.95) * sd / np.sqrt(cov[0, 0])) - 1
    assert covered == pytest.approx(2 * norm.cdf(norm.ppf(0.95) / factor) - 1, abs=0.03)
    assert covered < 0.6, "a 90 % interval"
    for b in range(BLADES):
        i = np.arange(n_local) + 1 + b * n_local
        known = np.linalg.inv(precision[np.ix_(i, i)])
        found = got.local[f"b{b}"].particles.covariance
        assert np.sqrt(np.diag(found)) == pytest.approx(np.sqrt(np.diag(known)), rel=0.05)
        assert np.all(np.diag(known) < np.diag(cov)[i])


def test_along_a_ridge_the_threshold_stops_the_climb_early() -> None:
    """Each sweep leaves the share 1 − 1 / factor² of the way to the exact mean."""
    model, data = conjugate(1), readings(BLADES, TIMES, seed=1, sigma=0.15)
    mean, cov, _ = exact(model, data, BLADES, 1)
    rate = 1 - 1 / (cov[0, 0] * np.linalg.inv(cov)[0, 0])
    assert rate > 0.9
    got = calibrate(model, SPEC, data, replace(TOY, threshold=0.02))
    assert got.converged["all"]
    sweeps = len(got.trace)
    left = (mean[0] - got.shared.particles.mean[0]) / (mean[0] - 2.0)
    assert left == pytest.approx(rate**sweeps, abs=0.05)
    sd = np.sqrt(got.shared.particles.covariance[0, 0])
    assert abs(got.shared.particles.mean[0] - mean[0]) > 3 * sd


def test_without_a_shared_parameter_the_schedule_is_exact() -> None:
    model = without(conjugate(2), "s", 2.0)
    data = readings(1, TIMES, seed=5, sigma=0.15)
    got = calibrate(model, RotorSpec("r", ("b0",), 4000, 2), data, TOY)
    assert got.converged == {"all": True}
    assert len(got.trace) == 1
    c, prior = design(2), np.array([-1.0, 0.0])
    cov = np.linalg.inv(np.eye(2) / 0.6**2 + c.T @ c / 0.15**2)
    y = np.array([r.values[0] for r in data]) - SLOPE * 2.0
    mean = cov @ (prior / 0.6**2 + c.T @ y / 0.15**2)
    found = got.blade("b0").particles
    sd = np.sqrt(np.diag(cov))
    assert np.all(np.abs(found.mean - mean) < 0.1 * sd)
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx(sd, rel=0.05)
    band = predict(model, got.blade("b0"), "y", [2.0], noise=False)
    row = np.array([SLOPES[0], SLOPES[1] * 2.0])
    assert band.sd["parameters"][0] == pytest.approx(np.sqrt(row @ cov @ row), rel=0.06)


def test_a_curved_blade_alone_agrees_with_enumeration() -> None:
    """Three local parameters along a ridge, the shared rate and the noise known."""
    model, sigma, times = without(bar(), "rate", 0.95), 0.01, (8e3, 16e3, 24e3)
    truth = np.array([[0.9, 0.95, 1.2, -0.8]])
    noise = sigma * np.random.default_rng(8).standard_normal(3)
    data = [
        Inspection(f"r{t}", "b0", "y", t, creep(truth, t) + e, sigma=sigma)
        for t, e in zip(times, noise, strict=True)
    ]
    got = calibrate(model, RotorSpec("r", ("b0",), 5000, 2), data, TOY).blade("b0")
    at = [low + (np.arange(80) + 0.5) / 80 * (high - low) for _, low, high in LOCAL]
    tbc, alpha, gamma = (g.ravel() for g in np.meshgrid(*at, indexing="ij"))
    x = np.stack([tbc, np.full(len(tbc), 0.95), alpha, gamma], axis=1)
    log_p = -0.5 * sum(((creep(x, r.time_h) - r.values[0]) / sigma) ** 2 for r in data)
    w = np.exp(log_p - log_p.max())
    w /= w.sum()
    for name, values in zip(("tbc", "alpha", "gamma"), (tbc, alpha, gamma), strict=True):
        mean = w @ values
        sd = np.sqrt(w @ (values - mean) ** 2)
        column = got.column(name)
        assert abs(column.mean() - mean) < 0.15 * sd
        assert column.std() == pytest.approx(sd, rel=0.1)


def test_draws_held_follow_their_recursion_and_stay_too_narrow() -> None:
    """Distributions held in place of values: wider, and still narrower than the exact posterior."""
    model, data = conjugate(1), readings(BLADES, TIMES, seed=1, sigma=SIGMA)
    _, cov, _ = exact(model, data, BLADES, 1)
    how = replace(TOY, fix="draws", draws=100, threshold=0.1)
    got = calibrate(model, replace(SPEC, particles=1000), data, how)
    c, one = design(1), np.ones((3, 1))
    y = np.array([r.values[0] for r in data]).reshape(BLADES, 3)
    m, v = 2.0, 0.25
    for _ in got.trace:
        inverse = np.linalg.inv(SIGMA**2 * np.eye(3) + SLOPE**2 * v * one @ one.T)
        own_v = 1 / (1 / 0.6**2 + (c.T @ inverse @ c)[0, 0])
        own = own_v * (-1 / 0.6**2 + (y - SLOPE * m) @ inverse @ c[:, 0])
        inverse = np.linalg.inv(SIGMA**2 * np.eye(3) + own_v * c @ c.T)
        v = 1 / (1 / 0.25 + BLADES * SLOPE**2 * inverse.sum())
        m = v * (2.0 / 0.25 + SLOPE * ((y - own[:, None] * c.T) @ inverse).sum())
    sd = np.sqrt(got.shared.particles.covariance[0, 0])
    assert sd == pytest.approx(np.sqrt(v), rel=0.12)
    assert got.shared.particles.mean[0] == pytest.approx(m, abs=0.5 * np.sqrt(v))
    assert 1.2 / np.sqrt(np.linalg.inv(cov)[0, 0]) < sd < 0.8 * np.sqrt(cov[0, 0])


def test_the_last_sweep_as_prior_counts_every_reading_once_more_per_sweep() -> None:
    model, data = conjugate(1), readings(BLADES, TIMES, seed=1, sigma=SIGMA)
    got = calibrate(model, SPEC, data, replace(TOY, prior="last sweep", sweeps=4, threshold=1e-9))
    assert got.converged == {"all": False}
    sds = [sweep.sd["s"] for sweep in got.trace]
    once = len(data) * SLOPE**2 / SIGMA**2
    assert sds == pytest.approx([(4 + k * once) ** -0.5 for k in (1, 2, 3, 4)], rel=0.06)


def test_the_cap_is_reported_and_the_order_of_arrival_is_not_seen() -> None:
    model, data = conjugate(1), readings(BLADES, TIMES, seed=1, sigma=0.15)
    how = replace(TOY, sweeps=2, strategy="online", threshold=1e-6)
    got = calibrate(model, SPEC, data, how)
    assert got.converged == {"0 h": False, "0.5 h": False, "1 h": False}
    assert [(s.instant, s.number) for s in got.trace][:3] == [("0 h", 1), ("0 h", 2), ("0.5 h", 1)]
    assert all(s.moved > how.threshold for s in got.trace)
    assert min(got.ess.values()) > 0.5 * SPEC.particles
    again = calibrate(model, SPEC, data[::-1], how)
    assert np.array_equal(got.shared.particles.psi, again.shared.particles.psi)
    assert np.array_equal(got.blade("b1").particles.psi, again.blade("b1").particles.psi)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"threshold": 0.0}, "threshold"),
        ({"threshold": float("nan")}, "threshold"),
        ({"sweeps": 0}, "sweeps"),
        ({"draws": 1}, "draws"),
        ({"strategy": "both"}, "strategy"),
        ({"multi": ("z",)}, "quantity"),
        ({"fix": "draws", "draws": 5000}, "particles"),
    ],
)
def test_a_reading_that_cannot_be_used_is_refused(change: dict, what: str) -> None:
    with pytest.raises(InputError) as error:
        calibrate(conjugate(1), SPEC, readings(1, [0.0], 1, 0.2), replace(TOY, **change))
    assert error.value.what == what


def test_a_network_that_the_paper_does_not_know_is_refused() -> None:
    model = conjugate(1)
    drifting = replace(model.network, forgetting_h=10.0)
    s, local = model.network.parameters
    fleet = Population(Prior("uniform", -1.5, -0.5), Prior("uniform", 0.1, 1.0))
    own = replace(
        local, prior=Prior("uniform", local.prior.low, local.prior.high), population=fleet
    )
    drawn = replace(model.network, parameters=(s, own))
    for network, what in ((drifting, "forgetting_h"), (drawn, "population")):
        with pytest.raises(InputError) as error:
            calibrate(Model(network, model.surrogate), SPEC, readings(1, [0.0], 1, 0.2), TOY)
        assert error.value.what == what


def test_a_blade_that_the_rotor_does_not_have_is_refused() -> None:
    with pytest.raises(InputError, match="b3"):
        calibrate(conjugate(1), SPEC, readings(4, [0.0], 1, 0.2), TOY)


PLAN = plan_readings(inspection_plan.load(), ("B001", "B028", "B028-2", "B090"))


def test_outages_are_campaigns_not_the_hours_of_a_blade() -> None:
    found = dict(instants(PLAN[::-1]))
    assert list(found) == ["outage-1", "outage-2", "outage-3"]
    assert {(i.blade, i.time_h) for i in found["outage-2"]} >= {("B028-2", 8000.0)}


def everywhere(kind: str) -> Model:
    """The built-in model with this discrepancy of elongation and of deformation."""
    model = rotor_blade()
    wrong = DISCREPANCIES[kind]  # type: ignore[index]
    quantities = tuple(
        replace(q, discrepancy=wrong) if q.name != "ceeq" else q for q in model.network.quantities
    )
    return Model(replace(model.network, quantities=quantities), model.surrogate)


@pytest.mark.parametrize("kind", ["none", "constant", "paper"])
def test_the_likelihood_is_that_of_the_assembled_rows(kind: str) -> None:
    """With surrogate error, a scan's remainder and a discrepancy; held and averaged.

    The reference goes by (y − o) / g, as messages do, the schedule by g Y_m + o.
    """
    model = everywhere(kind)
    data = [r for r in PLAN if r.blade == "B001" and r.campaign == "outage-2"]
    names = ("tbc_thickness", "t1t_rate", "creep_transient", "creep_steady")
    rng = np.random.default_rng(2)
    n = 5
    x = np.stack([rng.uniform(p.prior.low, p.prior.high, n) for p in model.network.parameters], 1)
    rows = assemble(model, data)
    assert rows is not None
    space = shared_space(model, [rows])
    noise = {"sigma_obs.elongation": 0.02, "sigma_obs.deformation": 0.03}
    theta = {t: 0.03 * (j + 1) for j, t in enumerate(sorted(rows.shared.difference(noise, names)))}
    assert len(theta) == {"none": 0, "constant": 4, "paper": 4}[kind]
    fixed = {name: np.array([value]) for name, value in (noise | theta).items()}
    at = {**dict(zip(names, x.T, strict=True)), **{k: np.full(n, v) for k, v in fixed.items()}}
    y, s2, rest = readings_at(rows, space, np.stack([at[name] for name in space.names], axis=1))
    mean, sd = rows.response.evaluate(x)
    expected = norm.logpdf(y, mean, np.sqrt(s2 + sd**2)).sum(axis=1) + rest
    seen = Readings(model, data, None)
    assert seen.holding(fixed, names)(x) == pytest.approx(expected, abs=1e-6)
    held = {"t1t_rate": x[:, 1]} | {k: np.full(n, v[0]) for k, v in fixed.items()}
    own = np.delete(x, 1, axis=1)[:1]
    moved = [np.insert(own[0], 1, s) for s in x[:, 1]]
    each = seen.holding(fixed, names)(np.array(moved))
    averaged = seen.holding(held, [n for n in names if n != "t1t_rate"])(own)
    top = each.max()
    assert averaged[0] == pytest.approx(top + np.log(np.exp(each - top).mean()), abs=1e-6)


@pytest.mark.parametrize("strategy", ["offline", "online"])
@pytest.mark.parametrize("kind", ["none", "paper"])
def test_both_variants_run_on_the_inspection_plan(strategy: str, kind: str) -> None:
    model = model_with(kind)  # type: ignore[arg-type]
    how = Schedule(strategy=strategy, sweeps=2)  # type: ignore[arg-type]
    spec = RotorSpec("plan", ("B001", "B028", "B028-2", "B090", "B100"), 400, 1)
    got = calibrate(model, spec, PLAN, how)
    loops = {"all"} if strategy == "offline" else {"outage-1", "outage-2", "outage-3"}
    assert set(got.converged) == loops
    assert set(got.together) == {"B001", "B028"}
    theta = [n for n in got.shared.names if n.startswith("theta")]
    assert theta == ([] if kind == "none" else ["theta1.elongation", "theta2.elongation"])
    assert {n for n in got.shared.names if n.startswith("sigma")} == {
        q.sigma_name for q in model.network.quantities
    }
    for blade in spec.blades:
        posterior = got.blade(blade)
        assert np.isfinite(posterior.particles.psi).all()
        band = predict(model, posterior, "elongation", [32_000.0])
        assert 0 < band.sd["total"][0] < 2
    at_prior = got.local["B100"].column("creep_steady")
    assert at_prior.std() == pytest.approx(6 / np.sqrt(12), rel=0.1)
    noise = got.shared.column("sigma_obs.deformation")
    assert noise.mean() == pytest.approx(inspection_plan.NOISE["deformation"], rel=0.05)


def test_other_readings_of_the_words_run_and_differ() -> None:
    model = rotor_blade()
    spec = RotorSpec("plan", ("B001", "B028", "B028-2", "B090"), 400, 1)
    base = Schedule(sweeps=2)
    branches = calibrate(model, spec, PLAN, replace(base, single="branches"))
    assert "sigma_obs.deformation" not in branches.shared.names
    assert "sigma_obs.deformation" in branches.blade("B001").names
    own = calibrate(model, spec, PLAN, replace(base, noise="blade", offline="in turn"))
    assert own.shared.names == ("t1t_rate",)
    assert len(own.converged) == 3
    sigmas = {b: own.blade(b).column("sigma_obs.elongation").mean() for b in spec.blades}
    assert len(set(sigmas.values())) == 4
