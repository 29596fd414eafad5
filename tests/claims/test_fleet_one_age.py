"""The kept study of fleets whose blades are all of one age, and clean fleets by the rules of it."""

from __future__ import annotations

import pytest

from core.validation import effects_study as study
from core.validation.effect_gains import improvement
from core.validation.effect_sets import CLEAN, CONDITIONS, PHYSICS, SENSORS
from tests.claims.test_fleet_later import kept
from tests.claims.words import WORDS

NAME, SETS = "effects-one-age", 4


def test_every_set_is_there_and_the_seed_comes_from_the_commit() -> None:
    found = kept(NAME)
    numbers = {(one["condition"], one["number"]) for one in found["sets"]}
    assert numbers == {(kind, n) for kind in CONDITIONS for n in range(SETS)}
    assert (found["plan"], found["size"]) == ("fleet-one-age", 2.0)
    assert study.table(found["sets"]) == found["table"]
    assert study.marks(found["table"]) == pytest.approx(found["marks"])
    assert improvement(found["sets"]) == found["improvement"]
    assert found["seed"] == int(found["commit"][:6], 16)


def test_where_blades_are_of_one_age_physics_has_no_name_and_nothing_a_wrong_one() -> None:
    found = kept(NAME)
    table = found["table"]
    assert all(row["wrong"] == 0 for row in table.values())
    assert all(table[kind]["right"] == 1.0 for kind in SENSORS)
    assert all(table[kind]["right"] == 0.0 for kind in PHYSICS)
    noticed = {kind: round(SETS * table[kind]["alarms"]) for kind in PHYSICS}
    assert noticed == {"wear": 4, "worn lot": 2, "fouling": 4, "step": 4, "tertiary": 4}
    assert table["step"]["in the set"] == 1.0
    assert "12 of 12 faults of sensors" in WORDS
    assert "18 of 20" in WORDS
    assert found["marks"]["outside, no name"] == found["marks"]["alike, not separable"] == 1.0
    alarms = {kind: round(SETS * table[kind]["alarms"]) for kind in CLEAN}
    assert list(alarms.values()) == [0, 1, 0]
    assert "1 of 12 clean sets" in WORDS
    by_oracle = [round(100 * found["possible"][kind]["name"]) for kind in PHYSICS]
    assert by_oracle == [3, 56, 1, 5, 36]


def test_clean_fleets_alarm_as_seldom_as_asked_and_none_gets_a_name() -> None:
    found = kept("effects-clean-4")
    alarms = [round(134 * found["table"][kind]["alarms"]) for kind in CLEAN]
    assert alarms == [7, 5, 9]
    assert found["marks"]["clean, alarms"] < 0.075
    assert max(alarms) / 134 < 0.075, "of each kind of noise by itself"
    assert "21 of 402 alarm, 5.2 %" in WORDS
    assert all(not one["names"] for one in found["sets"])
    assert {one["word"] for one in found["sets"]} == {"adequate", "unattributed"}
