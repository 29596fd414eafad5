"""Declarations, modes and predictions of a discrepancy."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from core.answers import Stacked
from core.builtin.paper_network import rotor_blade_network
from core.calibration.state import Posterior
from core.curves import instrument_of, noise_of
from core.discrepancy import affine, parameters
from core.errors import InputError
from core.expansion import HELD, modes
from core.model import Model
from core.network import Discrepancy, Network, Parameter, Quantity
from core.prediction import predict
from core.prior import Population, Prior
from core.smc.particles import Particles
from core.surrogate.formula import FormulaInput, FormulaModel
from tests.core.calibration.drifting import HORIZON, KINDS, LOCAL_SD, drifting

NOISE = Prior("log_uniform", 1e-3, 0.2)


def declared(quantity: str = "elongation", **fields: Any) -> Network:
    """The rotor blade's network with a discrepancy of one quantity."""
    network = rotor_blade_network()
    quantities = tuple(
        replace(q, discrepancy=Discrepancy(**fields)) if q.name == quantity else q
        for q in network.quantities
    )
    return replace(network, quantities=quantities)


# --- declarations -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "fields",
    [
        {"kind": "none"},
        {"kind": "constant", "sd": 0.1},
        {"kind": "constant", "prior": Prior("uniform", -0.1, 0.3), "sigma": 0.01},
        {"kind": "paper"},
        {"kind": "paper", "psi": "t1t_rate", "sd": 0.02},
        {"kind": "gp", "length_h": 20_000.0},
    ],
)
def test_a_declaration_survives_json(fields: dict[str, Any]) -> None:
    network = declared(**fields)
    assert Network.from_json(json.loads(json.dumps(network.to_json()))) == network


def test_the_kind_alone_is_enough_for_the_papers_form() -> None:
    told = rotor_blade_network().to_json()
    told["quantities"][0]["discrepancy"] = {"kind": "paper"}
    found = Network.from_json(told).quantity("elongation").discrepancy
    assert (found.sd, found.sigma, found.psi) == (0.05, 1e-5, None)


def test_a_network_without_discrepancies_says_nothing_of_them() -> None:
    """Rotors are pinned to the digest of their declaration."""
    text = json.dumps(rotor_blade_network().to_json())
    assert "discrepancy" not in text
    assert "instrument" not in text
    kinds = [Discrepancy(), *KINDS.values(), Discrepancy("paper", sd=0.03)]
    assert len({drifting(kind).digest for kind in kinds}) == len(kinds)


@pytest.mark.parametrize(
    ("fields", "named"),
    [
        ({"kind": "linear"}, "linear"),
        ({"kind": "none", "sd": 0.1}, "sd"),
        ({"kind": "constant"}, "give sd or prior"),
        ({"kind": "constant", "sd": 0.1, "prior": Prior("uniform", -1, 1)}, "give sd or prior"),
        ({"kind": "constant", "prior": Prior("log_uniform", 0.1, 1)}, "has no sign"),
        ({"kind": "constant", "sd": -0.1}, "-0.1"),
        ({"kind": "constant", "sd": float("nan")}, "nan"),
        ({"kind": "constant", "sd": 0.1, "psi": "t1t_rate"}, "psi"),
        ({"kind": "paper", "length_h": 100.0}, "length_h"),
        ({"kind": "paper", "sigma": -1e-5}, "-1e-05"),
        ({"kind": "paper", "psi": "tbc_thickness"}, "no shared parameter"),
        ({"kind": "paper", "sd": 0.2}, "below 0.1"),
        ({"kind": "gp"}, "length_h"),
        ({"kind": "gp", "length_h": 0.0}, "0.0"),
    ],
)
def test_a_bad_declaration_is_refused_by_name(fields: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError, match=named):
        declared(**fields)


@pytest.mark.parametrize(
    ("fields", "named"),
    [({"length_h": 0.05}, "modes"), ({"length_h": 1.0, "sd": 0.3}, "below 0.1")],
)
def test_a_process_that_the_model_cannot_carry_is_refused(
    fields: dict[str, Any], named: str
) -> None:
    model = drifting(Discrepancy("gp", **fields))
    with pytest.raises(InputError, match=named):
        parameters(model, model.network.quantity("y"))


