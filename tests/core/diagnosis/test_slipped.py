"""A diagnosis of a rotor one of whose readings was written down wrongly."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from core.calibration import bounded
from core.calibration.online import Workspace, update
from core.calibration.state import RotorState
from core.diagnosis.diagnose import diagnose
from core.diagnosis.misread import apart, set_apart
from core.diagnosis.verdict import Verdict, judge
from core.model import rotor_blade_wide
from core.rng import stream
from core.validation import slips
from core.validation.effect_plans import plan
from core.validation.effect_sets import made
from tests.core.validation.fewer import of_blades

SEED, NUMBER = 8132651, 1


def slipped(condition: str, particles: int = 1000) -> tuple[Any, str]:
    """Ten finite-element blades, one reading of which has its decimal point moved."""
    given = made(of_blades(plan("rotor-20"), range(0, 20, 2)), condition, NUMBER, SEED, particles)
    rng = stream(SEED, "slips", "decimal", NUMBER)
    wrong, (name,), off = slips.slipped("decimal", given.case.readings, rng)
    assert off > 50
    return replace(given, case=replace(given.case, readings=wrong)), name


def first_word(given: Any, work: Workspace) -> tuple[RotorState, Verdict]:
    model = rotor_blade_wide()
    state = update(model, given.case.spec, given.case.readings, workspace=work)
    scan = replace(given.case, workspace=work).scan(model, state)
    return state, judge(scan, given.case.seed, dealt=given.case.dealt)


def test_it_raises_no_alarm_and_without_bounds_it_does(monkeypatch: pytest.MonkeyPatch) -> None:
    (given, name), work = slipped("clean", 400), Workspace()
    state, verdict = first_word(given, work)
    (one,) = state.meta["health"]["contradicted"]
    assert [s["reading"] for s in one["suspects"]] == [name]
    assert verdict.word == "adequate"
    assert verdict.p > 0.1
    monkeypatch.setattr(bounded, "ROUNDS", 0)
    monkeypatch.setattr(bounded, "TRIED", 0)
    assert first_word(given, work)[1].p < 0.05, "the control"


def test_an_effect_beside_it_is_found_and_the_blade_that_was_left_out_told() -> None:
    given, name = slipped("campaign")
    model, work = rotor_blade_wide(), Workspace()
    state = update(model, given.case.spec, given.case.readings, workspace=work)
    told = diagnose(model, state, given.case, workspace=work)
    assert (told.verdict.word, set(told.verdict.names)) == ("effect", given.truth)
    blade = next(r.blade for r in given.case.readings if r.id == name)
    said = " ".join(told.verdict.reasons)
    assert f"one reading contradicts all others of the blade: {blade}" in said
    assert f"maybe misread: {name} (blade {blade}" in said, "it is the farthest"


def state_of(*told: dict[str, Any]) -> RotorState:
    return cast(RotorState, SimpleNamespace(meta={"health": {"contradicted": told}}))


def test_blades_without_a_suspect_or_without_a_bound_stay_in() -> None:
    """All of a blade's readings together may tell of an effect of its own."""
    one = {"blade": "b1", "bounded": True, "suspects": [{"reading": "r"}]}
    others = {"blade": "b2", "bounded": True, "suspects": []}
    free = one | {"blade": "b3", "bounded": False}
    assert apart(state_of(one, others, free, {"blade": "b4"})) == {"b1"}
    assert set_apart(state_of(others)) == ()
    many = state_of(*(one | {"blade": f"b{k}"} for k in range(7)))
    assert set_apart(many)[0].endswith("b0, b1, b2, b3, b4 and 2 more")


def test_blades_that_look_exchanged_are_told_and_stay_in() -> None:
    """What an effect does to two blades can look like an exchange: they are no less heard."""
    told = {"blades": ["b7", "b3"]}
    state = cast(RotorState, SimpleNamespace(meta={"health": {"exchanged": [told]}}))
    assert apart(state) == frozenset()
    assert set_apart(state) == ("readings of a visit look exchanged, look at these first: b3, b7",)
