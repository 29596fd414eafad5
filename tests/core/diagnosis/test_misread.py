"""What a single reading carries is no effect of its blade, and is told in words."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
import pytest

from core.diagnosis.bayes import one_by_one
from core.diagnosis.grammar import Cell, Facts
from core.diagnosis.left_out import left_out
from core.diagnosis.misread import Spared, copied, slips, spared, understated
from core.diagnosis.scan import Scan
from core.diagnosis.scores import Scores
from core.diagnosis.signature import signatures
from core.diagnosis.verdict import judge
from core.observation import Inspection
from tests.core.diagnosis import fleet
from tests.core.diagnosis.fleet import READING, SIGMA, rotor, scan

DEALT, SETS = 99, 60
SIX = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5)

RUB = ("tip rub (blade b05)",)


def last(b: int, k: int) -> float:
    """One blade's last reading is short by thirty noises."""
    return -30 * SIGMA * (b == 5) * (k == 2)


def lasting(b: int, k: int) -> float:
    """The same blade is short from its third reading on."""
    return -40 * SIGMA * (b == 5) * (k >= 2)


def blind(monkeypatch: pytest.MonkeyPatch) -> None:
    """Effects of one blade count by all readings."""
    monkeypatch.setattr(Spared, "least", lambda self, gains, *rest: gains)


@pytest.mark.parametrize("pulled", [False, True])
def test_a_cell_without_a_reading_is_that_of_the_other_rows(pulled: bool) -> None:
    """Against scores and informations of rows that were never there."""
    seen, _ = rotor(4)
    rng = np.random.default_rng(1)
    g, h = np.zeros((2, *seen.q.shape, 2))
    g[3, :, 0], g[7, :, 1] = rng.normal(size=(2, 3))
    h[3, :, 0], h[7, :, 1] = rng.normal(size=(2, 3))
    spared = Spared.of(seen, g, h, np.ones(2, bool))
    u = np.einsum("bic,bi->c", g, seen.q) + pulled * h.sum(axis=(0, 1))
    information = np.einsum("bic,bij,bjc->c", g, seen.information, g)
    one, none = np.ones(2), np.zeros(2, dtype=np.int64)
    got = spared.least(np.full(2, np.inf), u, seen.q, information, one, none, pulled)
    for c, b in enumerate((3, 7)):
        covariance = np.linalg.inv(seen.information[b])
        off = covariance @ seen.q[b]
        gains = []
        for i in range(3):
            rest = np.arange(3) != i
            q = np.linalg.inv(covariance[np.ix_(rest, rest)])
            own, pull = g[b, rest, c], pulled * h[b, rest, c].sum()
            score, known = own @ q @ off[rest] + pull, own @ q @ own
            gains += one_by_one(np.array([score]), np.array([known]), one[:1], none[:1]).tolist()
        assert got[c] == pytest.approx(min(gains), abs=1e-9)


def test_shapes_of_many_nodes_are_no_slip_of_one_value() -> None:
    seen, _ = rotor(4)
    wide = tuple(
        replace(rows, readings=tuple(replace(r, values=np.zeros(6)) for r in rows.readings))
        for rows in seen.rows
    )
    g = np.zeros((*seen.q.shape, 1))
    g[3, :, 0] = 1.0
    spared = Spared.of(replace(seen, rows=wide), g, g, np.ones(1, bool))
    assert len(spared.cell) == 0


def verdicts(add: Callable[[int, int], float]) -> list[tuple[str, tuple[str, ...]]]:
    found = [judge(scan(*rotor(seed, add)), seed, dealt=DEALT) for seed in range(5)]
    return [(one.word, one.names) for one in found]


def test_a_misread_value_is_no_rub_of_a_tip(monkeypatch: pytest.MonkeyPatch) -> None:
    assert {names for _, names in verdicts(last)} == {()}
    blind(monkeypatch)
    claimed = [names for _, names in verdicts(last)]
    assert claimed == [RUB] * 5, "the control: it would be claimed"


