"""Blades whose readings cannot be the model's do not carry the rotor away."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from core.calibration import bounded
from core.calibration.online import begun, update
from core.calibration.space import shared_space
from core.calibration.start import Start
from core.calibration.state import RotorSpec, RotorState, shared_posterior
from core.calibration.step import Step
from core.calibration.target import assemble
from core.calibration.weighed import Weighed
from core.calibration.workspace import Workspace
from core.observation import Inspection
from tests.core.calibration.test_bad_data import MODEL, assert_finite, reading

BLADES = 8
SPEC = RotorSpec("r", tuple(f"b{i}" for i in range(BLADES)), particles=1200, seed=4)
NOISE = 0.05
TRUTH = 1.2


def rotor(seed: int, slip: float = 0.0, blades: int = BLADES) -> list[Inspection]:
    """y = s + l + noise, three readings a blade; the last of the last blade is `slip` noises off.

    The blades' levels lie at the ends of their interval, so that each blade tells of s by itself.
    """
    rng = np.random.default_rng([20_261_129, seed])
    level = np.where(np.arange(blades) % 2 == 0, -0.5, 0.5)
    found = []
    for b in range(blades):
        for k in range(3):
            off = slip * (b == blades - 1 and k == 2)
            value = TRUTH + level[b] + NOISE * (rng.normal() + off)
            found.append(reading(b, value, NOISE, 8e3 * (k + 1)))
    return found


def s_of(state: RotorState) -> tuple[float, float]:
    """Mean and sd of the shared parameter."""
    p = shared_posterior(state.meta, state.arrays.__getitem__).particles
    return float(p.mean[0]), float(np.sqrt(p.covariance[0, 0]))


def without(readings: list[Inspection], blade: str = f"b{BLADES - 1}") -> list[Inspection]:
    return [r for r in readings if r.blade != blade]


def test_the_rotor_follows_the_other_blades_alone() -> None:
    given = rotor(1, 40.0)
    state, others = update(MODEL, SPEC, given), update(MODEL, SPEC, without(given))
    assert_finite(state)
    told = state.meta["health"]
    assert told["status"] == "contradicted"
    assert [(one["blade"], one["bounded"]) for one in told["contradicted"]] == [("b7", True)]
    assert [one["reading"] for one in told["contradicted"][0]["suspects"]] == ["b7t24000"]
    assert "; no other blade follows it; without reading b7t24000" in told["reasons"][0]
    assert np.array_equal(state.arrays["shared/x"], others.arrays["shared/x"])
    same = pytest.approx(others.arrays["shared/log_w"], abs=1e-5)  # tilts are rounded
    assert state.arrays["shared/log_w"] == same
    work = Workspace()
    rows = work.rows_of(MODEL, [r for r in given if r.blade == "b7"])
    space = shared_space(MODEL, [rows], None)
    message = work.messages_of(MODEL, {"b7": rows}, space, {})["b7"]
    gained = state.meta["log_evidence"] - others.meta["log_evidence"]
    assert gained == pytest.approx(bounded.floor_of(message), abs=1e-6)


def test_the_floor_is_what_it_says() -> None:
    """Three readings of a known noise: residuals of zero, less what noise exceeds in e^−20."""
    from scipy.stats import chi2

    rows = assemble(MODEL, [reading(0, v, NOISE, t) for v, t in ((1.0, 1e3), (1.1, 2e3), (3, 3e3))])
    assert rows is not None
    space = shared_space(MODEL, [rows], None)
    message = Workspace().messages_of(MODEL, {"b0": rows}, space, {})["b0"]
    zero = -3 * np.log(NOISE * np.sqrt(2 * np.pi))
    exact = zero - 0.5 * chi2.isf(np.exp(-20.0), 3) - bounded.DOUBT
    assert bounded.floor_of(message) == pytest.approx(exact, rel=1e-3)


def test_one_that_fits_once_the_others_are_believed_counts_in_full() -> None:
    """Dragged by a slip, the rotor's best node lies where sound blades contradict: they come back,
    and say what they said."""
    given = rotor(2, 400.0)
    state, others = update(MODEL, SPEC, given), update(MODEL, SPEC, without(given))
    assert [one["blade"] for one in state.meta["health"]["contradicted"]] == ["b7"]
    assert state.arrays["shared/log_w"] == pytest.approx(others.arrays["shared/log_w"], abs=1e-5)


def test_a_blade_that_is_another_one_is_set_apart() -> None:
    """Its readings agree with each other, and no shared parameters of the others give them: at the
    compromise between both all blades contradict."""
    given = [replace(r, values=r.values + 1.5) if r.blade == "b7" else r for r in rotor(6)]
    state, others = update(MODEL, SPEC, given), update(MODEL, SPEC, without(given))
    told = state.meta["health"]["contradicted"]
    assert [(one["blade"], one["bounded"], one["suspects"]) for one in told] == [("b7", True, [])]
    assert s_of(state)[0] == pytest.approx(s_of(others)[0], abs=0.01 * s_of(others)[1])


def test_in_any_order_and_mended_by_a_correction() -> None:
    given = rotor(3, 30.0)
    state = update(MODEL, SPEC, given)
    assert update(MODEL, SPEC, given[::-1], workspace=Workspace()).digest == state.digest
    kept = Workspace(places={})
    assert update(MODEL, SPEC, given, workspace=kept).digest == state.digest
    assert update(MODEL, SPEC, given, workspace=kept).digest == state.digest, "from kept places"
    mended = [r for r in given if r.id != "b7t24000"]
    sound = update(MODEL, SPEC, mended, state)
    assert sound.meta["health"]["status"] == "ok"
    assert sound.digest == update(MODEL, SPEC, mended).digest


def test_quick_updates_keep_it_apart_and_its_own_readings_seal_at_once() -> None:
    given = rotor(4, 30.0)
    state = update(MODEL, SPEC, given)
    late = reading(0, TRUTH - 0.5, NOISE, 3e4)
    quick = update(MODEL, SPEC, [*given, late], state, quick=True)
    assert not quick.sealed
    told = quick.meta["health"]["contradicted"]
    assert [(one["blade"], one["bounded"]) for one in told] == [("b7", True)]
    exact = update(MODEL, SPEC, [*given, late])
    assert s_of(quick)[0] == pytest.approx(s_of(exact)[0], abs=0.3 * s_of(exact)[1])
    own = reading(7, TRUTH + 0.5, NOISE, 3e4)
    at_once = update(MODEL, SPEC, [*given, own], state, quick=True)
    assert at_once.sealed, "its floor was made for other readings"
    assert at_once.digest == update(MODEL, SPEC, [*given, own]).digest


def test_a_comparison_begins_with_those_who_are_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """A diagnosis asks for a dozen posteriors of one rotor: none is looked for where a slip has it,
    and none has another evidence for it."""
    given = rotor(7, 30.0)
    state = update(MODEL, SPEC, given)
    start = Start.of(MODEL, state)
    assert start.apart == {"b7"}
    assert start.joined(["a"], np.zeros((1, 1)), np.zeros(1), np.eye(1)).apart == {"b7"}
    assert replace(start, apart=frozenset()).between(start).wider(2.0).apart == {"b7"}
    asked: list[set[str]] = []
    real = Step.weigh_with

    def weigh_with(self: Step, floors: Mapping[str, float]) -> Weighed:
        asked.append(set(floors))
        return real(self, floors)

    monkeypatch.setattr(Step, "weigh_with", weigh_with)
    step = begun(MODEL, SPEC, given, start=start)
    assert step.log_evidence == pytest.approx(state.meta["log_evidence"], abs=0.05)
    assert asked == [{"b7"}]


@pytest.mark.parametrize("wrong", [2, 4])
def test_where_too_many_contradict_nobody_is_set_apart(wrong: int) -> None:
    """Of eight, more than a fifth: which of them to believe is not told."""
    given = [
        replace(r, values=r.values + 30 * NOISE)
        if int(r.blade[1]) < wrong and r.time_h == 8e3
        else r
        for r in rotor(5)
    ]
    state = update(MODEL, SPEC, given)
    told = state.meta["health"]["contradicted"]
    assert len(told) >= wrong
    assert not any(one["bounded"] for one in told)
    assert "no other blade follows" not in " ".join(state.meta["health"]["reasons"])


def drawn_apart(rounds: int, seeds: int = 12) -> np.ndarray:
    """(s − truth without the slip) in sds of the posterior without it, for slips of many sizes."""
    found = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bounded, "ROUNDS", rounds)
        for k in range(seeds):
            given = rotor(100 + k, float(np.geomspace(8.0, 800.0, seeds)[k]) * (-1) ** k)
            mean, sd = s_of(update(MODEL, SPEC, without(given)))
            found.append((s_of(update(MODEL, SPEC, given))[0] - mean) / sd)
    return np.array(found)


def test_slips_of_eight_to_eight_hundred_noises_move_the_rotor_by_little() -> None:
    """Every slip counts; without floors (the control) most of them move it by many sds."""
    off, control = drawn_apart(bounded.ROUNDS), drawn_apart(0)
    assert np.max(np.abs(off)) < 4.0, off.round(2)
    assert np.sum(np.abs(off) < 0.5) >= 9, off.round(2)
    assert np.sum(np.abs(control) > 4.0) >= 6, control.round(2)
