"""The kept studies of blades that were exchanged: told where they differ, and nobody else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest

from core.validation import slips
from core.validation.effect_plans import plan
from core.validation.effect_sets import conditions
from tests.claims.test_fleet_later import kept
from tests.claims.words import WORDS

NAMES = {"exchanged": 60, "exchanged-effects": 75, "exchanged-fleet": 12}


def told(cases: Sequence[Mapping[str, Any]], low: float, high: float) -> tuple[int, int]:
    """Of pairs that differ by `low` to `high` noises, those that are told, and all."""
    own = [one["exchange told"] for one in cases if low <= one["off"] < high]
    return sum(own), len(own)


@pytest.mark.parametrize("name", NAMES)
def test_every_case_is_there_and_no_other_pair_is_told(name: str) -> None:
    found = kept(name)
    assert found["seed"] == int(found["commit"][:6], 16)
    assert [one["number"] for one in found["cases"]] == list(range(NAMES[name]))
    assert {one["kind"] for one in found["cases"]} == {"swapped"}
    assert slips.table(found["cases"]) == found["table"]
    assert found["table"]["all"]["exchanges told wrongly"] == 0


def test_blades_that_differ_are_told_and_no_sound_ones() -> None:
    cases = kept("exchanged")["cases"]
    assert [told(cases, *size) for size in ((6, np.inf), (3, 6), (0, 3))] == [
        (32, 32), (6, 14), (0, 14),
    ]  # fmt: skip
    assert "**32 of 32**" in WORDS
    assert "6 of 14 of three to six, none of 14 closer ones" in WORDS
    assert not any(one["exchanges before"] or one["contradicted"] for one in cases)
    assert round(max(abs(one["moved"]) for one in cases), 1) == 3.0
    assert "moves by up to 3.0 sd by the exchange" in WORDS


def test_an_effect_that_the_model_lacks_is_no_exchange_and_hides_none() -> None:
    found = kept("exchanged-effects")
    every = conditions(plan("rotor-20"))
    cases = found["cases"]
    assert [one["condition"] for one in cases] == [every[k % len(every)] for k in range(75)]
    assert [told(cases, *size) for size in ((6, np.inf), (3, 6), (0, 3))] == [
        (42, 44), (5, 12), (0, 19),
    ]  # fmt: skip
    assert "42 of 44 pairs of six noises and more, 5 of 12 of three to six, none of 19" in WORDS
    before = [one["condition"] for one in cases if one["exchanges before"]]
    assert before == ["clean, heavy tails"]


def test_in_fleets_too() -> None:
    cases = kept("exchanged-fleet")["cases"]
    assert (told(cases, 6, np.inf), told(cases, 0, 6)) == ((4, 5), (1, 7))
    assert "4 of 5 pairs of six noises and more and 1 of 7 closer ones are told" in WORDS
    assert not any(one["exchanges before"] for one in cases)
    assert round(max(abs(one["moved"]) for one in cases), 2) == 0.12
