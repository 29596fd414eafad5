"""A wide surrogate anchored at a fine one: its answers, its doubt, and finite elements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.blade import BOUNDS
from core.builtin import inspection_plan, rotor_blade, worn_plan
from core.builtin.paper_network import rotor_blade_network
from core.course import Course
from core.drift import Drift
from core.errors import InputError
from core.model import Model, rotor_blade_wide
from core.surrogate.anchor import Anchor
from core.surrogate.driven import Driven
from core.surrogate.kernel import Hyper, SharedGP
from core.surrogate.model import Surrogate

FINE, WIDE = rotor_blade.load(), rotor_blade.load_wide()
MODEL = rotor_blade_wide()
assert isinstance(MODEL.surrogate, Driven)
ANCHOR, FIXED = MODEL.surrogate.anchor, MODEL.surrogate.fixed
assert ANCHOR is not None
WEAR = Drift("wear", "tbc_thickness", Course.of([(0.0, 0.0), (5e4, -1.0)]), "times")
RANGES = {i.name: (i.low, i.high) for i in FINE.inputs} | {"wear": (0.0, 0.4)}
HOURS = np.array([8e3, 16e3, 24e3, 32e3, 40e3, 5e4])


def biased(surrogate: Surrogate, share: float = 0.03) -> Surrogate:
    """The mean run's elongation over CEEQ and its deformation over CEEQ too large by a share."""
    parts = dict(surrogate.parts)
    for name in ("elongation", "deformation"):
        core = parts[name].factors.core.copy()
        core[0] *= 1.0 + share
        parts[name] = replace(parts[name], factors=replace(parts[name].factors, core=core))
    return replace(surrogate, parts=parts, digest=surrogate.digest + " biased")


BIASED = biased(WIDE)


def driven(anchor: Anchor | None, wide: Surrogate = WIDE) -> Driven:
    return Driven(wide, (WEAR,), RANGES, FIXED, anchor)


def inputs_of(model: Driven, blades: list[int], wear: float) -> np.ndarray:
    truth = dict(zip(BOUNDS, inspection_plan.truth_inputs()[blades].T, strict=True))
    given = truth | {"wear": np.full(len(blades), wear)}
    return np.column_stack([given[i.name] for i in model.inputs])


def off(anchor: Anchor | None, worn: bool, wide: Surrogate = WIDE) -> tuple[np.ndarray, np.ndarray]:
    """Relative errors of the elongation of the worn lot's blades (n, T), and the stated ones."""
    plan, model = (worn_plan if worn else inspection_plan).load(), driven(anchor, wide)
    blades = list(worn_plan.WORN)
    truth = np.array([np.interp(HOURS, plan.time_h, plan.elongation[b]) for b in blades])
    x = inputs_of(model, blades, worn_plan.LOST if worn else 0.0)
    mean, sd = model.predict(x, "elongation", HOURS)
    return mean / truth - 1.0, sd / truth


@pytest.mark.parametrize(
    ("quantity", "nodes"),
    [("elongation", None), ("ceeq", [FINE.named["critical"]]), ("deformation", [17, 5440])],
)
def test_without_an_effect_the_answer_and_its_doubt_are_the_fine_ones(
    quantity: str, nodes: list[int] | None
) -> None:
    x = inputs_of(driven(None), [3, 40, 77], 0.0)
    times = np.array([0.0, 8e3, 5e4])
    fine, doubt = FINE.predict(x[:, :4], quantity, times, nodes)
    names = [i.name for i in MODEL.surrogate.inputs]
    assert names == [i.name for i in FINE.inputs]
    mean, sd = MODEL.surrogate.predict(x[:, :4], quantity, times, nodes)
    assert mean == pytest.approx(fine, rel=1e-9, abs=1e-12)
    assert sd == pytest.approx(doubt, rel=0.02, abs=1e-12)
    bare, _ = replace(MODEL.surrogate, anchor=None).predict(x[:, :4], quantity, times, nodes)
    assert np.max(np.abs(bare / np.where(fine == 0, 1, fine) - 1)[:, 1:]) > 0.002


def test_mixtures_of_modes_are_anchored_too() -> None:
    """What a scan is compared with: the wide one's modes at its nodes, mixed."""
    nodes, hour = list(range(0, 5600, 400)), 24e3
    modes = WIDE.deformation_modes(nodes).reshape(3 * len(nodes), -1)
    x = inputs_of(driven(None), [3, 40, 77], 0.0)[:, :4]
    mixing = np.linalg.lstsq(modes, np.eye(len(modes)), rcond=None)[0][:4] @ modes
    truth = FINE.predict(x, "deformation", [hour], nodes)[0].reshape(3, -1)
    wanted = truth @ np.linalg.lstsq(modes, np.eye(len(modes)), rcond=None)[0][:4].T

    def error(model: Driven) -> float:
        found = model.mode_response(hour, mixing).evaluate(x)[0]
        return float(np.sqrt(np.mean((found - wanted) ** 2) / np.mean(wanted**2)))

    wrong = replace(MODEL.surrogate, base=BIASED)  # type: ignore[type-var]
    assert error(MODEL.surrogate) < 0.005  # type: ignore[arg-type]
    assert error(wrong) < 0.008
    assert error(replace(wrong, anchor=None)) > 0.02


