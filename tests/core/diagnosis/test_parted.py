"""Large amplitudes in halves, against the exact posterior of each half."""

from __future__ import annotations

from dataclasses import replace

import pytest

from core.calibration.online import Workspace, update
from core.diagnosis import Case, Facts
from core.diagnosis import case as module
from core.diagnosis.adopt import with_effects
from core.diagnosis.conclude import Rival
from core.diagnosis.grammar import Cell
from core.diagnosis.parted import BLADES, HOURS, parted, parts
from core.diagnosis.verdict import WIDE, Held
from tests.core.diagnosis.test_diagnose import BEND, MODEL, SPEC, exact_bend, readings

CELL = Cell(BEND, "constant", "all")
LARGE = 1.6  # more than WIDE times the expected 0.3
assert WIDE * BEND.size < LARGE  # type: ignore[operator]
BENT = with_effects(MODEL, [CELL], {}, {})


def held(odd: float, even: float) -> tuple[Held, ...]:
    """Of blades that are bent by `odd` and `even`."""
    data = readings(lambda b, t: (odd if b % 2 else even) * t**2)
    case, work = Case(SPEC, data, {b: Facts() for b in SPEC.blades}), Workspace()
    sound = update(MODEL, SPEC, data, workspace=work)
    state = update(BENT, SPEC, data, workspace=work)
    return case.halves(MODEL, sound, Rival((CELL,), BENT, lambda: state, 0.0))


@pytest.mark.parametrize("by", [BLADES, HOURS])
def test_each_half_has_the_amplitude_of_its_own_exact_posterior(by: str) -> None:
    data = readings(lambda b, t: LARGE * t**2)
    found = parted(BENT, SPEC, data, "bend", 0.0, 0.3, by)
    told = [exact_bend(tuple(part)) for part in parts(data, by)]
    for amplitude, (mean, sd) in zip(found.amplitudes, told, strict=True):
        assert 0.3 * amplitude == pytest.approx(mean, abs=0.15 * sd)
    both = sum(sd**2 for _, sd in told) ** 0.5
    assert 0.3 * found.sd == pytest.approx(both, rel=0.1)


def test_a_large_amplitude_is_asked_of_each_half_and_one_that_is_not_common_does_not_hold(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[str] = []

    def counted(*given: object) -> Held:
        asked.append(str(given[-1]))
        return parted(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(module, "parted", counted)
    assert all(one.agrees for one in held(LARGE, LARGE))
    assert sorted(asked) == sorted([BLADES, HOURS])
    apart = {one.by: one for one in held(1.35, 1.85)}
    assert not apart[BLADES].agrees
    assert abs(apart[BLADES].amplitudes[0] - apart[BLADES].amplitudes[1]) * 0.3 > 0.4


def test_one_of_an_expected_size_is_not_calibrated_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "parted", lambda *given: pytest.fail("it is"))
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
