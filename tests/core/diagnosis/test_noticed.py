"""The size from which on an effect would have been noticed is the one from which on it is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from core.diagnosis import noticed as module
from core.diagnosis.noticed import NOTHING, PROBABILITY, Noticed, in_words, noticed, noticed_json
from tests.core.diagnosis import fleet
from tests.core.diagnosis.fleet import MODEL, SIGMA, rotor, scan

DEALT, ROTORS = 199, 12
OFFSETS = tuple(f for f in fleet.READING if f.name == "campaign offset")


def told(seed: int, noise: str = "normal") -> dict[str, Noticed]:
    found = noticed(scan(*rotor(seed, noise=noise)), {"y": SIGMA}, seed, DEALT)
    return {one.easiest.family.name: one for one in found}


def alarms(seed: int, add: Any, noise: str) -> bool:
    return scan(*rotor(1000 + seed, add, noise=noise)).chance(DEALT, seed) <= 0.05


def in_visit(cell: Any, size: float) -> Any:
    return lambda b, k: size * (f"c{k}" == cell.value)


def test_effects_of_the_told_size_alarm_in_nine_rotors_of_ten(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Told by one rotor, planted in the readings of another; the control is half as large. Noise
    is known here and all is linear, so that nothing is lost to a calibration.

    Where readings tell most of a campaign and where least, up and down, with normal noise and with
    heavy tails. 36 of 48 and fewer are 1 in 400 at nine of ten.
    """
    monkeypatch.setattr(fleet, "READING", OFFSETS)
    monkeypatch.setattr(module, "LEFT", 1.0)
    seen, half = [], []
    for seed, noise in ((seed, noise) for seed in range(ROTORS) for noise in ("normal", "heavy")):
        own = told(seed, noise)["campaign offset"]
        assert own.least is not None
        assert own.most is not None
        seen.append(alarms(seed, in_visit(own.easiest, own.least), noise))
        seen.append(alarms(seed, in_visit(own.hardest, -own.most), noise))
        half.append(alarms(seed, in_visit(own.easiest, 0.5 * own.least), noise))
    assert np.sum(seen) > 36
    assert np.mean(half) < 0.6


def test_easiest_and_hardest_are_what_readings_tell_most_and_least_of() -> None:
    one = told(3)
    offset, rub = one["campaign offset"], one["tip rub"]
    assert {offset.easiest.value, offset.hardest.value} <= {"c0", "c1", "c2"}
    for family in (offset, rub):
        assert family.least is not None
        assert family.most is None or family.most >= family.least
    again = told(3)
    assert again == one, "a function of readings and seed"


def test_twice_the_noise_hides_twice_the_offset(monkeypatch: pytest.MonkeyPatch) -> None:
    """An offset without a size of its own is expected in noises, and so is what is noticed."""
    monkeypatch.setattr(fleet, "READING", OFFSETS)
    small = [told(s)["campaign offset"].least for s in range(2)]
    monkeypatch.setattr(fleet, "SIGMA", 2 * SIGMA)
    wide = [noticed(scan(*rotor(s)), {"y": 2 * SIGMA}, s, DEALT)[-1].least for s in range(2)]
    ratio = np.median([b / a for a, b in zip(small, wide, strict=True) if a and b])
    assert 1.4 < ratio < 2.2


def test_what_one_blade_tells_is_nothing_to_rest_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its own parameters imitate everything; two dozen blades are the control."""
    many = tuple(told(0).values())
    assert in_words(many) == ()
    monkeypatch.setattr(fleet, "BLADES", 1)
    found = noticed(scan(*rotor(0)), {"y": SIGMA}, 0, DEALT)
    assert found
    assert [one.least for one in found] == [None] * len(found)
    assert in_words(found) == (NOTHING,)
    assert in_words(()) == (), "of effects of single blades nothing is asked"


def test_it_is_told_with_units_and_where() -> None:
    document = noticed_json(tuple(told(1).values()), MODEL)
    assert document["probability"] == PROBABILITY
    offset = next(one for one in document["families"] if one["family"] == "campaign offset")
    assert offset["of"] == "added to y"
    assert offset["unit"] == MODEL.network.quantity("y").unit
    assert offset["easiest"] in {"c0", "c1", "c2"}
    assert 0 < offset["least"] <= offset["most"]