def again(
    seed: int, add: Callable[[int, int], float], blades: Iterable[int], read: dict[str, str]
) -> tuple[Scores, dict[str, Facts]]:
    """Some blades were read by somebody else, or on a day of their own, the second time."""
    seen, facts = rotor(seed, add)
    rows = list(seen.rows)
    for b in blades:
        readings = list(rows[b].readings)
        readings[1] = replace(readings[1], **read)  # type: ignore[arg-type]
        rows[b] = replace(rows[b], readings=tuple(readings))
    return replace(seen, rows=tuple(rows)), facts


def extra(add: Callable[[int, int], float], blades: Iterable[int], read: dict[str, str]) -> int:
    """Of five rotors, those in which who read these blades is suspected."""
    found = [judge(scan(*again(k, add, blades, read)), k, dealt=DEALT).names for k in range(5)]
    return sum(any("extra" in name for name in names) for names in found)


READ = ({"campaign": "extra"}, {"instrument": "extra"})


@pytest.mark.parametrize("read", READ)
def test_one_misread_value_is_no_zero_of_the_day_on_which_it_was_read(
    read: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    slip = lambda b, k: 10 * SIGMA * ((b, k) == (5, 1))  # noqa: E731
    assert extra(slip, (5,), read) == 0
    assert extra(lambda b, k: 6 * SIGMA * (3 <= b < 8 and k == 1), range(3, 8), read) == 5, "many"
    blind(monkeypatch)
    assert extra(slip, (5,), read) == 5, "the control: it would be claimed"


def test_what_is_spared_is_of_one_blade_of_few_readers_or_of_a_lot_that_one_was_read_of() -> None:
    """A lot of several blades is not, though a few of them have its information."""
    seen, facts = again(0, lambda b, k: 0.0, (5,), READ[0])
    family = replace(READING[0], name="sag", whom=("lot",), kind="material", clock="blade")
    every = [Cell(family, "constant", "lot", "L1"), Cell(family, "constant", "lot", "own")]
    every += [Cell(READING[0], "constant", "blade", "b01"), Cell(READING[0], "constant", "all")]
    day = next(f for f in READING if f.name == "campaign offset")
    every += [Cell(day, "constant", "campaign", name) for name in ("c0", "extra")]
    facts = facts | {"b02": Facts("own")}
    g = signatures(fleet.MODEL, seen, every, facts, {"y": SIGMA}).g
    own = np.tile(np.r_[1.0, np.full(23, 1e-3)][:, None], (1, len(every)))
    assert spared(every, g, own).tolist() == [False, True, True, False, True, True]
    assert spared(every, g, np.ones_like(own)).tolist() == [False, True, True, False, False, True]


def test_one_misread_value_is_no_fault_of_the_instrument_that_read_all_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One reading of one blade is by another instrument than its others: which of both is off?"""

    def named() -> int:
        count = 0
        for seed in range(4):
            seen, facts = rotor(seed, lambda b, k: 10 * SIGMA * ((b, k) == (5, 1)))
            who = [["extra" if (b, k) == (5, 1) else "g" for k in range(3)] for b in range(24)]
            rows = tuple(
                replace(
                    own,
                    readings=tuple(
                        replace(r, instrument=i) for r, i in zip(own.readings, names, strict=True)
                    ),
                )
                for own, names in zip(seen.rows, who, strict=True)
            )
            found = judge(scan(replace(seen, rows=rows), facts), seed, dealt=DEALT)
            count += any("(instrument " in name for name in found.names)
        return count

    assert named() == 0
    blind(monkeypatch)
    assert named() > 0, "the control"


def test_beside_an_effect_that_is_there_a_misread_value_makes_no_pair(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The third campaign reads too long, and the one value of another one is wrong."""
    both = lambda b, k: 4 * SIGMA * (k == 2) + 10 * SIGMA * ((b, k) == (5, 1))  # noqa: E731

    def more() -> float:
        one = scan(*again(0, both, (5,), READ[0]))
        there, wrong = (
            next(i for i, c in enumerate(one.cells) if (c.whom, c.value) == ("campaign", value))
            for value in ("c2", "extra")
        )
        return one.gain(there, wrong) - float(one.gains[there])

    assert more() < 3.0
    blind(monkeypatch)
    assert more() > 6.0, "the control"


def test_what_several_readings_carry_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fleet, "TIMES", SIX)
    assert verdicts(lasting) == [("effect", RUB)] * 5


