"""Blades that were read once tell nothing of what the model lacks; finite-element truths, sound."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from core.builtin import inspection_plan, rotor_blade
from core.calibration.online import RotorSpec, update
from core.calibration.state import RotorState
from core.diagnosis import Case, Facts, diagnose
from core.diagnosis.noticed import NOTHING, in_words, noticed
from core.diagnosis.scatter import TOLD, Scatter
from core.diagnosis.verdict import judge
from core.model import Model
from core.observation import Inspection

BLADES, NOISE = 12, 0.015


@cache
def model() -> Model:
    return Model.of(rotor_blade.wide_network(), rotor_blade.load_wide())


def case_of(first: int, again: int = 0) -> Case:
    """A dozen blades of the plan, from one on, read at 9,000 h, and `again` of them at 18,000 h."""
    plan, rng = inspection_plan.load(), np.random.default_rng(first)
    names = list(inspection_plan.blades())[first : first + BLADES]
    read = [(b, 9000.0) for b in names] + [(b, 18_000.0) for b in names[:again]]
    data = []
    for b, h in read:
        truth = plan.elongation[list(inspection_plan.blades()).index(b)]
        y = float(np.interp(h, plan.time_h, truth)) + NOISE * rng.standard_normal()
        data.append(Inspection(f"{b}-{h:g}", b, "elongation", h, np.array([y]), campaign=f"{h:g}"))
    spec = RotorSpec(f"r{first}", tuple(names), 500, first)
    return Case(spec, tuple(data), {b: Facts() for b in names}, dealt=200)


@cache
def rotor(first: int, again: int = 0) -> tuple[RotorState, Case]:
    case = case_of(first, again)
    return update(model(), case.spec, case.readings), case


@pytest.mark.parametrize("first", [0, 20, 60])
def test_a_single_visit_cannot_contradict_the_model_and_that_is_said(first: int) -> None:
    state, case = rotor(first)
    found = diagnose(model(), state, case)
    assert (found.verdict.word, found.verdict.p) == ("adequate", 1.0)
    assert "none of 12 blades was read twice" in found.verdict.reasons[0]
    assert found.verdict.tried, "what would have been looked for is listed"
    assert found.scan is not None
    unseen = noticed(found.scan, case.noise(model(), state), case.seed, 60, could=False)
    assert in_words(unseen) == (NOTHING,)


def test_where_few_were_read_twice_these_alone_are_asked() -> None:
    state, case = rotor(40, again=4)
    assert len(case.once(model())) == BLADES - 4
    assert len(case.seen(model(), state).blades) == 4
    found = diagnose(model(), state, case)
    assert found.verdict.word == "adequate"
    assert "8 of 12 blades were read once" in found.verdict.reasons[-1]
    assert case_of(40, again=8).once(model()) == frozenset(), "the others are enough"


def test_what_parameters_imitate_sets_no_example_of_how_blades_scatter() -> None:
    """Ten blades: a cell of next to no information with phi far from one, and one of one blade."""
    own = np.zeros((10, 2))
    own[:, 0], own[0, 1] = 1e-4, 2.0
    c = np.zeros((10, 2))
    c[:, 0] = np.linspace(-0.2, 0.2, 10)
    alone = np.array([False, True])

    def phi(scale: float) -> float:
        held = own * [scale, 1.0]
        one = Scatter.of(held, held > 0, alone)
        root = np.sqrt(scale)
        return float(one.phi(c * [root, 1.0], np.zeros(2), held.sum(axis=0))[1])

    assert phi(1.0) == 1.0
    assert phi(1.1 * TOLD / 1e-3) > 100.0, "the control: where it is told"


def test_the_scan_itself_does_not_alarm_at_whatever_was_read_once() -> None:
    """Every such rotor had p = 0.035: phi of 57 made nothing of one blade's families."""
    state, case = rotor(0)
    assert judge(case.scan(model(), state), case.seed, dealt=200).p > 0.05
