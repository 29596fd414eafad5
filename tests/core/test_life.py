"""The time to a limit is that of all particles."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from core.calibration.state import Posterior
from core.curves import SPAN, Curves, curves
from core.errors import InputError, RangeError
from core.life import Life, life
from core.model import Model, rotor_blade
from core.network import Network, Parameter, Quantity
from core.prediction import QUANTILES, predict
from core.prior import Prior
from core.smc.particles import Particles
from core.surrogate.formula import FormulaInput, FormulaModel

Array = NDArray[np.float64]
HORIZON = 50_000.0
HOURS = np.linspace(0.0, HORIZON, 40)


def growing(shrinks: bool = False) -> Model:
    """y = rate (t / 10,000 h)^0.8; with `shrinks`, back from the middle of the hours on."""

    def formula(x: Array, t: float) -> Array:
        return x[:, 0] * ((min(t, HORIZON - t) if shrinks else t) / 1e4) ** 0.8

    rate = Parameter("rate", "local", Prior("uniform", 0.0, 50.0))
    quantity = Quantity("y", "mm", "scalar", Prior("log_uniform", 1e-3, 1.0), -1.0, 1e3)
    quantity = replace(quantity, numerical=0.0)
    inputs = (FormulaInput("rate", 0.0, 50.0),)
    network = Network("growing", (rate,), (quantity,))
    return Model(network, FormulaModel(inputs, {"y": formula}, "growing", horizon_h=HORIZON))


def belief(rates: Array) -> Posterior:
    rates = np.asarray(rates, float)
    columns = np.stack([rates, np.full(len(rates), 0.01)], axis=1)
    return Posterior(("rate", "sigma_obs.y"), Particles(columns, np.zeros(len(rates))))


def of(rates: Array, limit: float, model: Model | None = None) -> Life:
    return life(model or growing(), belief(rates), "y", limit, HOURS)


def assert_quantiles(found: Life, own: Array) -> None:
    """Those of the particles' own hours; none beyond the horizon."""
    for p, hour in found.quantiles.items():
        exact = float(np.quantile(own, p))
        if exact > HORIZON:
            assert hour is None
        else:
            assert hour == pytest.approx(exact, rel=3e-3)


def test_quantiles_are_those_of_the_particles_own_hours() -> None:
    """Each rate has its hour, (limit / rate)^1.25 · 10,000; a skewed belief of 3,000 rates."""
    rates = np.exp(0.5 * ndtri((np.arange(3000) + 0.5) / 3000))
    own = 1e4 * (1.5 / rates) ** 1.25
    found = of(rates, 1.5)
    assert_quantiles(found, own)
    assert found.quantiles[0.975] is None
    assert found.quantiles[0.84] is not None
    assert found.passed[-1] == pytest.approx(np.mean(own <= HORIZON), abs=1e-3)
    assert np.all(np.diff(found.passed) >= 0)
    assert (found.unit, found.limit, found.particles) == ("mm", 1.5, 3000)


def test_by_mean_and_sd_the_early_hours_would_be_wrong() -> None:
    """Negative control: what the page did once. The fast few drag the bell's tail to 0."""
    rates = np.exp(0.5 * ndtri((np.arange(3000) + 0.5) / 3000))
    y = rates[:, None] * (HOURS / 1e4) ** 0.8
    bell = ndtr((y.mean(axis=0) - 1.5) / np.maximum(y.std(axis=0), 1e-9))
    early = float(np.interp(0.05, bell, HOURS))
    exact = of(rates, 1.5).quantiles[0.05]
    assert exact is not None
    assert abs(early / exact - 1) > 0.08