def test_a_process_runs_over_the_hours_of_the_model_that_answers_for_its_quantity() -> None:
    """Coupons that are read for 1,000 h, below blades whose model covers 50,000."""
    wrong = Discrepancy("gp", sd=0.02, length_h=400.0)
    short = Quantity("short", "1", "scalar", NOISE, -5.0, 5.0, discrepancy=wrong)
    long = replace(short, name="long", discrepancy=Discrepancy())
    local = Parameter("a", "local", Prior("uniform", 0.0, 1.0))
    inputs = (FormulaInput("a", 0.0, 1.0),)
    coupon, blade = (
        FormulaModel(inputs, {name: lambda x, t: x[:, 0]}, name, horizon_h=horizon_h)
        for name, horizon_h in (("short", 1e3), ("long", 5e4))
    )
    both = Stacked(((coupon, ("short",)), (blade, ("long",))))
    stacked = Model(Network("two", (local,), (short, long)), both)
    alone = Model(Network("one", (local,), (short,)), coupon)
    assert parameters(stacked, short) == parameters(alone, short)
    assert affine(stacked, short, 700.0) == affine(alone, short, 700.0)


def test_names_that_would_collide_are_refused() -> None:
    with pytest.raises(InputError, match=r"theta\.y"):
        Network("n", (Parameter("theta.y", "shared", Prior("uniform", 0, 1)),), ())
    with pytest.raises(InputError, match=r"y\.x"):
        Quantity("y.x", "mm", "scalar", NOISE, 0, 1)
    population = Population(Prior("uniform", 0.2, 0.8), Prior("log_uniform", 0.01, 1.0))
    many = Parameter("a", "local", Prior("uniform", 0, 1), population=population)
    Network("n", (many, Parameter("mean.b", "shared", Prior("uniform", 0, 1))), ())
    with pytest.raises(InputError, match=r"mean\.a.*of a population"):
        Network("n", (many, Parameter("mean.a", "shared", Prior("uniform", 5, 9))), ())
    bad = rotor_blade_network().to_json()
    bad["quantities"][0]["discrepancy"] = {"kind": "paper", "theta": 1}
    with pytest.raises(InputError, match="does not fit the schema"):
        Network.from_json(bad)


@pytest.mark.parametrize(
    ("wrong", "what"),
    [
        ({"kind": "curve"}, "kind of y"),
        ({"low": 1.0, "high": 0.0}, "range of y"),
        ({"low": float("nan")}, "range of y"),
        ({"numerical": -0.01}, "numerical of y"),
        ({"numerical": float("nan")}, "numerical of y"),
    ],
)
def test_a_quantity_that_no_reading_could_be_of_is_refused(
    wrong: dict[str, Any], what: str
) -> None:
    given: dict[str, Any] = {"name": "y", "unit": "mm", "kind": "scalar", "low": 0.0, "high": 1.0}
    assert Quantity(sigma_obs=NOISE, **given).numerical == 0.0
    with pytest.raises(InputError, match=what):
        Quantity(sigma_obs=NOISE, **(given | wrong))


# --- modes --------------------------------------------------------------------------------------


@pytest.mark.parametrize("length", [0.3, 1.0, 4.0])
def test_modes_rebuild_the_process_and_say_what_they_leave(length: float) -> None:
    t = np.linspace(0, 1, 31)
    covariance = np.exp(-0.5 * ((t[:, None] - t) / length) ** 2)
    found = modes(length)
    at = found.at(t)
    left = 1 - np.sum(at**2, axis=1)
    assert np.all(left >= -1e-9)
    assert np.all(left <= 1 - HELD)
    assert np.max(np.abs(at @ at.T - covariance)) <= 1 - HELD
    gram = (found.value * found.weight[:, None]).T @ found.value
    assert gram == pytest.approx(np.eye(len(found.eigenvalue)), abs=1e-9)
    fewer = at[:, :-1]
    assert np.max(1 - np.sum(fewer**2, axis=1)) > 1 - HELD, "no mode too many"


# --- predictions --------------------------------------------------------------------------------


