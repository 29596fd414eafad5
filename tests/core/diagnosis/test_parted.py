"""Large effects in halves, against the exact posterior and evidence of each half."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.special import ndtr

from core.calibration.online import RotorState, Workspace, update
from core.diagnosis import Case, Facts
from core.diagnosis.adopt import with_effects
from core.diagnosis.conclude import Rival
from core.diagnosis.grammar import Cell
from core.diagnosis.parted import BLADES, HOURS, Parted, parts
from core.diagnosis.verdict import CONFIRMED, WIDE, Held
from core.observation import Inspection
from tests.core.diagnosis.test_diagnose import BEND, MODEL, OFFSET, SPEC, exact_bend, readings

CELL = Cell(BEND, "constant", "all")
LARGE = 1.6  # more than WIDE times the expected 0.3
assert WIDE * BEND.size < LARGE  # type: ignore[operator]
BENT = with_effects(MODEL, [CELL], {}, {})
GAUGE = Cell(OFFSET, "constant", "instrument", "gauge 1")
FEW = replace(SPEC, blades=SPEC.blades[:8], particles=600)


@cache
def rotor_of(odd: float, even: float) -> tuple[Case, RotorState, Workspace]:
    """Half of the blades, bent by `odd` and `even`, and their state without a bend."""
    every = readings(lambda b, t: (odd if b % 2 else even) * t**2)
    data, work = tuple(r for r in every if r.blade in FEW.blades), Workspace()
    case = Case(FEW, data, {b: Facts() for b in FEW.blades})
    return case, update(MODEL, FEW, data, workspace=work), work


def held(odd: float, even: float, *others: Cell) -> tuple[Held, ...]:
    """Of blades that are bent by `odd` and `even`."""
    case, sound, work = rotor_of(odd, even)
    bent = with_effects(MODEL, [CELL, *others], case.facts, case.noise(MODEL, sound))
    state = update(bent, FEW, case.readings, workspace=work)
    return case.halves(MODEL, sound, Rival((CELL, *others), bent, lambda: state, 0.0))


def exact_gain(half: list[Inspection]) -> float:
    """Log evidence of a bend, uniform over 0 to 2, against none, all else integrated out.

    The likelihood of a bend b is that of none times exp((m² − (b − m)²) / 2 s²).
    """
    m, s = exact_bend(tuple(half))
    share = float(ndtr((2.0 - m) / s) - ndtr(-m / s))
    return m**2 / (2 * s**2) + float(np.log(0.5 * s * np.sqrt(2 * np.pi) * share))


@pytest.mark.parametrize("by", [BLADES, HOURS])
def test_each_half_has_the_amplitude_of_its_own_exact_posterior(by: str) -> None:
    data = readings(lambda b, t: LARGE * t**2)
    found = Parted(SPEC, data).amplitudes(BENT, "bent", "bend", 0.0, 0.3, by)
    assert (found.effect, found.by, found.alone) == ("bent", by, True)
    told = [exact_bend(tuple(part)) for part in parts(data, by)]
    for amplitude, (mean, sd) in zip(found.amplitudes, told, strict=True):
        assert 0.3 * amplitude == pytest.approx(mean, abs=0.15 * sd)
    both = sum(sd**2 for _, sd in told) ** 0.5
    assert 0.3 * found.sd == pytest.approx(both, rel=0.1)
    awake = Parted(SPEC, data).amplitudes(BENT, "bent", "bend", 0.06, 0.3, by)
    assert np.subtract(found.amplitudes, awake.amplitudes) == pytest.approx([0.2, 0.2])


@pytest.mark.parametrize("by", [BLADES, HOURS])
@pytest.mark.parametrize("size", [0.0, 0.2])
def test_each_half_gains_what_its_exact_evidence_says(by: str, size: float) -> None:
    data = readings(lambda b, t: size * t**2)
    gained = Parted(SPEC, data).gained(BENT, MODEL, by)
    exact = [exact_gain(part) for part in parts(data, by)]
    assert gained == pytest.approx(exact, abs=0.1)
    assert all(g < CONFIRMED for g in exact) is (size == 0.0)


def test_halves_end_where_what_their_case_heeds_raises() -> None:
    def heed() -> None:
        raise StopAsyncIteration

    data = tuple(readings(lambda b, t: 0.0))
    case = Case(SPEC, data, {}, workspace=Workspace(heed=heed))
    with pytest.raises(StopAsyncIteration):
        case.parted.halves(MODEL, BLADES)
    assert replace(case, workspace=None).parted.halves(MODEL, BLADES)


def test_a_large_amplitude_is_asked_of_each_half_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    amplitudes = Parted.amplitudes

    def counted(self: Parted, *given: object) -> Held:
        asked.append(str(given[-1]))
        return amplitudes(self, *given)  # type: ignore[arg-type]

    monkeypatch.setattr(Parted, "amplitudes", counted)
    monkeypatch.setattr(Parted, "gained", lambda *given: pytest.fail("amplitudes say enough"))
    assert all(one.agrees and one.stands and one.gained is None for one in held(LARGE, LARGE))
    assert sorted(asked) == sorted([BLADES, HOURS])


def test_what_is_in_both_halves_stands_and_varies_where_it_has_not_one_amplitude() -> None:
    apart = {one.by: one for one in held(1.35, 1.85)}
    assert not apart[BLADES].agrees
    assert abs(apart[BLADES].amplitudes[0] - apart[BLADES].amplitudes[1]) * 0.3 > 0.4
    assert apart[BLADES].gained is not None
    assert min(apart[BLADES].gained) > CONFIRMED
    assert apart[BLADES].stands
    assert apart[BLADES].varies


def test_what_only_one_half_has_does_not_stand_however_large() -> None:
    """The control: the half that has it gains hundreds of nats."""
    apart = {one.by: one for one in held(0.0, 5.0)}
    assert apart[BLADES].gained is not None
    assert max(apart[BLADES].gained) > 100
    assert min(apart[BLADES].gained) < CONFIRMED
    assert not apart[BLADES].stands


def test_beside_an_amplitude_that_varies_every_effect_has_to_be_in_each_half() -> None:
    """An offset that nobody made agrees with itself, and is found in neither half."""
    found = [one for one in held(1.35, 1.85, GAUGE) if one.effect == GAUGE.name]
    assert [one.agrees for one in found] == [True, True]
    assert not any(one.stands for one in found)
    quiet = [one for one in held(LARGE, LARGE, GAUGE) if one.effect == GAUGE.name]
    assert all(one.stands for one in quiet), "where none varies its amplitude says enough"


def test_one_of_an_expected_size_is_not_calibrated_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Parted, "amplitudes", lambda *given: pytest.fail("it is"))
    assert all(one.agrees for one in held(0.3, 0.3))


def test_halves_are_of_the_readings_of_whole_blades_or_of_hours() -> None:
    data = readings(lambda b, t: 0.0)
    first, second = parts(data, BLADES)
    assert {r.blade for r in first}.isdisjoint(r.blade for r in second)
    early, late = parts(data, HOURS)
    assert max(r.time_h for r in early) < min(r.time_h for r in late)
    moved = [replace(r, time_h=r.time_h + 7.0) for r in data]
    assert [[r.id for r in p] for p in parts(moved, HOURS)] == [
        [r.id for r in p] for p in (early, late)
    ]