def test_the_surrogate_s_error_counts_and_a_reading_s_noise_does_not() -> None:
    """The shipped model against its own curves, solved for the hour by bisection."""
    model, rng, n = rotor_blade(), np.random.default_rng(3), 200
    names = [*model.input_names, "sigma_obs.elongation"]
    low, high = model.surrogate.low, model.surrogate.high  # type: ignore[union-attr]
    psi = np.column_stack([rng.uniform(low, high, (n, len(low))), np.full(n, 0.05)])
    own = Posterior(tuple(names), Particles(psi, rng.normal(size=n)))
    instants = model.surrogate.time_h  # type: ignore[union-attr]
    found = life(model, own, "elongation", 0.2, instants)

    def share(hour: float) -> float:
        one = curves(model, own, "elongation", np.array([hour]))
        assert one.sd.min() > 0
        return float(own.particles.w @ ndtr((one.mean[:, 0] - 0.2) / one.width[:, 0]))

    told = {p: h for p, h in found.quantiles.items() if h is not None}
    assert len(told) > 4
    for p, hour in told.items():
        assert hour == pytest.approx(brentq(lambda t, p=p: share(t) - p, 1.0, HORIZON), abs=1.0)


def test_a_limit_far_off_is_never_passed_and_one_below_was_at_once() -> None:
    never, at_once = of(np.ones(50), 1e6), of(np.ones(50), -0.5)
    assert set(never.quantiles.values()) == {None}
    assert never.passed[-1] == 0.0
    assert set(at_once.quantiles.values()) == {0.0}
    assert at_once.passed[0] == pytest.approx(1.0)


@pytest.mark.parametrize("limit", [1e308, -1e308, 1e-320, -1e-320])
def test_a_limit_at_the_ends_of_all_numbers_is_a_limit(limit: float) -> None:
    """Many sds off is more than a number can be; a warning became the server's error."""
    model = rotor_blade()
    names = (*model.input_names, "sigma_obs.elongation")
    middle = 0.5 * (model.surrogate.low + model.surrogate.high)  # type: ignore[union-attr]
    own = Posterior(names, Particles(np.tile([*middle, 0.05], (9, 1)), np.zeros(9)))
    found = life(model, own, "elongation", limit, [0.0, HORIZON])
    assert found.passed[0] == (1.0 if limit < 0.0 else 0.0)
    assert found.passed[1] == (0.0 if limit > 1.0 else 1.0)


def test_what_was_passed_stays_passed_where_a_quantity_shrinks() -> None:
    found = of(np.ones(50), 1.0, growing(shrinks=True))
    assert found.quantiles[0.5] == pytest.approx(1e4, abs=1.0)
    assert found.passed[-1] == pytest.approx(1.0)


def peaking(hours: Array, limit: float) -> Life:
    """y = 1.2 exp(−((t − hour) / 5,000 h)²), each particle with an hour of its own [1,000 h]."""
    model = growing()
    formula = {"y": lambda x, t: 1.2 * np.exp(-(((t - 1e3 * x[:, 0]) / 5e3) ** 2))}
    inputs = (FormulaInput("rate", 0.0, 50.0),)
    surrogate = FormulaModel(inputs, formula, "peaking", horizon_h=HORIZON)
    return of(hours, limit, Model(model.network, surrogate))


def test_of_particles_that_peak_one_after_the_other_each_has_passed() -> None:
    """The share that is beyond the limit at one hour is never more than 0.15, and all pass it."""
    peaks = 10.0 + 30.0 * (np.arange(3000) + 0.5) / 3000
    found, own = peaking(peaks, 1.0), 1e3 * peaks - 5e3 * np.sqrt(np.log(1.2))
    assert_quantiles(found, own)
    assert found.quantiles[0.975] is not None
    assert found.passed[-1] == pytest.approx(1.0)
    assert found.passed == pytest.approx([np.mean(own <= t) for t in HOURS], abs=1e-3)
    assert set(peaking(peaks, 1.3).quantiles.values()) == {None}


