"""Simulated rotors have the variance that likelihood and prediction assume, part by part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.calibration.responses import DEGREE
from core.errors import InputError
from core.model import Model
from core.validation.fe_rotors import scan_nodes
from core.validation.simulate import numerical, scan, shipped_rotors, simulate, truths
from core.validation.variants import COATING, hours, model_of, names_of, plan


@pytest.fixture(scope="module")
def model() -> Model:
    return model_of(plan("rotor-20"))


def test_readings_have_noise_surrogate_error_and_numerical_error(model: Model) -> None:
    """Without the surrogate's part the residuals of quiet rotors are too large: it was drawn."""
    variant = plan("rotor-20")
    nu = model.network.quantity("elongation").numerical
    full, without, quiet = [], [], []
    for rotor in range(120):
        made = simulate(model, variant, rotor, seed=3)
        shared, x = truths(model, variant, rotor, seed=3)
        assert made.shared == shared
        sigma = shared["sigma_obs.elongation"]
        for t in variant.outages_h:
            response = model.surrogate.response("elongation", np.array([t]), degree=DEGREE)
            (mean, sd) = (values[:, 0] for values in response.evaluate(x))
            y = np.array([r.values[0] for r in made.readings if r.time_h == t])
            full.append((y - mean) ** 2 / (sigma**2 + sd**2 + (nu * mean) ** 2))
            without.append((y - mean) ** 2 / (sigma**2 + (nu * mean) ** 2))
            quiet.append(sigma < sd)
    assert np.mean(full) == pytest.approx(1, abs=4 * np.sqrt(2 / (120 * 60)))
    chosen = np.array(quiet)
    assert np.mean(np.array(full)[chosen]) == pytest.approx(1, abs=4 * np.sqrt(2 / chosen.sum()))
    assert np.mean(np.array(without)[chosen]) > 1.5


def test_held_out_readings_are_made_of_the_parts_that_a_prediction_names(model: Model) -> None:
    variant = plan("mixed", blades=60)
    for quantity, node in (("elongation", None), ("ceeq", [model.surrogate.named["critical"]])):
        declared = model.network.quantity(quantity)
        own, noise = [], []
        for rotor in range(8):
            made = simulate(model, variant, rotor, seed=4)
            of = [h for h in made.held if h.quantity == quantity and h.time_h == 32_000.0]
            truth = [{**made.shared, **made.local[h.blade]} for h in of]
            x = np.array([[values[name] for name in model.input_names] for values in truth])
            mean, sd = model.surrogate.predict(x, quantity, np.array([32_000.0]), node)
            value, reading = np.array([(h.value, h.reading) for h in of]).T
            assert mean.ravel() == pytest.approx([h.model for h in of])
            spread = np.hypot(sd.ravel(), declared.numerical * mean.ravel())
            own += [*((value - mean.ravel()) / spread)]
            noise += [*((reading - value) / made.shared[declared.sigma_name])]
        for found in (own, noise):
            assert np.mean(np.square(found)) == pytest.approx(1, abs=4 * np.sqrt(2 / len(found)))


def test_a_scan_has_the_covariance_of_its_likelihood(model: Model) -> None:
    """Components along the modes: surrogate and mesh; all others: white noise only."""
    nodes, x, sigma, time_h = scan_nodes(80), np.array([0.8, 0.93, 1.0, -1.0]), 0.004, 16_000.0
    rng = np.random.default_rng(1)
    shared = {"sigma_obs.deformation": sigma}
    y = np.array([scan(model, x, time_h, nodes, shared, rng).ravel() for _ in range(800)])
    q, r = np.linalg.qr(model.surrogate.deformation_modes(nodes.tolist()).reshape(240, -1))
    z, sd = model.surrogate.mode_response(time_h, r, degree=DEGREE).evaluate(x[None])
    along = (y @ q - z[0]).var(axis=0)
    nu = model.network.quantity("deformation").numerical
    expected = sd[0] ** 2 + nu**2 * (z[0] ** 2 + np.mean(z[0] ** 2)) + sigma**2
    np.testing.assert_allclose(along, expected, rtol=5 * np.sqrt(2 / 800))
    across = y - (y @ q) @ q.T
    assert across.var() * 240 / (240 - q.shape[1]) == pytest.approx(sigma**2, rel=0.01)


def test_a_declared_offset_moves_readings_and_scans() -> None:
    variant = plan("eight-shared", blades=40)
    model = model_of(variant)
    made = simulate(model, variant, 3, seed=1)
    assert len(made.shared) == 8
    x = {
        b: np.array([[{**made.shared, **v}[n] for n in model.input_names]])
        for b, v in made.local.items()
    }
    held = [h for h in made.held if h.quantity == "elongation" and h.time_h == 32_000.0]
    off = []
    for one in held:
        (mean,), (sd,) = model.surrogate.predict(x[one.blade], "elongation", np.array([one.time_h]))
        moved = one.value - mean[0] - made.shared["theta.elongation"]
        off.append(moved / np.hypot(sd[0], 0.003 * mean[0]))
    assert np.mean(np.square(off)) == pytest.approx(1, abs=4 * np.sqrt(2 / len(off)))
    reading = next(r for r in made.readings if r.quantity == "deformation")
    assert reading.nodes is not None
    clean = model.surrogate.predict(
        x["B001"], "deformation", np.array([reading.time_h]), reading.nodes.tolist()
    )[0][0, 0]
    theta = [made.shared[f"theta.deformation.{axis}"] for axis in "xyz"]
    error = np.abs(clean).max() * 0.01 + made.shared["sigma_obs.deformation"]
    assert (reading.values - clean).mean(axis=0) == pytest.approx(theta, abs=error)