def cloud(model: Model, quantity: str = "y", n: int = 3000, told: bool = True) -> Posterior:
    """Particles of some posterior; `told`: the discrepancy's parameters are among them."""
    rng = np.random.default_rng(8)
    s = 2.0 + 0.1 * rng.standard_normal(n)
    columns = {"l": LOCAL_SD * rng.standard_normal(n), "s": s}
    columns[f"sigma_obs.{quantity}"] = 0.02 * np.exp(0.2 * rng.standard_normal(n))
    if told:
        for name, prior in parameters(model, model.network.quantity(quantity)).items():
            # partly the opposite of s, as readings would have it
            z = -0.6 * (s - 2.0) / 0.1 + 0.5 * rng.standard_normal(n)
            columns[name] = np.clip(0.3 * prior.sd * z, prior.low, prior.high)
    log_w = 0.3 * rng.standard_normal(n)
    return Posterior(tuple(columns), Particles(np.stack([*columns.values()], axis=1), log_w))


def readings_of(model: Model, posterior: Posterior, t: float, n: int = 400_000) -> np.ndarray:
    """Readings drawn from the particles one by one, by the declaration's own formulas."""
    rng = np.random.default_rng(4)
    index = rng.choice(len(posterior.particles.log_w), n, p=posterior.particles.w)
    c = {name: posterior.column(name)[index] for name in posterior.names}
    quantity = model.network.quantity("y")
    clean = 3 + c["s"] * t + c["l"] * (0.5 + t)
    answer = clean * (1 + quantity.numerical * rng.standard_normal(n))
    wrong = quantity.discrepancy
    if wrong.kind == "constant":
        answer = answer + c["theta.y"]
    elif wrong.kind == "paper":
        answer = answer * (1 + c["theta1.y"] - c["theta2.y"] * c["s"])
        answer = answer + wrong.sigma * rng.standard_normal(n)
    elif wrong.kind == "gp":
        at = affine(model, quantity, t)
        gain = 1 + sum(k * c[name] for k, (name,) in at.gain)
        answer = answer * gain + at.left * clean * gain * rng.standard_normal(n)
    return np.asarray(answer + c["sigma_obs.y"] * rng.standard_normal(n))


@pytest.mark.parametrize("kind", ["none", *KINDS])
def test_a_band_is_that_of_readings_drawn_one_by_one(kind: str) -> None:
    model = drifting(KINDS.get(kind, Discrepancy()), numerical=0.01)
    posterior = cloud(model)
    got = predict(model, posterior, "y", [0.7, HORIZON])
    for i, t in enumerate((0.7, HORIZON)):
        drawn = readings_of(model, posterior, t)
        sd = drawn.std()
        assert got.mean[i] == pytest.approx(drawn.mean(), abs=4 * sd / 400_000**0.5)
        assert got.sd["total"][i] == pytest.approx(sd, rel=0.006)
        for p in (0.025, 0.5, 0.975):
            assert got.quantiles[p][i] == pytest.approx(np.quantile(drawn, p), abs=0.02 * sd)
    parts = [got.sd[name] ** 2 for name in ("parameters", "surrogate", "discrepancy", "noise")]
    assert sum(parts) == pytest.approx(got.sd["total"] ** 2, rel=1e-12)
    assert np.all(got.sd["discrepancy"] > 0) == (kind != "none")


@pytest.mark.parametrize("kind", KINDS)
def test_a_discrepancy_that_nobody_measured_enters_with_its_prior(kind: str) -> None:
    t = 1.0
    model = drifting(KINDS[kind])
    posterior = cloud(model, told=False)
    got = predict(model, posterior, "y", [t], noise=False)
    w, s = posterior.particles.w, posterior.column("s")
    clean = 3 + s * t + posterior.column("l") * (0.5 + t)
    sd = KINDS[kind].sd
    assert sd is not None
    cut = Prior.gaussian(0.0, 1.0, 4.0).quantile((np.arange(10**5) + 0.5) / 10**5).var()
    relative = {"constant": 1 / clean**2, "paper": 1 + s**2, "gp": np.ones_like(s)}[kind]
    expected = np.sqrt(cut * sd**2 * (w @ (clean**2 * relative)))
    assert got.sd["discrepancy"][0] == pytest.approx(expected, rel=0.03)
    assert got.mean[0] == pytest.approx(w @ clean, abs=0.02 * expected)
    plain = predict(drifting(Discrepancy()), posterior, "y", [t], noise=False)
    slope = expected / plain.sd["parameters"][0] / np.sqrt(posterior.particles.ess)  # by chance
    assert got.sd["parameters"][0] == pytest.approx(plain.sd["parameters"][0], rel=3 * slope)
    assert plain.sd["discrepancy"][0] == 0


