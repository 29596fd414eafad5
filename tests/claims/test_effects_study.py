"""The kept study of diagnoses: its counts, what it was made with, and what it misses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from core.validation import effects_study as study
from tests.claims.words import WORDS

KEPT: dict[str, Any] = json.loads(
    (Path(__file__).with_name("results") / "effects" / "result.json").read_text()
)
BEFORE: dict[str, Any] = json.loads(
    (Path(__file__).with_name("results") / "effects-before" / "result.json").read_text()
)
PAIRS: dict[str, Any] = json.loads(
    (Path(__file__).with_name("results") / "effects-pairs" / "result.json").read_text()
)
LATER: dict[str, Any] = json.loads(
    (Path(__file__).with_name("results") / "effects-all-kinds" / "result.json").read_text()
)
ASKED = {"named, right": 0.85, "named, wrong": 0.05, "outside, no name": 0.90}
"""Marks 3 and 4 of such a loop."""


@pytest.mark.parametrize("found", [KEPT, BEFORE], ids=["today", "before"])
def test_every_set_is_there_and_the_counts_are_those_of_the_sets(found: dict[str, Any]) -> None:
    sets = found["sets"]
    numbers = {(one["condition"], one["number"]) for one in sets}
    assert len(numbers) == len(sets) == 3 * 24 + 9 * 12
    marks = study.marks(study.table(sets))
    assert {name: marks[name] for name in found["marks"]} == pytest.approx(found["marks"])
    for name, row in found["table"].items():  # a lot that wears was called "wear" before
        assert any(row == own for own in study.table(sets).values()), name


@pytest.mark.parametrize(
    "found", [KEPT, BEFORE, PAIRS, LATER], ids=["today", "before", "pairs", "later"]
)
def test_the_seed_comes_from_the_commit_so_that_nothing_was_chosen_by_it(
    found: dict[str, Any],
) -> None:
    assert found["seed"] == int(found["commit"][:6], 16)


def test_nothing_is_claimed_of_sound_rotors_and_few_of_them_alarm() -> None:
    sound = [one for one in KEPT["sets"] if one["condition"] in study.CLEAN]
    assert len(sound) == 72
    assert [one["names"] for one in sound if one["word"] != "adequate"] == [[], []]
    assert KEPT["marks"]["clean, alarms"] < 0.075
    assert "2 of 72 clean sets alarm (7.5 %)" in WORDS


def test_outcomes_are_those_that_are_told() -> None:
    told = {
        name: [round(row[k] * row["sets"]) for k in ("alarms", "right", "in the set", "wrong")]
        for name, row in KEPT["table"].items()
    }
    assert told["campaign"] == [12, 12, 0, 0]
    assert told["instrument"] == [12, 11, 0, 1]
    assert told["gain"] == [11, 7, 1, 0]
    assert told["worn lot"] == [12, 6, 0, 0]
    assert told["step"] == [11, 0, 2, 0]
    assert told["tertiary"] == [7, 0, 0, 0]
    assert [told[name][1] for name in study.OUTSIDE] == [11, 12, 12]
    for row in ("12 (12) | 12 (10) | 0 (0)", "11 (12) | 7 (9) | 1 (1)", "12 (11) | 6 (8) | 0 (0)"):
        assert row in WORDS
    no_room = [r for r in KEPT["sets"] if any("no room" in why for why in r["reasons"])]
    assert sum(r["outcome"] == "silent" and r["condition"] == "worn lot" for r in no_room) == 5
    assert "five worn lots, because the wide model's runs end" in WORDS


def test_what_is_missed_and_what_holds_is_said() -> None:
    marks = KEPT["marks"]
    assert marks["named, right"] == 0.5 < ASKED["named, right"]
    assert marks["named, wrong"] == pytest.approx(1 / 72)
    assert marks["named, wrong"] < ASKED["named, wrong"]
    assert marks["outside, no name"] == pytest.approx(35 / 36)
    assert marks["outside, no name"] > ASKED["outside, no name"]
    for mark in ("36 of 72, 50 %", "1 of 72, 1.4 %", "35 of 36, 97 %", "before 51 and 61"):
        assert mark in WORDS
    assert [round(100 * BEFORE["marks"][m], 1) for m in ASKED] == [51.4, 5.6, 88.9]


def test_of_two_at_once_none_is_named_wrongly() -> None:
    sets = PAIRS["sets"]
    assert len({(r["condition"], r["number"]) for r in sets}) == len(sets) == 20
    assert study.table(sets) == PAIRS["table"]
    count = {what: sum(r["outcome"] == what for r in sets) for what in ("right", "one", "silent")}
    assert count == {"right": 10, "one": 6, "silent": 4}
    assert PAIRS["marks"]["pairs, wrong"] == 0.0
    assert "both are named in 10 and one of them in 6" in WORDS


def test_all_kinds_made_anew_name_no_less_and_what_they_miss_is_said() -> None:
    sets, marks = LATER["sets"], LATER["marks"]
    counts = {name: row["sets"] for name, row in LATER["table"].items()}
    assert counts == {name: 12 if name in study.CLEAN else 6 for name in KEPT["table"]}
    assert len({(r["condition"], r["number"]) for r in sets}) == len(sets) == 90
    assert study.table(sets) == LATER["table"]
    assert study.marks(LATER["table"]) == pytest.approx(marks)
    assert LATER["algorithm"] == "panels-19"
    right = {name: round(row["right"] * 6) for name, row in LATER["table"].items()}
    names = ("campaign", "instrument", "gain", "worn lot", "step", "tertiary")
    assert [right[name] for name in names] == [6, 5, 4, 5, 0, 0]
    assert marks["named, right"] == pytest.approx(20 / 36)
    assert marks["named, wrong"] == 0.0
    assert marks["outside, no name"] == pytest.approx(16 / 18)
    assert marks["outside, no name"] < ASKED["outside, no name"]
    assert marks["clean, alarms"] == pytest.approx(2 / 36)
    wrong = [(r["condition"], r["names"]) for r in sets if r["outcome"] == "wrong"]
    assert [name for name, _ in wrong] == ["some blades late", "pulse"]
    told = [LATER["improvement"][n] for n in names]
    assert sum(one["sets"] for one in told) == 28
    assert sum(one["sets"] * one["better"] for one in told) == pytest.approx(27)
    for said in ("**20 of 36**, 56 %", "16 of 18, 89 % of what has none", "better in 27 of the 28"):
        assert said in WORDS
