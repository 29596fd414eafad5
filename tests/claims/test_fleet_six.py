"""The kept study of fleets read six times, and what the same rotors without effects leave."""

from __future__ import annotations

import pytest

from core.validation import effects_study as study
from core.validation.effect_gains import improvement
from core.validation.effect_plans import plan
from core.validation.effect_sets import CLEAN, NAMED, PHYSICS, SENSORS, conditions
from tests.claims.test_fleet_later import kept
from tests.claims.words import WORDS

NAME, SETS = "effects-six-visits", 4


def test_every_set_is_there_and_the_seed_comes_from_the_commit() -> None:
    found = kept(NAME)
    numbers = {(one["condition"], one["number"]) for one in found["sets"]}
    kinds = conditions(plan("fleet-six-visits"))
    assert numbers == {(kind, n) for kind in kinds for n in range(SETS)}
    assert (found["plan"], found["size"]) == ("fleet-six-visits", 2.0)
    assert study.table(found["sets"]) == found["table"]
    assert study.marks(found["table"]) == pytest.approx(found["marks"])
    assert improvement(found["sets"]) == found["improvement"]
    assert found["seed"] == int(found["commit"][:6], 16)


def test_twice_the_readings_name_no_more_physics_and_nothing_wrongly() -> None:
    found = kept(NAME)
    table = found["table"]
    assert all(row["wrong"] == 0 for row in table.values())
    right = {kind: round(SETS * table[kind]["right"]) for kind in NAMED}
    assert sum(right[kind] for kind in SENSORS) == 11
    assert {kind: right[kind] for kind in PHYSICS if right[kind]} == {"worn lot": 1}
    assert f"**{sum(right.values())} of 32** get their name" in WORDS
    in_set = {kind: round(SETS * table[kind]["in the set"]) for kind in PHYSICS}
    assert in_set == {"wear": 2, "worn lot": 0, "fouling": 1, "step": 4, "tertiary": 0}
    assert sum(round(SETS * table[kind]["alarms"]) for kind in NAMED) == 28
    assert found["marks"]["outside, no name"] == 1.0
    alarms = [round(SETS * table[kind]["alarms"]) for kind in CLEAN]
    assert alarms == [0, 2, 1]
    assert "**3 of 12 clean sets alarm**" in WORDS
    assert not any(one["names"] for one in found["sets"] if one["condition"] in CLEAN)
    named = [found["possible"][kind]["name"] for kind in NAMED]
    assert [round(100 * name) for name in named[3:]] == [24, 57, 8, 78, 71]
    assert round(100 * sum(named) / len(named)) == 67


def test_clean_fleets_read_six_times_alarm_more_often_than_asked_and_are_given_no_name() -> None:
    sets, more = kept(NAME)["sets"], kept("effects-six-visits-clean")["sets"]
    first = [one for one in sets if one["condition"] in CLEAN]
    alarms = [sum(one["alarm"] for one in own) for own in (first, more)]
    assert (alarms, len(first), len(more)) == ([3, 4], 12, 48)
    assert "4 of 48 alarm (1, 1 and 2 of 16 by kind), 8.3 %" in WORDS
    assert "7 of 60, 11.7 % ± 4.1" in WORDS
    assert sum(alarms) / 60 > 0.075, "asked for"
    assert not any(one["names"] for one in more)


def test_clean_fleets_read_six_times_alarm_seldom_once_gross_readings_are_bounded() -> None:
    found = kept("effects-six-visits-clean-2")
    assert found["seed"] == int(found["commit"][:6], 16)
    kinds = {(one["condition"], one["number"]) for one in found["sets"]}
    assert kinds == {(kind, n) for kind in CLEAN for n in range(20)}
    assert study.table(found["sets"]) == found["table"]
    alarms = [one for one in found["sets"] if one["alarm"]]
    assert [one["condition"] for one in alarms] == ["clean, heavy tails"]
    assert not any(one["names"] for one in found["sets"])
    assert "**1 of 60** alarms, 1.7 %" in WORDS
    assert "8 of 120, 6.7 %" in WORDS


def test_what_is_left_is_what_the_same_rotors_have_without_the_effect() -> None:
    found = kept(NAME)["improvement"]
    of_sensors = [(found[kind]["rmse"], found[kind]["least rmse"]) for kind in SENSORS]
    for after, least in of_sensors:
        assert after < 1.02 * least
    assert [round(after, 2) for after, _ in of_sensors] == [0.59, 0.69, 0.70]
    assert "0.59, 0.69 and 0.70 of what it was" in WORDS
    physics = ("wear", "step", "worn lot")
    assert [round(found[kind]["rmse"], 2) for kind in physics] == [0.96, 0.79, 0.91]
    assert [round(found[kind]["least rmse"], 2) for kind in physics] == [0.90, 0.71, 0.92]
    kinds = ("wear", "step", *SENSORS)
    nearer = [round(100 * (1 - found[kind]["forecast"])) for kind in kinds]
    most = [round(100 * (1 - found[kind]["least forecast"])) for kind in kinds]
    assert nearer == [57, 39, 92, 81, 73]
    assert most == [92, 86, 95, 83, 72]
    better = sum(found[kind]["better"] * found[kind]["sets"] for kind in NAMED)
    assert (round(better), sum(found[kind]["sets"] for kind in NAMED)) == (23, 24)
    assert "better in 23 of 24 sets" in WORDS