def test_what_goes_with_the_model_counts_as_the_parameters() -> None:
    """The opposite of the model's answer takes from the parameters; the rest is its own."""
    model = drifting(KINDS["constant"])
    rng, n = np.random.default_rng(1), 2000
    s, free = 2 + 0.1 * rng.standard_normal(n), 0.05 * rng.standard_normal(n)
    psi = np.stack([np.zeros(n), s, np.full(n, 0.02), -0.5 * (s - 2) + free], axis=1)
    posterior = Posterior(("l", "s", "sigma_obs.y", "theta.y"), Particles(psi, np.zeros(n)))
    got = predict(model, posterior, "y", [1.0])
    assert got.sd["parameters"][0] == pytest.approx(0.05, rel=0.06)
    assert got.sd["discrepancy"][0] == pytest.approx(0.05, rel=0.06)


def two_noises(sd_a: float, sd_b: float) -> Posterior:
    rng, n = np.random.default_rng(1), 2000
    names = ("l", "s", "sigma_obs.y@a", "sigma_obs.y@b")
    noises = [s * np.exp(k * rng.standard_normal(n)) for s, k in ((0.05, sd_a), (0.01, sd_b))]
    psi = np.stack([np.zeros(n), np.full(n, 2.0), *noises], axis=1)
    return Posterior(names, Particles(psi, np.zeros(n)))


def test_a_reading_has_the_noise_of_the_instrument_known_best_or_asked_for() -> None:
    model = drifting(Discrepancy(), by_instrument=True)
    posterior = two_noises(0.05, 0.3)
    quantity = model.network.quantity("y")
    assert instrument_of(posterior, quantity) == "a"
    assert instrument_of(two_noises(0.3, 0.05), quantity) == "b"
    got = predict(model, posterior, "y", [1.0])
    assert got.instrument == "a"
    assert got.sd["noise"][0] == pytest.approx(0.05, rel=0.02)
    asked = predict(model, posterior, "y", [1.0], instrument="b")
    assert asked.instrument == "b"
    assert asked.sd["noise"][0] == pytest.approx(0.01 * np.exp(0.3**2), rel=0.1)
    new = noise_of(model, posterior, "y", "never seen")
    assert np.log(new).mean() == pytest.approx(sum(quantity.sigma_obs.box) / 2, abs=0.01)
    with pytest.raises(InputError, match="instrument"):
        predict(drifting(Discrepancy()), posterior, "y", [1.0], instrument="a")


def test_a_band_on_the_process_widens_after_the_last_reading() -> None:
    """With f known at 0 … 0.5 only, its own uncertainty comes back towards the horizon."""
    model = drifting(Discrepancy("gp", length_h=0.6))
    names = [*parameters(model, model.network.quantity("y"))]
    at = modes(0.6 / HORIZON).at(np.linspace(0, 0.25, 6))
    gain = at.T @ np.linalg.inv(at @ at.T + 1e-4 * np.eye(6))
    covariance = np.eye(len(names)) - gain @ at
    root = np.linalg.cholesky(covariance + 1e-9 * np.eye(len(names)))
    theta = np.random.default_rng(2).standard_normal((4000, len(names))) @ root.T
    known = np.column_stack([np.zeros(4000), np.full(4000, 2.0), np.full(4000, 0.02)])
    posterior = Posterior(
        ("l", "s", "sigma_obs.y", *names), Particles(np.hstack([known, theta]), np.zeros(4000))
    )
    got = predict(model, posterior, "y", [0.2, 1.0, HORIZON], noise=False)
    relative = got.sd["discrepancy"] / (3 + 2 * got.time_h)
    assert relative[0] < 0.01
    assert relative[2] == pytest.approx(0.05, rel=0.1), "as wide as the prior"
    assert relative[0] < relative[1] < relative[2]
