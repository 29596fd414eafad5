"""Held-out readings are predicted with their own noise, and pictures tell what the particles do."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from core.calibration.online import update
from core.calibration.state import RotorSpec, blade_posterior
from core.course import Course
from core.diagnosis import report
from core.diagnosis.densities import density, leans, quantiles
from core.diagnosis.report import before_after, concerned, fleet, held_out, parted, score
from core.drift import Bias
from core.model import Model
from core.network import Discrepancy, Parameter
from core.observation import Inspection
from core.prediction import predict
from core.prior import Prior
from tests.core.calibration.drifting import drifting
from tests.core.calibration.test_discrepancy import by_two_instruments
from tests.core.calibration.test_exact import SLOPES, conjugate, exact, readings

MODEL = conjugate(2)


def test_a_reading_that_tells_its_noise_is_scored_with_it() -> None:
    """Off-centre by two sds of the exact prediction, of a reading of 0.05."""
    data = readings(3, [0.0, 0.6], seed=9, sigma=0.2)
    state = update(MODEL, RotorSpec("r", ("b0", "b1", "b2"), particles=12800, seed=1), data)
    mean, cov, _ = exact(MODEL, data, 3, 2)
    row = np.zeros(7)
    row[0], row[3], row[4] = 0.8, SLOPES[0], SLOPES[1] * 2.0
    at, own = float(row @ mean), float(np.sqrt(row @ cov @ row))
    sd = np.hypot(own, 0.05)
    held = Inspection("h", "b1", "y", 2.0, np.array([at + 2 * sd]), sigma=0.05)
    got = score(MODEL, state, [held])
    assert got.z[0] == pytest.approx(2.0, abs=0.2)
    assert got.log_score == pytest.approx(norm.logpdf(2.0) - np.log(sd), abs=0.4)
    assert got.width == pytest.approx(2 * 1.96 * sd, rel=0.08)
    untold = Inspection("h", "b1", "y", 2.0, held.values)
    assert score(MODEL, state, [untold]).width > 1.05 * got.width, "the prior's noise is larger"


def test_a_reading_is_scored_with_the_noise_of_whoever_took_it() -> None:
    """One that names no instrument had the noise of the instrument that is known best."""
    model = drifting(Discrepancy(), by_instrument=True)
    data = by_two_instruments(0.01, 0.15)
    data = [replace(r, instrument=None) if r.instrument == "sharp" else r for r in data]
    spec = RotorSpec("r", tuple(sorted({r.blade for r in data})), particles=1600, seed=1)
    state = update(model, spec, data)
    posterior = blade_posterior(state.meta, state.arrays.__getitem__, "b0")
    blade = predict(model, posterior, "y", [2.0], noise=False)
    w = posterior.particles.w
    for by, name in (("blunt", "sigma_obs.y@blunt"), (None, "sigma_obs.y")):
        noise = np.sqrt(w @ posterior.column(name) ** 2)
        y = blade.mean + 2.0 * np.hypot(blade.sd["total"], noise)
        held = Inspection("h", "b0", "y", 2.0, y, instrument=by)
        assert score(model, state, [held]).z[0] == pytest.approx(2.0, rel=1e-6)
        assert predict(model, posterior, "y", [2.0], reader=(by, None)).instrument == by


def test_a_known_noise_is_the_blades_own_band_and_that_noise() -> None:
    data = readings(2, [0.0, 0.6], seed=3, sigma=0.2)
    state = update(MODEL, RotorSpec("r", ("b0", "b1"), particles=1600, seed=1), data)
    posterior = blade_posterior(state.meta, state.arrays.__getitem__, "b0")
    blade = predict(MODEL, posterior, "y", [1.0], noise=False)
    reading = predict(MODEL, posterior, "y", [1.0], sigma=0.3)
    assert reading.sd["total"][0] == pytest.approx(np.hypot(blade.sd["total"][0], 0.3), rel=1e-12)
    still = predict(MODEL, posterior, "y", [1.0], noise=False, sigma=0.3)
    assert still.sd["total"][0] == blade.sd["total"][0]


def test_a_density_integrates_to_one_and_is_the_normal_that_was_drawn() -> None:
    rng = np.random.default_rng(1)
    a, w = rng.normal(0.3, 0.1, 4000), np.full(4000, 1 / 4000)
    x = np.linspace(-0.2, 0.8, 401)
    got = density(a, w, x, -5.0, 5.0)
    assert np.trapezoid(got, x) == pytest.approx(1.0, abs=1e-3)
    assert got.max() == pytest.approx(norm.pdf(0.0) / 0.1, rel=0.08)
    cut = a[a > 0.3]
    x = np.linspace(0.3, 0.8, 401)
    got = density(cut, np.full(len(cut), 1 / len(cut)), x, 0.3, 5.0)
    assert np.trapezoid(got, x) == pytest.approx(1.0, abs=0.01), "nothing leaks over the bound"
    assert quantiles(a, w, [0.5])[0] == pytest.approx(0.3, abs=0.01)


@pytest.mark.parametrize(
    ("middle", "sd", "said"),
    [(0.0, 0.1, "low"), (1.0, 0.1, "high"), (0.5, 0.1, None), (0.04, 0.002, None)],
)
def test_a_posterior_leans_on_a_bound_only_where_it_would_go_on(
    middle: float, sd: float, said: str | None
) -> None:
    """The last one lies near the bound and is 20 sds away; and the prior itself leans nowhere."""
    prior = Prior("uniform", 0.0, 1.0)
    drawn = middle + sd * np.random.default_rng(2).normal(size=4000)
    a = drawn[(drawn >= 0) & (drawn <= 1)]
    assert leans(prior, a, np.full(len(a), 1 / len(a))) == said
    flat = np.linspace(0.0, 1.0, 1001)
    assert leans(prior, flat, np.full(1001, 1 / 1001)) is None


def test_held_out_is_all_that_was_read_at_a_blades_latest_hours() -> None:
    """Two instruments at each of four hours; of one blade three readings, all at one hour."""
    data = [
        Inspection(f"{b}-{t}-{g}", b, "y", t, np.array([1.0]), instrument=g)
        for b in ("b0", "b1")
        for t in (1.0, 2.0, 3.0, 4.0)
        for g in ("g1", "g2")
    ]
    data += [Inspection(f"once-{k}", "b01", "y", 2.0, np.array([1.0])) for k in range(3)]
    assert [r.id for r in held_out(data, "y")] == ["b1-4.0-g1", "b1-4.0-g2"]
    scan = Inspection("scan", "b1", "y", 4.0, np.ones(3), nodes=np.arange(3))
    assert "scan" not in {r.id for r in held_out([*data, scan], "y")}, "its first node is not it"
    late = replace(scan, id="late", time_h=9.0)
    held, kept = parted([*data, scan, late], "y")
    assert not {"scan", "late"} & {r.id for r in (*held, *kept)}, "nor is it known"


def test_lots_that_alternate_leave_readings_of_the_blades_concerned() -> None:
    """The lot with the effect was every other blade, and both models were held against blades that
    it does not concern: the report warned of the better one."""
    data = readings(4, [0.0, 0.6, 1.2], seed=9, sigma=0.2)
    assert {r.blade for r in held_out(data, "y", {"b0", "b2"})} == {"b0", "b2"}
    for blades in ({"b1", "b3"}, {"b0", "b1"}, set()):
        assert {r.blade for r in held_out(data, "y", blades)} == {"b1", "b3"}
    gone = Bias("slip", "y", Course.of(1.0), blades=("b0", "b2"))
    slip = Parameter("slip", "shared", Prior("normal", -1.0, 1.0, 0.0, 0.1))
    own = replace(MODEL.network, parameters=(*MODEL.network.parameters, slip), biases=(gone,))
    both = (MODEL, Model.of(own, MODEL.surrogate))
    assert concerned(both, ("b0", "b1", "b2", "b3")) == {"b0", "b2"}
    assert concerned((MODEL, MODEL), ("b0", "b1")) == set()


def test_nothing_that_a_held_out_blade_was_read_later_is_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of no other quantity either: a scan of the same hour tells what the reading will be."""
    data = readings(4, [0.0, 0.6, 1.2], seed=9, sigma=0.2)
    held = held_out(data, "y")
    latest = max(r.time_h for r in held)
    beside = [replace(held[0], id="other", quantity="z"), replace(held[0], id="early", time_h=0.1)]
    known: list[set[str]] = []

    def seen(model: Any, spec: Any, kept: Any, **given: Any) -> Any:
        known.append({r.id for r in kept})
        return update(model, spec, [r for r in kept if r.quantity == "y"])

    monkeypatch.setattr(report, "update", seen)
    spec = RotorSpec("r", tuple(f"b{b}" for b in range(4)), particles=400, seed=1)
    told = before_after((MODEL, MODEL), spec, [*data, *beside], latest, "y")
    assert told.held == tuple(r.id for r in held)
    for ids in known:
        assert not ids & {*told.held, "other"}
        assert "early" in ids, "negative control: what came before is"


def test_the_fleets_forecast_is_of_the_blades_that_are_named() -> None:
    data = readings(3, [0.0, 0.6], seed=9, sigma=0.2)
    spec = RotorSpec("r", ("b0", "b1", "b2"), particles=400, seed=1)
    state = update(MODEL, spec, data)
    each = [fleet(MODEL, state, spec, "y", 1.0, (b,))[0] for b in spec.blades]
    assert fleet(MODEL, state, spec, "y", 1.0)[0] == pytest.approx(np.mean(each))
    assert fleet(MODEL, state, spec, "y", 1.0, ("b0", "b2"))[0] == pytest.approx(
        (each[0] + each[2]) / 2
    )