def test_the_noise_of_a_study_depends_on_variant_seed_and_rotor_alone(model: Model) -> None:
    variant = plan("rotor-20")
    one, two = (simulate(model, variant, 5, seed=1) for _ in range(2))
    assert [r.digest() for r in one.readings] == [r.digest() for r in two.readings]
    for other in (simulate(model, variant, 6, 1), simulate(model, variant, 5, 2)):
        assert one.shared != other.shared


def test_a_mixed_rotor_is_table_one(model: Model) -> None:
    """Elongation of every blade there is, three scans, three CEEQ, three new blades."""
    variant = plan("mixed")
    made = simulate(model, variant, 0, seed=1)
    count = {q: sum(r.quantity == q for r in made.readings) for q in ("deformation", "ceeq")}
    assert count == {"deformation": 3, "ceeq": 3}
    assert len(made.readings) - 6 == 300
    assert {len(hours(variant, t)) for t in variant.outages_h} == {100}
    held = {h.blade: h.time_h for h in made.held if h.quantity == "elongation"}
    assert held["B098-2"] == 24_000.0
    assert "B098" not in held
    assert len(names_of(variant)) == 103
    assert len({r.id for r in made.readings}) == len(made.readings)


def test_coatings_at_the_bounds_and_in_a_narrow_prior() -> None:
    fixed = plan("coating-at-bounds", blades=6)
    made = simulate(model_of(fixed), fixed, 0, seed=1)
    assert [v[COATING] for v in made.local.values()] == [2 / 3, 4 / 3] * 3
    thin = plan("thin-coating", blades=50)
    narrow = model_of(thin)
    values = [v[COATING] for v in simulate(narrow, thin, 0, seed=1).local.values()]
    assert 2 / 3 < min(values) < 0.675 < 0.725 < max(values) < 2 / 3 + 2 / 30
    assert narrow.digest != model_of(fixed).digest


def test_rotors_of_finite_elements_share_a_truth_and_differ_in_noise() -> None:
    variant = plan("fe-mixed")
    model = model_of(variant)
    first = simulate(model, variant, 0, seed=1)
    again = next(
        m
        for m in (simulate(model, variant, r, seed=1) for r in range(1, 25))
        if m.cluster == first.cluster
    )
    assert first.local == again.local
    assert first.shared["t1t_rate"] == again.shared["t1t_rate"]
    assert first.shared["sigma_obs.elongation"] != again.shared["sigma_obs.elongation"]
    assert [h.value for h in first.held] == [h.value for h in again.held]
    assert np.isnan(first.held[0].model)


@pytest.mark.parametrize(("name", "blades"), [("nothing", None), ("mixed", 3), ("fe", 21)])
def test_a_plan_that_cannot_be_is_refused(name: str, blades: int | None) -> None:
    with pytest.raises(InputError, match=r"use one of|give"):
        plan(name, blades)


def test_a_plan_keeps_its_name_at_another_size() -> None:
    assert plan("six-outages", 20) == replace(plan("six-outages"), blades=20)


def test_finite_elements_get_the_numerical_error_that_is_declared() -> None:
    """And nothing else: divided by it, what is left is the run. Scans get it by modes."""
    variant = plan("fe-nu-mixed")
    model = model_of(variant)
    bare, runs = plan("fe-mixed"), 60
    nu = model.network.quantity("elongation").numerical
    found = []
    for rotor in range(runs):
        with_it, without = (simulate(model, v, rotor, seed=1) for v in (variant, bare))
        assert with_it.local == without.local
        found += [
            a.value / b.value - 1
            for a, b in zip(with_it.held, without.held, strict=True)
            if a.quantity == "elongation"
        ]
    assert np.std(found) == pytest.approx(nu, rel=0.08)
    assert abs(np.mean(found)) < 4 * nu / np.sqrt(len(found))
    shape = shipped_rotors().deformation[0, 0]
    nodes, rng = shipped_rotors().scan_nodes, np.random.default_rng(0)
    errors = np.array([numerical(model, shape, nodes, rng) for _ in range(200)])
    share = np.sqrt(np.sum(errors**2, axis=(1, 2)).mean() / np.sum(shape**2))
    modes = model.part("deformation").deformation_modes(nodes.tolist()).shape[-1]
    declared = model.network.quantity("deformation").numerical
    assert declared < share < 2 * declared * np.sqrt(modes)