def test_against_finite_elements_of_sound_and_worn_blades() -> None:
    """24 blades, 8,000 to 50,000 h, on the fine mesh: rms errors, as large as said."""

    def rms(anchor: Anchor | None, worn: bool, wide: Surrogate = WIDE) -> float:
        return float(np.sqrt(np.mean(off(anchor, worn, wide)[0] ** 2)))

    assert rms(ANCHOR, worn=False) < 0.0035
    assert rms(ANCHOR, worn=True) < 0.006
    error, told = off(ANCHOR, worn=True)
    assert 0.5 < np.sqrt(np.mean((error / told) ** 2)) < 1.2
    for worn in (False, True):  # a wide surrogate that is off everywhere: the anchor mends that
        assert rms(ANCHOR, worn, BIASED) < 0.01
        assert rms(None, worn, BIASED) > 0.02


def test_the_doubt_grows_with_the_effect() -> None:
    x = inputs_of(driven(ANCHOR), [40], 0.0)
    x = np.repeat(x, 4, axis=0)
    x[:, -1] = [0.0, 0.1, 0.2, 0.4]
    mean, sd = driven(ANCHOR).predict(x, "elongation", HOURS)
    assert np.all(np.diff(sd / mean, axis=0)[1:] > 0)
    assert np.all((sd / mean)[1] > 0.999 * (sd / mean)[0])
    _, bare = driven(None).predict(x, "elongation", HOURS)
    assert np.all(sd < bare)


def test_after_the_fine_ones_horizon_its_correction_is_held() -> None:
    x = inputs_of(driven(None), [40], 0.0)[:, :4]
    late = np.array([5e4, 9e4])
    bare, _ = replace(MODEL.surrogate, anchor=None).predict(x, "elongation", late)  # type: ignore[type-var]
    mean, _ = MODEL.surrogate.predict(x, "elongation", late)
    assert mean[0, 1] > mean[0, 0]
    assert np.diff(np.log(mean / bare))[0] == pytest.approx(0.0, abs=0.02)


def test_the_covariance_of_errors_is_what_a_further_run_takes_away() -> None:
    """Universal kriging: v(z | runs and z') = v(z) − c² / v(z')."""
    rng = np.random.default_rng(5)
    z, targets = rng.uniform(-1, 1, (30, 3)), rng.normal(size=(30, 2))
    hyper = Hyper((0.8, 1.1, 2.0), 1e-12, 1)
    here, there = rng.uniform(-1, 1, (1, 3)), rng.uniform(-1, 1, (1, 3))
    known = SharedGP.condition(z, targets, hyper)
    v, (v0,), (c,) = known.covariance(here, there[:, None])
    more = SharedGP.condition(np.vstack([z, there]), np.vstack([targets, [[0.3, 1.0]]]), hyper)
    (_, after) = more.mean_and_variance(here)
    assert c[0] ** 2 / v0[0] > 0.01 * v[0]
    assert after[0] == pytest.approx(v[0] - c[0] ** 2 / v0[0], rel=1e-6)
    rough = SharedGP.condition(z, targets, replace(hyper, nugget=1e-3))
    (same,), _, ((alike,),) = rough.covariance(here, here[:, None])
    assert same == pytest.approx(alike, rel=1e-12)
    several = known.covariance(here, np.stack([there, here], axis=1))
    assert (several[1][0, 0], several[2][0, 0]) == (v0[0], c[0])
    assert several[1][0, 1] == pytest.approx(v[0], rel=1e-12)


def test_the_anchor_is_part_of_the_models_name() -> None:
    bare = Model.of(MODEL.network, WIDE)
    assert bare.digest != MODEL.digest
    again = Model.of(MODEL.network, MODEL.surrogate)
    assert again.digest == MODEL.digest


def test_an_anchor_that_does_not_fit_is_refused() -> None:
    moved = replace(FINE, points=FINE.points + 1.0)
    with pytest.raises(InputError, match="another mesh"):
        driven(Anchor(moved, ANCHOR.asleep))
    with pytest.raises(InputError, match="does not cover"):
        driven(Anchor(FINE, {"cooling_flow": 1.0}))
    wider = RANGES | {"t1t_rate": (0.79, 1.0)}
    with pytest.raises(InputError, match="fine surrogate's runs"):
        Driven(WIDE, (WEAR,), wider, FIXED, ANCHOR)
    assert rotor_blade_network().parameter("t1t_rate").prior.low >= 0.8


def test_a_correction_that_has_nothing_to_do_with_the_place_adds_its_own_error() -> None:
    """Where v(0) > 2 c the variance of E_D / E_0 is above that of E_D alone: it is not capped."""
    rng, wide = np.random.default_rng(3), BIASED
    start = wide.low + rng.random((400, len(wide.low))) * (wide.high - wide.low)
    middle = wide.low + rng.random((400, 1, len(wide.low))) * (wide.high - wide.low)
    assert ANCHOR is not None
    share = ANCHOR._share(wide, start, middle)[:, 0]
    v0, v, c = wide.process.covariance(wide.scaled(start), wide.scaled(middle[:, 0])[:, None])
    np.testing.assert_allclose(share**2, (v[:, 0] + v0 - 2 * c[:, 0]) / v[:, 0], rtol=1e-9)
    assert np.mean(share > 1) > 0.5
    np.testing.assert_allclose(ANCHOR._share(wide, start, start[:, None]), 0.0, atol=1e-5)
