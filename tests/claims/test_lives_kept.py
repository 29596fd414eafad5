"""The kept studies of lives: chances to pass a limit against blades that pass it."""

from __future__ import annotations

from typing import Any

import pytest

from core.validation import lives, lives_table
from tests.claims.test_fleet_later import kept
from tests.claims.words import WORDS

FE = "lives-fe-nu"


def at_next(name: str, who: str, *what: str) -> list[Any]:
    return [kept(name)["next_outage"][who][key] for key in what]


def test_every_rotor_is_there_and_the_seed_comes_from_the_commit() -> None:
    found = kept(FE)
    assert found["seed"] == int(found["commit"][:6], 16)
    assert (found["rotors"], found["failed"], found["particles"]) == (140, {}, lives.PARTICLES)
    for who in lives_table.WHO:
        rows = found["reliability"][who]
        assert sum(row["blades"] for row in rows) == 140 * 20 * len(lives.FACTORS)
        passing, sound = at_next(FE, who, "passing", "sound")
        assert (passing, passing + sound) == (2345, 8400)


def test_finite_element_blades_pass_as_often_as_they_are_told_to() -> None:
    found = kept(FE)
    assert found["outside_band"] == []
    rows = {row["from"]: row for row in found["reliability"]["twin"]}
    shares = [(round(100 * rows[k]["told"], 1), round(100 * rows[k]["passed"], 1)) for k in
              (0.01, 0.05, 0.2, 0.5, 0.8)]  # fmt: skip
    assert shares == [(2.6, 2.9), (11.4, 12.4), (33.5, 33.7), (65.3, 69.0), (88.4, 92.5)]
    assert "2.6 → 2.9, 11.4 → 12.4, 33.5 → 33.7, 65.3 → 69.0, 88.4 → 92.5 %" in WORDS
    assert "→ 92.5 % (± 0.6, 1.4, 2.5, 2.4, 2.0)" in WORDS
    assert [round(100 * rows[k]["error"], 1) for k in (0.01, 0.05, 0.2, 0.5, 0.8)] == [
        0.6, 1.4, 2.5, 2.4, 2.0,
    ]  # fmt: skip
    trend = {row["from"]: row for row in found["reliability"]["trend"]}
    assert [round(100 * trend[0.95][k], 1) for k in ("told", "passed")] == [97.2, 83.1]
    assert "83.1 % pass where 97.2 are told" in WORDS


def test_what_comes_of_pulling_blades_by_them() -> None:
    asked = ("missed", "in_vain")
    assert at_next(FE, "twin", *asked) == [11, 728]
    assert at_next(FE, "band", *asked) == [14, 691]
    assert at_next(FE, "trend", *asked) == [72, 799]
    assert (
        "Of 2,345 that pass by then 11 are missed, and 728 of 6,055 others pulled in vain" in WORDS
    )
    assert "(14 and 691 by mean ± sd, 72 and 799 by the trend)" in WORDS
    assert at_next(FE, "twin", "log_loss") == pytest.approx([0.08], abs=5e-4)
    assert at_next(FE, "trend", "log_loss") == pytest.approx([0.161], abs=5e-4)


def test_what_fourteen_rotors_cannot_say_is_told() -> None:
    found = kept(FE)
    assert found["controls_caught"]["narrow"] == ["1 x", "1.25 x", "1.5 x"]
    assert (found["controls_caught"]["worst"], found["passed"]) == ([], False)
    assert "of the first blade of a rotor fourteen rotors say nothing" in WORDS


def test_simulated_blades_and_the_first_of_a_rotor_pass_when_told() -> None:
    found = kept("lives-rotor-20")
    assert found["seed"] == int(found["commit"][:6], 16)
    assert (found["passed"], found["rotors"], found["failed"]) == (True, 400, {})
    assert found["controls_caught"]["narrow"] == ["1 x", "1.25 x", "1.5 x"]
    assert found["controls_caught"]["worst"] == ["1 x", "1.25 x"]
    assert all(row["independent"]["inside"] for row in found["table"].values())
    rows = {row["from"]: row for row in found["reliability"]["twin"]}
    shares = [(round(100 * rows[k]["told"], 1), round(100 * rows[k]["passed"], 1)) for k in
              (0.01, 0.05, 0.2, 0.5, 0.8)]  # fmt: skip
    assert shares == [(2.5, 1.9), (11.2, 11.2), (33.2, 33.8), (64.7, 62.9), (88.3, 86.9)]
    assert "64.7 → 62.9, 88.3 → 86.9 %; of 6,495 that pass 26 are missed" in WORDS
    assert at_next("lives-rotor-20", "twin", "missed", "in_vain") == [26, 2395]
    assert at_next("lives-rotor-20", "trend", "missed", "in_vain") == [161, 2553]
