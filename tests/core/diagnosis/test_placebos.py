"""Placebos: effects where they are not, in rotors whose scores are known exactly."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from core.diagnosis.grammar import Cell
from core.diagnosis.placebos import (
    ALLOWED,
    BLADES,
    COUNT,
    LEAST,
    READINGS,
    SEEN,
    Placebo,
    placebos,
    withstood,
)
from core.diagnosis.signature import exchanged
from core.diagnosis.verdict import Verdict
from core.family import Shape, Whom
from tests.core.diagnosis.fleet import READING, SIGMA, TIMES, rotor

OFFSET = next(f for f in READING if f.how == "plus")
CAMPAIGN = Cell(OFFSET, "constant", "campaign", "c1")


def asked(cell: Cell, seed: int, add: Any, few: int | None = None) -> dict[str, Placebo]:
    seen, facts = rotor(seed, add)
    if few is not None:
        whole = {"blades", "rows", "place", "q", "information", "slope", "answer", "lean", "points"}
        less = {name: getattr(seen, name)[:few] for name in (*whole, "answers")}
        seen = replace(seen, **less)
    changed = exchanged(seen, cell, facts, {"y": SIGMA}, cast(Any, None))
    return {one.by: one for one in placebos(seen, cell, facts, changed, seed)}


def grown(shape: Shape, whom: Whom, value: str | None = None) -> Cell:
    return Cell(replace(OFFSET, size=0.5), shape, whom, value, reference_h=TIMES[-1])


def test_a_campaign_that_is_off_is_off_at_its_own_readings_alone() -> None:
    found = asked(CAMPAIGN, 1, lambda b, k: 4 * SIGMA * (k == 1))
    assert set(found) == {BLADES, READINGS}
    for one in found.values():
        assert one.won == 0
        assert one.stands
        assert LEAST <= one.count <= COUNT
        assert one.gained > one.best + 5


@pytest.mark.parametrize("lot", ["L0", "L1", "L2"])
def test_a_lot_that_grows_is_told_by_its_own_blades(lot: str) -> None:
    """The verdict follows the label: of the lots that do not grow placebos win."""
    own = lambda b, k: 3 * SIGMA * TIMES[k] ** 2 * (b % 3 == 1)  # noqa: E731
    one = asked(grown("late", "lot", lot), 2, own)[BLADES]
    assert (one.won <= ALLOWED * one.count) is (lot == "L1")
    assert (one.gained > 5) is (lot == "L1")


def test_one_odd_blade_is_no_lot() -> None:
    """What it does in its own lot it does in every other that it is put into: the control that
    must fail, for without placebos the lot gains what an effect has to gain."""
    found = asked(grown("late", "lot", "L1"), 3, lambda b, k: 40 * SIGMA * TIMES[k] ** 2 * (b == 1))
    assert found[BLADES].gained > 5
    assert found[BLADES].won > 0.2 * found[BLADES].count
    assert not found[BLADES].stands


def test_what_all_blades_have_is_no_chance_of_signs_and_runs_as_it_is_said_to_run() -> None:
    late = lambda b, k: 4 * SIGMA * TIMES[k] ** 2  # noqa: E731
    found = asked(grown("late", "all"), 4, late)
    assert found[BLADES].stands
    assert found[READINGS].stands
    jagged = lambda b, k: 4 * SIGMA * TIMES[(k + b) % 3] ** 2  # noqa: E731
    torn = asked(grown("late", "all"), 4, jagged)[READINGS]
    assert torn.won > ALLOWED * torn.count, "each at times of its own"


def test_what_simulations_err_by_in_all_blades_is_not_held_against_the_effect_alone() -> None:
    """A placebo that is turned in half of the blades has no such error: it would win."""
    seen, facts = rotor(4, lambda b, k: 4 * SIGMA * TIMES[k] ** 2)
    cell = grown("late", "all")
    changed = exchanged(seen, cell, facts, {"y": SIGMA}, cast(Any, None))
    doubted = replace(seen, alike=np.where(seen.real, 2.0 * SIGMA, 0.0)[:, :, None])
    found = placebos(seen, cell, facts, changed, 4)
    assert placebos(doubted, cell, facts, changed, 4) == found
    assert found[0].gained > 5


def test_in_sound_rotors_an_effect_beats_its_placebos_as_often_as_chance_has_it() -> None:
    """Exactly 5 % where all places are alike; sixty rotors, of a lot and of a campaign."""
    for cell, by in ((grown("late", "lot", "L1"), BLADES), (CAMPAIGN, READINGS)):
        sound = [asked(cell, seed, None)[by] for seed in range(100, 160)]
        stood = [one.won <= ALLOWED * one.count for one in sound]
        assert sum(stood) <= 9, "3 of 60 are expected"
        middle = np.mean([one.won / one.count for one in sound])
        assert abs(middle - 0.5) < 4 / np.sqrt(12 * 60)
        assert all(one.stands for one in sound if one.gained < SEEN), "the scan says nothing of it"


def test_where_places_are_few_nothing_is_asked() -> None:
    """Of four blades half are six; of five, read thrice, other readings are many."""
    cell = grown("late", "all")
    assert set(asked(cell, 5, None, few=4)) == {READINGS}
    assert BLADES in asked(cell, 5, None, few=8)


def test_a_claim_whose_placebos_win_is_dropped_with_the_numbers() -> None:
    verdict = Verdict("effect", 0.01, 0.5, ("wear",), None, (), {}, {}, (), ("it gains",))
    good = Placebo("wear", READINGS, 150, 7, 9.0, 9.5)
    assert withstood(verdict, (good,)) == verdict
    lost = withstood(verdict, (good, Placebo("wear", BLADES, 160, 51, 9.0, 19.0)))
    assert (lost.word, lost.names) == ("unattributed", ())
    first, rest = lost.reasons
    assert "of 160 placebos 51 gain as much, where 5% may" in first
    assert rest == "it gains"
    told = good.to_json()
    assert (told["won"], told["count"], told["stands"], told["best_nat"]) == (7, 150, True, 9.5)


def test_placebos_are_those_of_the_seed() -> None:
    assert asked(CAMPAIGN, 6, None) == asked(CAMPAIGN, 6, None)
