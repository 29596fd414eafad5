"""The kept studies of slips: one wrong reading, with and without bounds on what contradicts."""

from __future__ import annotations

import pytest

from core.validation import slips
from tests.claims.test_fleet_later import kept
from tests.claims.words import WORDS

NAME, CASES = "slips", 24


def test_every_case_is_there_and_the_seed_comes_from_the_commit() -> None:
    found = kept(NAME)
    numbers = {(one["kind"], one["number"]) for one in found["cases"]}
    assert numbers == {(kind, n) for kind in slips.KINDS for n in range(CASES)}
    assert found["plan"] == "rotor-20"
    assert slips.table(found["cases"]) == found["table"]
    assert found["seed"] == int(found["commit"][:6], 16)
    assert not any(one["accused before"] for one in found["cases"]), "no sound blade is accused"


def test_a_large_slip_is_named_and_carries_nobody_away_as_it_did() -> None:
    found = kept(NAME)
    every, large = found["table"]["all"], [r for r in found["cases"] if r["off"] >= slips.NOTICED]
    assert len(large) == every["large"] == 105
    assert [sum(r[what] for r in large) for what in ("right", "named")] == [93, 93]
    assert all(r["right"] for r in found["cases"] if r["contradicted"]), "never a sound blade"
    assert "in 93 of 105 the wrong reading is named" in WORDS
    assert [
        round(every[f"{when}, {what}"], 1)
        for when in ("moved", "unbounded")
        for what in ("median", "most")
    ] == [0.1, 2.9, 0.3, 8.0]
    above = [round(100 * every[f"{when}, above 1 sd"]) for when in ("moved", "unbounded")]
    assert above == [6, 23]
    assert "by more than one sd in 6 % of them, 2.9 at most; without bounds in 23 %, 8.0" in WORDS


def test_where_bounds_do_not_help_is_told() -> None:
    found = kept(NAME)
    missed = [r for r in found["cases"] if r["off"] >= slips.NOTICED and not r["named"]]
    by_kind = {kind: sum(r["kind"] == kind for r in missed) for kind in slips.KINDS}
    assert {k: n for k, n in by_kind.items() if n} == {"digits": 3, "swapped": 8, "slip": 1}
    assert "8 of 9 swapped blades, 3 of 13 turned digits and 1 of 22 slips" in WORDS
    worse = [abs(r["moved"]) - abs(r["unbounded"]) for r in found["cases"]]
    assert sorted(round(w, 1) for w in worse if w > 0.5) == [0.8, 0.9]
    assert "off by 0.8 and 0.9 sd more with bounds than without" in WORDS
    small = [abs(r["moved"]) for r in found["cases"] if r["off"] < slips.NOTICED]
    assert len(small) == 39
    assert max(small) == pytest.approx(0.88, abs=0.01)


def test_in_a_fleet_every_large_slip_is_named_and_the_rotor_stays_where_it_was() -> None:
    found = kept("slips-fleet")
    assert (found["plan"], found["seed"], found["commit"][:7]) == (
        *("fleet-six-visits", 8132651),
        "7c182b2",
    )
    numbers = {(one["kind"], one["number"]) for one in found["cases"]}
    assert numbers == {(kind, n) for kind in slips.KINDS for n in range(4)}
    assert slips.table(found["cases"]) == found["table"]
    large = [r for r in found["cases"] if r["off"] >= slips.NOTICED]
    assert (len(large), sum(r["named"] for r in large)) == (22, 22)
    assert "**22 of 22** wrong readings of 12 noises and more are named" in WORDS
    assert round(max(abs(r["moved"]) for r in large), 2) == 0.22
    far = sorted(abs(r["unbounded"]) for r in large if abs(r["unbounded"]) > slips.MOVED)
    assert len(far) == 9
    assert all(11 <= x < 13.1 for x in far[1:])
    assert "more than one sd in 9 of 22, in eight of these by 11 to 13" in WORDS
    assert not any(one["accused before"] for one in found["cases"])


def test_by_todays_rules_no_large_slip_goes_unnoticed() -> None:
    found = kept("slips-2")
    assert found["seed"] == int(found["commit"][:6], 16)
    numbers = {(one["kind"], one["number"]) for one in found["cases"]}
    assert numbers == {(kind, n) for kind in slips.KINDS for n in range(16)}
    assert slips.table(found["cases"]) == found["table"]
    large = [r for r in found["cases"] if r["off"] >= slips.NOTICED]
    assert (len(large), sum(r["named"] for r in large)) == (68, 61)
    assert all(r["exchanges"] == 1 for r in large if not r["named"])
    assert "in 61 of 68 the wrong reading is named, and the other seven are told as an" in WORDS
    assert all(r["right"] for r in found["cases"] if r["contradicted"]), "never a sound blade"
    assert not any(r["accused before"] or r["exchanges before"] for r in found["cases"])
    assert sum(r["exchanges"] - r["exchange told"] for r in found["cases"]) == 8
    (far,) = (r for r in large if abs(r["moved"]) > 1)
    assert [round(abs(far[when]), 1) for when in ("moved", "unbounded")] == [2.7, 0.7]
    every = found["table"]["all"]
    assert (every["unbounded, above 1 sd"], round(every["unbounded, most"], 1)) == (0.25, 5.8)