def alarms_of_one_blade() -> int:
    """Of clean rotors with heavy tails, those in which a blade alone raises the alarm."""
    count = 0
    for seed in range(SETS):
        one: Scan = scan(*rotor(seed, noise="heavy"))
        verdict = judge(one, seed, dealt=DEALT)
        count += any("blade" in name for name in verdict.names)
    return count


def test_heavy_tails_are_no_effect_of_a_blade(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fleet, "TIMES", SIX)
    assert alarms_of_one_blade() == 0
    blind(monkeypatch)
    assert alarms_of_one_blade() > 0, "the control"


def test_a_reading_far_from_all_others_is_told() -> None:
    told = slips(left_out(rotor(3, last)[0]))
    assert len(told) == 1
    assert "5-2 (blade b05, 2 h, -" in told[0]
    assert " sd)" in told[0]
    assert slips(left_out(rotor(3)[0])) == ()


def test_of_many_far_readings_the_farthest_are_told_and_the_rest_counted() -> None:
    told = slips(left_out(rotor(3, lambda b, k: (20 + b) * SIGMA * (k == b % 3) * (b < 9))[0]))
    assert "more;" in told[0]
    assert told[0].count("(blade ") == 5


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ([0.31] * 16, "elongation is 0.31 in 16 of 16 blades in campaign c: copied"),
        ([0.31] * 8 + [0.3 + 0.01 * k for k in range(2, 10)], "elongation is 0.31 in 8 of 16"),
        ([0.31] * 8 + [0.3 + 0.01 * k for k in range(2, 11)], None),  # less than half
        ([0.31] * 7, None),  # of a few blades it may be so
        ([0.3 + 0.01 * (k // 2) for k in range(16)], None),
    ],
)
def test_one_value_of_half_of_the_blades_at_a_visit_is_told(
    values: list[float], told: str | None
) -> None:
    """Blades of other ages have other hours; a second visit is another one."""
    data = [
        Inspection(f"{c}{b}", f"B{b}", "elongation", 8e3 + 500.0 * b, [v + more * b], campaign=c)
        for c, more in (("c", 0.0), ("d", 0.001))
        for b, v in enumerate(values)
    ]
    found = copied(data)
    assert len(found) == (told is not None)
    assert told is None or found[0].startswith(told)
    again = copied([replace(one, campaign=None, time_h=9e3) for one in data if one.id[0] == "c"])
    assert [one.replace("at 9,000 h", "in campaign c") for one in again] == list(found)


def test_a_sigma_that_is_stated_too_small_is_told_with_how_much() -> None:
    """Three stated sigmas more in every reading: √10 of what is stated, by a robust scale."""
    rng = np.random.default_rng(9)
    seen, _ = rotor(0, lambda b, k: 3 * SIGMA * float(rng.normal()))
    (told,) = understated(left_out(seen))
    assert told.startswith("72 readings of y lie ")
    assert float(told.split(" lie ")[1].split()[0]) == pytest.approx(np.sqrt(10), rel=0.25)
    assert f"as their stated sigma has it ({SIGMA:.3g})" in told


def test_sound_readings_are_as_far_as_they_say_and_who_states_nothing_is_not_asked() -> None:
    for seed in range(40):
        wild = lambda b, k: 50 * SIGMA * (b == k == 1)  # noqa: E731
        assert understated(left_out(rotor(seed, wild)[0])) == ()
    rng = np.random.default_rng(9)
    read = left_out(rotor(0, lambda b, k: 3 * SIGMA * float(rng.normal()))[0])
    assert understated(read)
    silent = tuple(replace(one, sigma=None) for one in read.readings)
    assert understated(replace(read, readings=silent)) == ()


def test_the_gauge_whose_sigma_is_too_small_is_named() -> None:
    rng = np.random.default_rng(9)
    seen, _ = rotor(0, lambda b, k: 6 * SIGMA * float(rng.normal()) * (b % 2))
    read = left_out(seen)
    own = tuple(replace(r, instrument=f"gauge {int(r.blade[1:]) % 2}") for r in read.readings)
    (told,) = understated(replace(read, readings=own))
    assert told.startswith("36 readings of y by gauge 1 lie ")
