"""Where a dozen blades lead to a corner of the box, all of them find the way out of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from core.calibration import rotor
from core.calibration.online import RotorSpec, begun
from core.calibration.step import Step
from core.smc.proposal import Proposal
from core.validation.coverage import model_of
from core.validation.simulate import simulate
from core.validation.variants import plan

BLADES = 16


def placed() -> Step:
    variant = plan("rotor-100")
    model = model_of(variant)
    made = simulate(model, variant, 293, 8)
    blades = tuple(made.local)[:BLADES]
    readings = [one for one in made.readings if one.blade in blades]
    return begun(model, RotorSpec("astray", blades, 200, 8), readings)


def led_astray(monkeypatch: pytest.MonkeyPatch, most: int) -> list[int]:
    """Every descent of at most so many scouts ends in a corner; how many each one had."""
    scouts, descend = list[int](), rotor.descend

    def misled(*given: Any, **named: Any) -> Proposal:
        scouts.append(len(given[2]))
        if scouts[-1] > most:
            return descend(*given, **named)
        d = given[2].shape[1]
        return Proposal(np.full(d, 0.02), 1e-3 * np.eye(d))

    monkeypatch.setattr(rotor, "descend", misled)
    return scouts


def test_all_blades_from_the_whole_box_find_what_a_dozen_do_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As of rotor 293 of the study kept in tests/claims/results/rotor-100, whose dozen do so."""
    known = placed().weigh_with({}).log_evidence
    scouts = led_astray(monkeypatch, most=16)
    step = placed()
    found = step.weigh_with({})
    assert scouts[-1] == len(found.unit) > max(scouts[:-1])
    assert found.ess_ratio > 0.5
    assert found.log_evidence == pytest.approx(known, abs=0.05)


def test_without_that_descent_the_corner_is_where_it_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    led_astray(monkeypatch, most=16)
    monkeypatch.setattr(rotor, "ASTRAY", -1.0)
    assert placed().weigh_with({}).ess_ratio < 0.05
