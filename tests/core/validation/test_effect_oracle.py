"""What readings could tell of an effect at best: against simulation, and where nothing can be."""

from __future__ import annotations

import numpy as np
import pytest

from core.calibration.online import Workspace
from core.diagnosis.families import FAMILIES
from core.diagnosis.grammar import Cell
from core.errors import InputError
from core.model import rotor_blade_wide
from core.validation import effect_oracle as oracle
from core.validation.effect_plans import NOISE, plan
from core.validation.effect_sets import OFFSET, made
from tests.core.diagnosis.fleet import rotor, scan

TWENTY = plan("rotor-20")
EITHER = Cell(next(f for f in FAMILIES if f.name == "fouling"), "linear", "all", None)
LOSS = Cell(FAMILIES[0], "linear", "all", None)


def test_what_is_left_beside_a_rival_is_what_simulated_readings_leave() -> None:
    """Normal readings with g planted: log likelihood ratio of g against a rival at its best."""
    rng = np.random.default_rng(3)
    g, rival = rng.normal(size=(2, 12)) + 1.5
    both = np.stack([g, rival])
    told = oracle._left(both @ both.T, 1, EITHER)
    y = g + rng.normal(size=(40_000, 12))
    best = y @ rival / (1.0 + rival @ rival)  # with a standard normal prior
    penalised = ((y - best[:, None] * rival) ** 2).sum(axis=1) + best**2
    odds = 0.5 * (penalised - ((y - g) ** 2).sum(axis=1))
    free = 0.5 * rival @ rival / (1.0 + rival @ rival)  # what fitting it gains of mere noise
    assert np.mean(odds) == pytest.approx(told - free, abs=4 * np.std(odds) / 200)


def test_a_rival_that_would_have_to_go_the_wrong_way_is_none() -> None:
    information = np.array([[8.0, -6.0], [-6.0, 9.0]])
    assert oracle._left(information, 1, LOSS) == 4.0
    assert oracle._left(information, 1, EITHER) == pytest.approx(4.0 - 1.8)


def test_a_campaigns_offset_is_told_from_all_else_and_an_hour_hotter_gas_is_not() -> None:
    model, campaign = rotor_blade_wide(), made(TWENTY, "campaign", 0, 5, 200)
    work = Workspace()
    moved = [r.id for r in campaign.case.readings if campaign.exact[r.id] != campaign.sound[r.id]]
    sure = oracle.possible(model, campaign, workspace=work)
    bound = 0.5 * len(moved) * (OFFSET / NOISE) ** 2  # what these readings tell of a mean
    assert 0.5 * bound < sure.alone < bound
    assert sure.alarm > 0.99
    assert sure.searched == 1.0
    assert sure.name > 0.98
    faint = oracle.possible(model, made(TWENTY, "step", 0, 5, 200), workspace=work)
    assert faint.rival is not None
    assert faint.left < sure.left / 2
    assert faint.name < 0.9
    assert faint.searched < faint.alarm, "a search has its price"
    with pytest.raises(InputError, match="has no effect"):
        oracle.possible(model, made(TWENTY, "clean", 0, 5, 200))


def test_a_search_alarms_as_often_as_is_said_where_nothing_is() -> None:
    """Of 400 sets 5 ± 1.1 % (and as much again, for the null is of as many)."""
    rng = np.random.default_rng(3)
    one = scan(*rotor(1))
    nothing = np.zeros(len(one.u))
    assert abs(oracle.searched(one, nothing, rng) - 0.05) < 3 * 0.011 * np.sqrt(2)
    half = oracle.searched(one, 0.5 * one.information[0], rng)
    assert half < oracle.searched(one, one.information[0], rng)
    assert oracle.searched(one, 4.0 * one.information[0], rng) > 0.9


def test_bounds_are_means_over_the_rotors_that_a_study_plants_in(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given = iter(
        [oracle.Possible(4.0, "fouling", 1.0), oracle.Possible(2.0, "wall loss (b 3)", 3.0)]
    )
    monkeypatch.setattr(oracle, "possible", lambda *_: next(given))
    monkeypatch.setattr(oracle, "rotor_blade_wide", lambda: None)
    steps: list[int] = []
    found = oracle.bounds(plan("fleet-100"), ["campaign"], 3, 200, 2.0, steps.append)["campaign"]
    assert (found["alone"], found["left"]) == (3.0, 2.0)
    assert found["rivals"] == ["fouling", "wall loss"]
    assert steps == [1]
