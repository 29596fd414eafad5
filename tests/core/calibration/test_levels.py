"""Levels of networks against closed forms: independent data, paired data, a stored posterior."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from core.answers import Stacked
from core.calibration.levels import Levels, calibrate, paired
from core.calibration.online import update
from core.calibration.state import RotorSpec, RotorState, blade_posterior, shared_posterior
from core.calibration.stored import StoredPosterior
from core.errors import InputError, ModelError, RangeError
from core.model import Model
from core.network import Network, Parameter, Quantity
from core.observation import Inspection
from core.prediction import predict
from core.prior import Prior
from core.surrogate.formula import FormulaInput, FormulaModel

NOISE = Prior("log_uniform", 0.01, 1.0)
PRIORS = {
    "theta": Prior.gaussian(1.5, 0.8),
    "s": Prior.gaussian(-0.6, 0.5),
    "grain": Prior.gaussian(0.4, 0.3),
    "offset": Prior.gaussian(0.2, 0.4),
    "coat": Prior.gaussian(1.0, 0.5),
    "slack": Prior.gaussian(-0.3, 0.4),
    "skew": Prior.gaussian(0.5, 0.3),
}
SHARED = ("theta", "s")
Formula = Callable[[dict[str, np.ndarray], float], np.ndarray]


def coupon(x: dict[str, np.ndarray], t: float) -> np.ndarray:
    return (1.0 + t) * x["theta"] + 0.5 * x["grain"]


def bar(x: dict[str, np.ndarray], t: float) -> np.ndarray:
    return 0.6 * x["theta"] - 0.8 * x["s"] + t * x["offset"]


def blade(x: dict[str, np.ndarray], t: float) -> np.ndarray:
    return (
        0.7 * x["theta"] + (1.2 - t) * x["s"] + x["coat"] + 0.8 * t * x["slack"] + t * t * x["skew"]
    )


USES: dict[str, tuple[Formula, tuple[str, ...]]] = {
    "strain": (coupon, ("theta", "grain")),
    "shift": (bar, ("theta", "s", "offset")),
    "length": (blade, ("s", "coat", "theta", "slack", "skew")),
}


def part(quantity: str) -> FormulaModel:
    formula, names = USES[quantity]
    inputs = tuple(FormulaInput(n, PRIORS[n].low, PRIORS[n].high) for n in names)

    def of_columns(x: np.ndarray, t: float) -> np.ndarray:
        return formula(dict(zip(names, x.T, strict=True)), t)

    return FormulaModel(inputs, {quantity: of_columns}, quantity)


def stacked(levels: dict[str, int]) -> Model:
    parts = tuple((part(q), (q,)) for q in levels)
    names = dict.fromkeys(n for q in levels for n in USES[q][1])
    parameters = tuple(Parameter(n, "shared" if n in SHARED else "local", PRIORS[n]) for n in names)
    quantities = tuple(
        Quantity(q, "1", "scalar", NOISE, -50.0, 50.0, level=level) for q, level in levels.items()
    )
    return Model(Network("stack", parameters, quantities), Stacked(parts))


def data(seed: int = 4) -> list[Inspection]:
    """Off-centre readings: three coupons, two bars, three blades. With a smaller noise than this
    one coupon contradicts the model, and is `bounded`: no closed form has that."""
    rng = np.random.default_rng(seed)
    what = {"strain": (("c0", "c1", "c2"), 2.9), "shift": (("a0", "a1"), 2.2)}
    what["length"] = (("b0", "b1", "b2"), 1.9)
    return [
        Inspection(f"{b}-{t}", b, q, t, np.array([y + 0.4 * rng.normal()]), sigma=0.21)
        for q, (blades, y) in what.items()
        for b in blades
        for t in (0.0, 0.7)
    ]


SPEC = RotorSpec("r", ("c0", "c1", "c2", "a0", "a1", "b0", "b1", "b2"), particles=6400, seed=2)


def exact(readings: Sequence[Inspection]) -> tuple[dict[tuple[str, str], int], np.ndarray, ...]:
    """The joint Gaussian of every parameter: places, mean, covariance and log evidence."""
    place: dict[tuple[str, str], int] = {("", n): i for i, n in enumerate(SHARED)}
    for b in SPEC.blades:
        for n in PRIORS:
            if n not in SHARED:
                place[b, n] = len(place)
    mean = np.array([PRIORS[n].mean for _, n in place])
    cov = np.diag([PRIORS[n].sd ** 2 for _, n in place])
    design = np.zeros((len(readings), len(place)))
    for i, r in enumerate(readings):
        formula, names = USES[r.quantity]
        for n in names:
            one = {m: np.array([float(m == n)]) for m in names}
            design[i, place["" if n in SHARED else r.blade, n]] = formula(one, r.time_h)[0]
    y = np.array([r.values[0] for r in readings])
    spread = design @ cov @ design.T + np.diag([r.sigma**2 for r in readings])
    gain, miss = cov @ design.T @ np.linalg.inv(spread), y - design @ mean
    evidence = -0.5 * (
        miss @ np.linalg.solve(spread, miss) + np.linalg.slogdet(2 * np.pi * spread)[1]
    )
    return place, mean + gain @ miss, cov - gain @ design @ cov, evidence


def shared_moments(state: RotorState) -> tuple[np.ndarray, np.ndarray]:
    posterior = shared_posterior(state.meta, state.arrays.__getitem__)
    order = [posterior.names.index(n) for n in SHARED]
    return posterior.particles.mean[order], posterior.particles.covariance[np.ix_(order, order)]


def assert_shared(state: RotorState, readings: Sequence[Inspection], sd_off: float = 0.1) -> None:
    """Mean within `sd_off` standard deviations, sd within 8 %, correlation within 0.06."""
    _, mean, cov, _ = exact(readings)
    got, spread = shared_moments(state)
    sd, got_sd = np.sqrt(np.diag(cov)[:2]), np.sqrt(np.diag(spread))
    assert np.all(np.abs(got - mean[:2]) < sd_off * sd)
    assert got_sd == pytest.approx(sd, rel=0.08)
    corr = cov[0, 1] / sd[0] / sd[1]
    assert spread[0, 1] / got_sd[0] / got_sd[1] == pytest.approx(corr, abs=0.06)


THREE = stacked({"strain": 1, "shift": 2, "length": 3})


def up_to(level: int, of: Model = THREE) -> list[Inspection]:
    return [r for r in data() if of.network.quantity(r.quantity).level <= level]


@pytest.fixture(scope="module")
def levels() -> Levels:
    return calibrate(THREE, SPEC, data())


def test_every_level_has_its_exact_posterior_and_evidence(levels: Levels) -> None:
    for level, state in levels.states.items():
        assert state.sealed
        assert_shared(state, up_to(level))
        assert state.meta["log_evidence"] == pytest.approx(exact(up_to(level))[3], abs=0.06)


def test_correlations_between_levels_are_large_enough_to_matter() -> None:
    cov = exact(data())[2]
    assert abs(cov[0, 1]) > 0.2 * np.sqrt(cov[0, 0] * cov[1, 1])


def test_local_parameters_are_exact_and_untouched_ones_keep_their_prior(levels: Levels) -> None:
    place, mean, cov, _ = exact(data())
    get = levels.last.arrays.__getitem__
    for component in ("c1", "a0", "b2"):
        posterior = blade_posterior(levels.last.meta, get, component)
        for name in (n for n in PRIORS if n not in SHARED):
            j, i = place[component, name], posterior.names.index(name)
            sd = np.sqrt(cov[j, j])
            error = 4 * sd / np.sqrt(posterior.particles.ess) + 0.06 * sd
            assert abs(posterior.particles.mean[i] - mean[j]) < error
            got = np.sqrt(posterior.particles.covariance[i, i])
            assert got == pytest.approx(sd, rel=0.08)


def test_a_component_is_predicted_by_its_own_model(levels: Levels) -> None:
    place, mean, cov, _ = exact(data())
    row = np.zeros(len(mean))
    row[place["", "theta"]], row[place["c1", "grain"]] = 3.0, 0.5
    posterior = blade_posterior(levels.last.meta, levels.last.arrays.__getitem__, "c1")
    got = predict(THREE, posterior, "strain", [2.0], noise=False)
    sd = np.sqrt(row @ cov @ row)
    assert got.mean[0] == pytest.approx(row @ mean, abs=0.12 * sd)
    assert got.sd["parameters"][0] == pytest.approx(sd, rel=0.08)


def test_the_order_of_levels_does_not_matter(levels: Levels) -> None:
    """The joint is the joint: levels turned round end at the same posterior."""
    turned = stacked({"strain": 3, "shift": 2, "length": 1})
    other = calibrate(turned, SPEC, data())
    assert_shared(other.states[1], up_to(1, turned))
    assert_shared(other.last, data())
    shuffled = [data()[i] for i in np.random.default_rng(1).permutation(len(data()))]
    again = calibrate(THREE, SPEC, shuffled)
    assert {k: s.digest for k, s in again.states.items()} == {
        k: s.digest for k, s in levels.states.items()
    }


def test_changes_tell_what_each_level_taught(levels: Levels) -> None:
    before = (
        np.array([PRIORS[n].mean for n in SHARED]),
        np.diag([PRIORS[n].sd ** 2 for n in SHARED]),
    )
    for level in (1, 2, 3):
        _, mean, cov, _ = exact(up_to(level))
        for i, name in enumerate(SHARED):
            change = next(c for c in levels.changes if (c.parameter, c.level) == (name, level))
            sd, old = np.sqrt(cov[i, i]), np.sqrt(before[1][i, i])
            kl = 0.5 * (((mean[i] - before[0][i]) / old) ** 2 + (sd / old) ** 2 - 1)
            assert change.contraction == pytest.approx(1 - (sd / old) ** 2, abs=0.08)
            assert change.kl == pytest.approx(kl - np.log(sd / old), abs=0.1)
        before = mean, cov


def test_a_stored_posterior_is_as_good_as_the_readings_within_its_error(levels: Levels) -> None:
    """Level 3 on the stored state of level 2 alone: 0.1 sd, 8 %, evidence 0.1 nat."""
    lower = stacked({"strain": 1, "shift": 1})
    upper = stacked({"length": 1})
    below = update(lower, SPEC, up_to(2))
    prior = StoredPosterior.of(lower, below)
    assert prior.error_nat < 0.01
    top = [r for r in data() if r.quantity == "length"]
    state = update(upper, SPEC, top, prior=prior)
    assert_shared(state, data())
    gained = exact(data())[3] - exact(up_to(2))[3]
    assert state.meta["log_evidence"] == pytest.approx(gained, abs=0.1)
    assert state.meta["prior"]["source"] == below.digest
    assert state.digest == update(upper, SPEC, top[::-1], prior=prior).digest
    alone = update(upper, SPEC, top)
    with pytest.raises(AssertionError):
        assert_shared(alone, data())


def test_one_stored_parameter_carries_its_marginal() -> None:
    """theta alone is passed on; s starts again from its own prior."""
    lower, upper = stacked({"strain": 1, "shift": 1}), stacked({"length": 1})
    below = update(lower, SPEC, up_to(2))
    prior = StoredPosterior.of(lower, below, ["theta"])
    _, mean, cov, _ = exact(up_to(2))
    low, high = PRIORS["theta"].box
    u = np.linspace(0, 1, 401)[:, None]
    density = np.exp(prior.log_density(u))
    theta = low + u[:, 0] * (high - low)
    mass = density.mean()
    assert mass == pytest.approx(1, abs=0.02)
    assert np.mean(density * theta) / mass == pytest.approx(mean[0], abs=0.03 * np.sqrt(cov[0, 0]))
    state = update(upper, SPEC, [r for r in data() if r.quantity == "length"], prior=prior)
    assert state.meta["prior"]["names"] == ["theta"]


def test_the_same_readings_are_never_counted_twice() -> None:
    """Refused by component and by reading; forced through, the answer is far too sharp."""
    lower = stacked({"strain": 1, "shift": 1})
    readings = up_to(2)
    prior = StoredPosterior.of(lower, update(lower, SPEC, readings))
    with pytest.raises(InputError, match="component = 'a0'"):
        update(lower, SPEC, readings, prior=prior)
    late = Inspection("new", "c1", "strain", 1.0, np.array([3.0]), sigma=0.15)
    with pytest.raises(InputError, match="component = 'c1'"):
        update(lower, SPEC, [late], prior=prior)
    with pytest.raises(InputError, match="rests on already"):
        update(lower, replace(SPEC, id="other"), readings, prior=prior)
    twice = update(lower, SPEC, readings, prior=replace(prior, seen={}))
    with pytest.raises(AssertionError):
        assert_shared(twice, readings)


def test_a_chain_of_stored_posteriors_remembers_every_reading() -> None:
    low, middle, top = (stacked({q: 1}) for q in USES)
    first = StoredPosterior.of(low, update(low, SPEC, up_to(1)))
    shifts = [r for r in data() if r.quantity == "shift"]
    second = StoredPosterior.of(middle, update(middle, SPEC, shifts, prior=first))
    assert set(second.seen["r"]) == {"c0", "c1", "c2", "a0", "a1"}
    state = update(top, SPEC, [r for r in data() if r.quantity == "length"], prior=second)
    assert_shared(state, data())


def skewed_rows() -> tuple[Model, list[Inspection], list[Inspection]]:
    """Coupons of unknown noise whose posterior leans on a bound, and blades above them."""
    theta = Parameter("theta", "shared", Prior("uniform", 0.0, 1.0))
    extra = Parameter("extra", "local", Prior("uniform", 0.0, 0.5))
    inputs = (FormulaInput("theta", 0.0, 1.0), FormulaInput("extra", 0.0, 0.5))
    formulas = {
        q: (lambda x, t, k=k: np.exp(k * x[:, 0]) + x[:, 1]) for q, k in (("low", 0.8), ("up", 1.2))
    }
    quantities = tuple(
        Quantity(q, "1", "scalar", NOISE, -50.0, 50.0, level=level)
        for q, level in (("low", 1), ("up", 2))
    )
    model = Model(
        Network("skew", (theta, extra), quantities), FormulaModel(inputs, formulas, "skew")
    )
    rng = np.random.default_rng(3)

    def read(blade: str, q: str, value: float) -> list[Inspection]:
        return [
            Inspection(f"{blade}{i}", blade, q, float(i), np.array([value + 0.2 * rng.normal()]))
            for i in range(2)
        ]

    lower = [r for i in range(3) for r in read(f"c{i}", "low", 1.25)]
    return model, lower, [r for i in range(2) for r in read(f"b{i}", "up", 1.5)]


def test_a_skewed_posterior_on_a_bound_is_passed_on_with_its_noise() -> None:
    """Exact composition is the reference: the stored route agrees within 0.01 sd and 1 %."""
    model, lower, upper = skewed_rows()
    both = calibrate(model, SPEC, [*lower, *upper])
    prior = StoredPosterior.of(model, both.states[1])
    assert 1e-4 < prior.error_nat < 0.01
    state = update(model, SPEC, upper, prior=prior)
    for name in ("theta", "sigma_obs.low", "sigma_obs.up"):
        got, want = (shared_posterior(s.meta, s.arrays.__getitem__) for s in (state, both.last))
        i, j = got.names.index(name), want.names.index(name)
        sd = np.sqrt(want.particles.covariance[j, j])
        assert abs(got.particles.mean[i] - want.particles.mean[j]) < 0.01 * sd
        assert np.sqrt(got.particles.covariance[i, i]) == pytest.approx(sd, rel=0.01)
    gained = both.last.meta["log_evidence"] - both.states[1].meta["log_evidence"]
    assert state.meta["log_evidence"] == pytest.approx(gained, abs=0.01)


def second_model(level: str) -> Model:
    """y = 0.9 w + 0.5 x + t l, where x was measured below: known, or a local parameter."""
    x_prior = Prior("normal", -10.0, 10.0, 1.0, 1.5)
    parameters = (
        Parameter("w", "shared", Prior.gaussian(0.3, 0.7)),
        Parameter("x", level, x_prior),
        Parameter("l", "local", Prior.gaussian(0.2, 0.5)),
    )

    def growth(v: np.ndarray, t: float) -> np.ndarray:
        return 0.9 * v[:, 0] + 0.5 * v[:, 1] + t * v[:, 2]

    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in parameters)
    growing = FormulaModel(inputs, {"growth": growth}, "growth")
    quantity = Quantity("growth", "1", "scalar", NOISE, -50.0, 50.0)
    if level == "known":
        return Model(Network("second", parameters, (quantity,)), growing)
    itself = FormulaModel((inputs[1],), {"strain": lambda v, t: v[:, 0]}, "itself")
    strain = Quantity("strain", "1", "scalar", NOISE, -50.0, 50.0)
    return Model(
        Network("second", parameters, (strain, quantity)),
        Stacked(((itself, ("strain",)), (growing, ("growth",)))),
    )


COUPONS = ("c0", "c1", "c2")


def paired_data() -> tuple[list[Inspection], list[Inspection]]:
    rng = np.random.default_rng(8)
    lower = [
        Inspection(f"{b}-x", b, "strain", 0.0, np.array([v]), sigma=0.4)
        for b, v in zip(COUPONS, (2.1, 3.4, 1.6), strict=True)
    ]
    upper = [
        Inspection(
            f"{r.blade}-{t}", r.blade, "growth", t, 1.2 + 0.5 * r.values + 0.2 * t, sigma=0.2
        )
        for r in lower
        for t in (0.0, 1.0)
    ]
    return lower, [replace(r, values=r.values + 0.2 * rng.normal()) for r in upper]


def exact_w(noisy: bool) -> tuple[float, float]:
    """w given the upper readings, x as read or with the uncertainty of its reading."""
    lower, upper = paired_data()
    mean, cov = [0.3], [0.49]
    for r in lower:
        gain = 1.5**2 / (1.5**2 + 0.16)
        mean += [1 + gain * (r.values[0] - 1) if noisy else r.values[0], 0.2]
        cov += [1.5**2 * (1 - gain) if noisy else 0.0, 0.25]
    design = np.zeros((len(upper), 7))
    for i, r in enumerate(upper):
        b = COUPONS.index(r.blade)
        design[i, [0, 1 + 2 * b, 2 + 2 * b]] = 0.9, 0.5, r.time_h
    c = np.diag(cov)
    spread = design @ c @ design.T + 0.04 * np.eye(len(upper))
    gain_w = (c @ design.T @ np.linalg.inv(spread))[0]
    miss = np.array([r.values[0] for r in upper]) - design @ mean
    return mean[0] + gain_w @ miss, float(np.sqrt(c[0, 0] - gain_w @ design @ c[:, 0]))


def test_paired_data_come_apart_into_two_exact_posteriors() -> None:
    first, second = stacked({"strain": 1}), second_model("known")
    lower, upper = paired_data()
    below, above = paired(first, second, SPEC, lower, upper, {"x": "strain"})
    assert below.digest == update(first, SPEC, lower).digest
    _, mean, cov, _ = exact(lower)
    posterior = shared_posterior(below.meta, below.arrays.__getitem__).particles
    assert abs(posterior.mean[0] - mean[0]) < 0.1 * np.sqrt(cov[0, 0])
    want, sd = exact_w(noisy=False)
    got = shared_posterior(above.meta, above.arrays.__getitem__).particles
    assert abs(got.mean[0] - want) < 0.1 * sd
    assert np.sqrt(got.covariance[0, 0]) == pytest.approx(sd, rel=0.08)
    wrong = [replace(r, values=r.values[::1] + 1.0) for r in lower]
    _, off = paired(first, second, SPEC, wrong, upper, {"x": "strain"})
    moved = shared_posterior(off.meta, off.arrays.__getitem__).particles.mean[0]
    assert abs(moved - want) > 3 * sd, "negative control: the pair enters the second model"


def test_a_paired_readings_noise_counts_where_the_input_is_local() -> None:
    lower, upper = paired_data()
    model = second_model("local")
    state = update(model, SPEC, [*lower, *upper])
    want, sd = exact_w(noisy=True)
    got = shared_posterior(state.meta, state.arrays.__getitem__).particles
    assert abs(got.mean[0] - want) < 0.1 * sd
    assert np.sqrt(got.covariance[0, 0]) == pytest.approx(sd, rel=0.08)
    assert sd > 1.1 * exact_w(noisy=False)[1]


def test_a_changed_pair_is_not_served_from_the_state_before() -> None:
    second = second_model("known")
    _, upper = paired_data()
    known = {b: {"x": 2.0} for b in COUPONS}
    spec = replace(SPEC, known=known)
    before = update(second, spec, upper)
    other = replace(SPEC, known=known | {"c1": {"x": 2.5}})
    alone = update(second, other, upper)
    assert update(second, other, upper, before).digest == alone.digest
    assert alone.meta["readings"]["c1"] != before.meta["readings"]["c1"]


def test_bad_levels_and_pairs_are_named() -> None:
    with pytest.raises(InputError, match="level without a quantity"):
        stacked({"strain": 1, "length": 3})
    with pytest.raises(InputError, match=r"'strain'.*two surrogates"):
        Stacked(((part("strain"), ("strain",)), (part("shift"), ("shift", "strain"))))
    with pytest.raises(InputError, match="answered by no surrogate"):
        Model(THREE.network, Stacked(((part("strain"), ("strain",)),)))
    apart = replace(part("strain"), inputs=(FormulaInput("theta", 90.0, 91.0),))
    with pytest.raises(InputError, match="input theta"):
        Stacked(((apart, ("strain",)), (part("shift"), ("shift",))))
    with pytest.raises(ModelError, match="not a parameter"):
        Model(stacked({"strain": 1}).network, part("shift"))
    first, second = stacked({"strain": 1}), second_model("known")
    lower, upper = paired_data()
    with pytest.raises(InputError, match="pair of component c1"):
        paired(first, second, SPEC, lower[::2], upper, {"x": "strain"})
    again = replace(lower[0], id="again")
    with pytest.raises(InputError, match="pair of component c0"):
        paired(first, second, SPEC, [*lower, again], upper, {"x": "strain"})
    with pytest.raises(InputError, match="no known input"):
        paired(first, second, SPEC, lower, upper, {"w": "strain"})
    with pytest.raises(InputError, match="calibrated by both"):
        paired(stacked({"shift": 1}), stacked({"length": 1}), SPEC, lower, upper, {})
    far = [replace(r, values=r.values + 20.0) for r in lower]
    with pytest.raises(RangeError, match="component c0"):
        paired(first, second, SPEC, far, upper, {"x": "strain"})
    state = update(first, SPEC, lower)
    with pytest.raises(InputError, match="not in the state"):
        StoredPosterior.of(first, state, ["alpha"])
    with pytest.raises(InputError, match="did not make"):
        StoredPosterior.of(second, state)
    missed = {**state.meta["health"], "met_floor": False, "reasons": ["3 of 64 nodes carry it"]}
    with pytest.raises(InputError, match="3 of 64 nodes"):
        StoredPosterior.of(first, RotorState({**state.meta, "health": missed}, state.arrays))
    narrow = replace(
        first.network.parameters[0], prior=replace(PRIORS["theta"], high=PRIORS["theta"].high - 1)
    )
    network = replace(first.network, parameters=(narrow, *first.network.parameters[1:]))
    prior = StoredPosterior.of(first, state, ["theta"])
    with pytest.raises(InputError, match="bounds of theta"):
        update(Model(network, first.surrogate), replace(SPEC, id="q"), [], prior=prior)


def mixed() -> list[Inspection]:
    """One component with readings of two quantities: four local parameters."""
    both = [replace(r, blade="b0") for r in data() if r.quantity == "strain"]
    return [*both, *(r for r in data() if r.quantity == "length")]


def test_a_component_of_more_than_three_local_parameters_has_its_exact_posterior() -> None:
    readings = mixed()
    state = update(stacked({"strain": 1, "length": 2}), SPEC, readings)
    assert_shared(state, readings)
    assert state.meta["log_evidence"] == pytest.approx(exact(readings)[3], abs=0.05)


def test_a_component_may_not_mix_too_many_local_parameters(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("core.model.MOST_LOCAL", 3)
    with pytest.raises(InputError, match="component b0"):
        update(stacked({"strain": 1, "length": 2}), SPEC, mixed())


def test_a_component_without_local_parameters_weighs_exactly() -> None:
    """Two coupons of one material: nothing local, evidence in closed form."""
    model = Model(
        Network(
            "material",
            (Parameter("theta", "shared", PRIORS["theta"]),),
            (Quantity("strain", "1", "scalar", NOISE, -50.0, 50.0),),
        ),
        FormulaModel(
            (FormulaInput("theta", PRIORS["theta"].low, PRIORS["theta"].high),),
            {"strain": lambda x, t: 2.0 * x[:, 0]},
            "material",
        ),
    )
    readings = [
        Inspection(b, b, "strain", 0.0, np.array([y]), sigma=0.3)
        for b, y in (("c0", 4.1), ("c1", 4.4))
    ]
    state = update(model, SPEC, readings)
    spread = 4 * 0.64 + np.diag([0.09, 0.09])
    miss = np.array([4.1, 4.4]) - 3.0
    evidence = -0.5 * (
        miss @ np.linalg.solve(spread, miss) + np.linalg.slogdet(2 * np.pi * spread)[1]
    )
    assert state.meta["log_evidence"] == pytest.approx(evidence, abs=0.03)
    assert state.arrays["blade/c0/local"].shape[2] == 0


def test_hours_of_a_reading_are_those_of_its_own_model() -> None:
    """Of two models stacked, the coupons' ends at 1 h and the blades' at 100,000."""
    long = stacked({"strain": 1, "shift": 2})
    parts = ((replace(part("strain"), horizon_h=1.0), ("strain",)), (part("shift"), ("shift",)))
    model = Model(long.network, Stacked(parts))
    spec = RotorSpec("r", ("c0", "a0"), particles=640, seed=2)
    late = Inspection("late", "a0", "shift", 5.0, np.array([2.0]), sigma=0.2)
    early = Inspection("early", "c0", "strain", 1.0, np.array([2.0]), sigma=0.2)
    assert update(model, spec, [early, late]).sealed
    beyond = replace(early, id="beyond", time_h=5.0)
    assert update(long, spec, [beyond, late]).sealed
    with pytest.raises(RangeError, match=r"reading beyond.*outside 0 … 1 h.*model of strain"):
        update(model, spec, [beyond, late])