def test_a_surrogate_that_is_off_is_off_the_same_way_at_all_hours(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """1.2 ± 0.1 for a while and 1 ± 0.1 else: 1.25 is passed then or never."""

    def told(model: Model, posterior: Posterior, quantity: str, at: Array, *_: object) -> Curves:
        mean = np.tile(np.where((at > 2e4) & (at < 3e4), 1.2, 1.0), (50, 1))
        return Curves(mean, mean, np.full(mean.shape, 0.1), np.zeros(mean.shape))

    monkeypatch.setattr("core.life.curves", told)
    found = of(np.ones(50), 1.25)
    assert found.passed[-1] == pytest.approx(ndtr(-0.5))
    assert found.passed[HOURS < 2e4] == pytest.approx(ndtr(-2.5))
    assert found.quantiles[0.05] == pytest.approx(2e4, abs=1.0)


def falling(rates: Array, limit: float) -> Life:
    """y = 30 − rate t / 10,000 h."""
    model = growing()
    formula = {"y": lambda x, t: 30.0 - x[:, 0] * t / 1e4}
    inputs = (FormulaInput("rate", 0.0, 50.0),)
    surrogate = FormulaModel(inputs, formula, "falling", horizon_h=HORIZON)
    return of(rates, limit, Model(model.network, surrogate))


def test_a_quantity_that_falls_passes_its_limit_from_above() -> None:
    rates = np.exp(0.5 * ndtri((np.arange(3000) + 0.5) / 3000))
    own = 1e4 * (30.0 - 27.0) / rates
    found = falling(rates, 27.0)
    assert_quantiles(found, own)
    assert found.quantiles[0.5] is not None
    assert found.passed[0] == 0.0
    assert set(falling(np.ones(50), 31.0).quantiles.values()) == {None}, "it never rises to it"


def test_one_that_begins_above_its_limit_and_does_not_fall_has_passed_it() -> None:
    model = growing()
    formula = {"y": lambda x, t: 2.0 + x[:, 0] * t / 1e4}
    surrogate = FormulaModel(
        (FormulaInput("rate", 0.0, 50.0),), formula, "begun", horizon_h=HORIZON
    )
    for rates in (np.ones(50), np.zeros(50)):
        found = of(rates, 1.5, Model(model.network, surrogate))
        assert set(found.quantiles.values()) == {0.0}


def about(start: float, slope: float, sd: float, limit: float) -> Life:
    """y = start + slope t / 10,000 h, where the start is normal over the particles."""
    model = growing()
    formula = {"y": lambda x, t: start + x[:, 0] - 25.0 + slope * t / 1e4}
    inputs = (FormulaInput("rate", 0.0, 50.0),)
    surrogate = FormulaModel(inputs, formula, "about", horizon_h=HORIZON)
    starts = 25.0 + sd * ndtri((np.arange(1000) + 0.5) / 1000)
    return of(starts, limit, Model(model.network, surrogate))


@pytest.mark.parametrize("slope", [5.0, -5.0, 0.0])
@pytest.mark.parametrize("off", [0.0, 1e-13, -1e-13])
def test_what_begins_at_its_limit_has_passed_it_at_hour_0(slope: float, off: float) -> None:
    """To rounding, which decided whether a quantity that falls had passed it, or never would."""
    found = about(30.0, slope, 0.0, 30.0 + off)
    assert found.passed[1:].tolist() == pytest.approx([1.0] * (len(HOURS) - 1)) or slope == 0.0
    if off == 0.0:
        assert found.passed[0] == 1.0
        assert set(found.quantiles.values()) == {0.0}
    if slope:
        hours = [*found.quantiles.values()]
        assert all(hour is not None and hour <= 0.1 for hour in hours)
        assert hours == sorted(hours)  # type: ignore[type-var]


@pytest.mark.parametrize("slope", [5.0, -5.0])
def test_what_begins_at_its_limit_on_average_passes_it_with_the_half_that_has_not(
    slope: float,
) -> None:
    """One that falls stayed at the half of hour 0 for ever, as if it had to rise to the limit."""
    found = about(30.0, slope, 1.0, 30.0 + 1e-10)
    assert found.passed[0] == pytest.approx(0.5, abs=1e-3)
    assert found.passed == pytest.approx(ndtr(5.0 * HOURS / 1e4), abs=2e-3)
    hour = found.quantiles[0.84]
    assert hour == pytest.approx(1e4 * float(ndtri(0.84)) / 5.0, rel=0.02)


def test_the_order_and_number_of_the_hours_do_not_matter() -> None:
    rates = np.exp(0.5 * ndtri((np.arange(777) + 0.5) / 777))
    one = of(rates, 1.5)
    other = life(growing(), belief(rates), "y", 1.5, [*HOURS[::-1], *HOURS[::7]])
    assert other.quantiles == one.quantiles
    finer = life(growing(), belief(rates), "y", 1.5, np.linspace(0.0, HORIZON, 997))
    assert [finer.quantiles[p] for p in QUANTILES[:5]] == pytest.approx(
        [one.quantiles[p] for p in QUANTILES[:5]], rel=1e-4
    )


@pytest.mark.parametrize("asked", [[24_000.0], [0.0, 3000.0], [30_000.0, 50_000.0]])
def test_the_hours_that_are_asked_for_bound_no_quantile(asked: list[float]) -> None:
    """Asked for one hour every quantile was that hour, or none, as if the model ended there."""
    rates = np.exp(0.5 * ndtri((np.arange(777) + 0.5) / 777))
    whole, found = of(rates, 1.5), life(growing(), belief(rates), "y", 1.5, asked)
    assert found.time_h.tolist() == asked
    for p, hour in whole.quantiles.items():
        assert found.quantiles[p] == (None if hour is None else pytest.approx(hour, rel=1e-4))
    own = 1e4 * (1.5 / rates) ** 1.25
    for t, passed in zip(asked, found.passed, strict=True):
        assert passed == pytest.approx(np.mean(own <= t), abs=2e-3)
    shrunk = life(growing(shrinks=True), belief(np.ones(50)), "y", 1.0, [45_000.0])
    assert shrunk.passed.tolist() == pytest.approx([1.0]), "it had passed it before"


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(InputError, match=r"limit = nan is no number"):
        of(np.ones(5), float("nan"))
    with pytest.raises(RangeError, match="60000"):
        life(growing(), belief(np.ones(5)), "y", 1.0, [0.0, 6e4])
    model = rotor_blade()
    own = Posterior(model.input_names, Particles(np.ones((5, len(model.input_names))), np.zeros(5)))
    with pytest.raises(InputError, match="choose x, y or z"):
        life(model, own, "deformation", 0.1, [1e4])


def test_many_hours_are_told_in_parts_that_say_the_same_and_hold_little() -> None:
    """A prediction of 1,000 hours holds what one of 128 holds, and says what they say."""
    rates = np.random.default_rng(3).uniform(1.0, 2.0, 400)
    model, own = growing(), belief(rates)
    many = np.linspace(1.0, HORIZON, 1000)
    few = many[350:450]

    def peak(hours: Array) -> float:
        tracemalloc.start()
        predict(model, own, "y", hours)
        held = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return held

    whole, part = predict(model, own, "y", many), predict(model, own, "y", few)
    np.testing.assert_allclose(whole.mean[350:450], part.mean, rtol=1e-12)
    np.testing.assert_allclose(whole.lower[350:450], part.lower, rtol=1e-12)
    for source, sd in whole.sd.items():
        assert sd.shape == (1000,)
        np.testing.assert_allclose(sd[350:450], part.sd[source], rtol=1e-9, atol=1e-15)
    assert all(q.shape == (1000,) for q in whole.quantiles.values())
    assert peak(many) < 2 * peak(many[:SPAN])
    assert len(life(model, own, "y", 2.0, many).passed) == 1000
