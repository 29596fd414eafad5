"""The kept study of noises that are stated too small: told, and no blade called exchanged."""

from __future__ import annotations

from core.validation import stated
from tests.claims.test_fleet_later import kept
from tests.claims.words import WORDS

ROTORS = 4


def test_every_rotor_is_there_and_the_seed_comes_from_the_commit() -> None:
    found = kept("stated")
    assert found["seed"] == int(found["commit"][:6], 16)
    told = {(one["times"], one["number"]) for one in found["cases"]}
    assert told == {(times, n) for times in stated.TIMES for n in range(ROTORS)}
    assert stated.table(found["cases"]) == found["table"]


def test_from_twice_on_it_is_told_and_nobody_is_called_exchanged() -> None:
    table = kept("stated")["table"]
    assert [table[k]["told"] for k in ("1", "1.5", "2", "3")] == [0, 1, 4, 4]
    assert [row["exchanges"] for row in table.values()] == [0, 0, 0, 0]
    assert [row["exchanges believed"] for row in table.values()] == [0, 0, 2, 3], "the control"
    assert [(table[k]["least"], table[k]["most"]) for k in ("2", "3")] == [(1.62, 2.1), (2.12, 2.8)]
    assert "none of four, one, all four and all four" in WORDS
    assert "in two of four and three of four rotors" in WORDS
