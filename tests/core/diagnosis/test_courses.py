"""Where a cause's course in time is open two of them are in the model; held against exact answers.

A gauge reads too much by something that grows, in a course between a root and a line of time, and
the two families that might be it are just these. All is linear and normal, so that evidence and
forecasts with either course and with both are known exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from core.calibration.online import update
from core.calibration.start import Start
from core.calibration.state import shared_posterior
from core.diagnosis import Case, Diagnosis, Facts, diagnose
from core.diagnosis.adopt import amplitude
from core.diagnosis.conclude import Rival
from core.diagnosis.courses import AGAINST, OPEN, other_course, with_both
from core.diagnosis.grammar import Cell
from core.family import Family
from core.model import Model
from core.observation import Inspection
from core.surrogate.formula import FormulaModel
from tests.core.calibration.test_exact import SLOPES
from tests.core.diagnosis.test_diagnose import BLADES, MODEL, SIGMA, SPEC, readings

SIZE = 0.3
RISE = Family(
    "rise", "a gauge reads ever more", "reading", "y", "plus", SIZE, 0, ("linear",),
    ("instrument",), "blade", "sensor", "growth",
)  # fmt: skip
SETTLE = replace(RISE, name="settling", shapes=("early",))
CAUSE = "growth (instrument gauge 0)"


SEED = 7  # of eight that were looked at, one whose course is open
SETS = 300  # simulated


def grown(share: float, b: int, t: float) -> float:
    """In the readings of one gauge, as `readings` shares them out: `share` of it a line."""
    i = round(t / 0.4) - 1
    return 0.0 if (b + i) % 2 else 0.15 * (share * t + (1.0 - share) * float(np.sqrt(t)))


@cache
def told() -> tuple[Diagnosis, Case]:
    own = readings(lambda b, t: grown(0.5, b, t), SEED)
    data = tuple(
        replace(r, instrument="gauge 2")
        if r.instrument == "gauge 1" and int(r.blade[1:]) % 4 < 2
        else r
        for r in own  # of two gauges either might read too much or the other too little
    )
    case = Case(SPEC, data, {b: Facts() for b in SPEC.blades}, (RISE, SETTLE), dealt=199)
    assert isinstance(MODEL.surrogate, FormulaModel)
    short = replace(MODEL.surrogate, name="short", horizon_h=4.0)
    model = Model(replace(MODEL.network, families=(RISE, SETTLE)), short)
    return diagnose(model, update(model, SPEC, data), case), case


@cache
def normal(
    read: tuple[tuple[int, float, bool], ...], cells: tuple[Cell, ...]
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray, np.ndarray]:
    """Mean and covariance of readings by blade, hour and whether the gauge is that of the cells;
    log determinant of 2π times that; what a reading moves all amplitudes by, and their covariance.
    """
    sizes = [SIZE**2] * len(cells)
    prior = np.diag([0.25, *sizes, *[0.36] * (2 * BLADES)])
    mean = np.array([2.0, *[0.0] * len(cells), *[-1.0, 0.0] * BLADES])
    x = np.zeros((len(read), len(mean)))
    k = len(cells)
    for row, (b, hour, off) in enumerate(read):
        x[row, 0] = 0.8
        if off:
            x[row, 1 : 1 + k] = [float(c.course.at(hour)) for c in cells]
        x[row, 1 + k + 2 * b : 3 + k + 2 * b] = SLOPES[0], SLOPES[1] * hour
    covariance = x @ prior @ x.T + SIGMA**2 * np.eye(len(read))
    gain = prior @ x.T @ np.linalg.inv(covariance)
    after = prior - gain @ x @ prior
    _, logdet = np.linalg.slogdet(2 * np.pi * covariance)
    return x @ mean, covariance, float(logdet), gain, after


def exact(
    data: Sequence[Inspection], cells: Sequence[Cell]
) -> tuple[float, np.ndarray, np.ndarray]:
    """Log evidence, and the amplitudes' mean and covariance; all else integrated out."""
    read = tuple((int(r.blade[1:]), r.time_h, r.instrument == "gauge 0") for r in data)
    expected, covariance, logdet, gain, after = normal(read, tuple(cells))
    k = len(cells)
    y = np.array([r.values[0] for r in data]) - expected
    evidence = -0.5 * (logdet + y @ np.linalg.solve(covariance, y))
    return float(evidence), (gain @ y)[1 : 1 + k], after[1 : 1 + k, 1 : 1 + k]


def test_both_are_in_the_model_with_the_exact_evidence_and_forecast() -> None:
    found, case = told()
    assert (found.verdict.word, found.verdict.names) == ("effect", (CAUSE,))
    cells = [e.cell for e in found.effects]
    assert {c.name.split(" (")[0] for c in cells} == {"rise", "settling"}
    evidence, mean, covariance = exact(case.readings, cells)
    nothing = exact(case.readings, [])[0]
    assert found.gained == pytest.approx(evidence - nothing, abs=0.1)
    alone = [exact(case.readings, [c])[0] - nothing for c in cells]
    assert found.gained > max(alone) - AGAINST
    shares = [share for _, share in found.rivals]
    assert min(shares) > OPEN
    later = np.array([c.course.at(4.0) for c in cells])
    names = [amplitude(c, found.before[0].network)[0] for c in cells]
    held = shared_posterior(found.after[1].meta, found.after[1].arrays.__getitem__)
    a = np.stack([held.column(name) for name in names], axis=1) @ later
    w = held.particles.w
    middle = float(w @ a)
    assert middle == pytest.approx(float(mean @ later), abs=0.01)
    sd = float(np.sqrt(w @ (a - middle) ** 2))
    assert sd == pytest.approx(float(np.sqrt(later @ covariance @ later)), rel=0.1)
    assert f"they gain {found.gained:.1f} nat" in found.verdict.reasons[-1]


@pytest.mark.parametrize(("pure", "one_off", "both_off"), [(False, 2.7, 0.9), (True, 3.4, 1.25)])
def test_forecasts_by_both_are_as_sure_as_they_are_right_and_by_one_are_not(
    *, pure: bool, one_off: float, both_off: float
) -> None:
    """Every simulated set whose course is open; the truth is any share of the two, or one of them,
    where the better one is the wrong one in nearly half of the sets; all exact."""
    cells = [Cell(f, f.shapes[0], "instrument", "gauge 0", None, 4.0) for f in (RISE, SETTLE)]
    rng, off = np.random.default_rng(1), []
    for k in range(SETS):
        share = round(rng.random()) if pure else rng.random()
        data = readings(lambda b, t, share=share: grown(share, b, t), 100 + k)  # type: ignore[misc]
        every = [exact(data, chosen) for chosen in ([cells[0]], [cells[1]], cells)]
        better = int(every[1][0] > every[0][0])
        less = abs(every[1][0] - every[0][0])
        if 1.0 / (1.0 + np.exp(less)) < OPEN or every[2][0] < every[better][0] - AGAINST:
            continue
        truth = 0.15 * (share * 4.0 + (1.0 - share) * 2.0)
        row = []
        for which, chosen in ((better, [cells[better]]), (2, cells)):
            later = np.array([c.course.at(4.0) for c in chosen])
            _, mean, covariance = every[which]
            row.append((mean @ later - truth, np.sqrt(later @ covariance @ later)))
        off.append(row)
    error, sd = np.moveaxis(np.array(off), 2, 0)
    one, both = np.sqrt(np.mean((error / sd) ** 2, axis=0))
    assert len(off) > 0.8 * SETS
    assert both == pytest.approx(both_off, abs=0.15), "sds that a forecast by both is off"
    assert one == pytest.approx(one_off, abs=0.3)
    rms = np.sqrt(np.mean(error**2, axis=0))
    assert rms[1] < rms[0], "it is nearer, too"


CELLS = {
    name: Cell(replace(RISE, name=name, cause=cause), "linear", "instrument", "g")
    for name, cause in (("a", "x"), ("b", "x"), ("c", "y"), ("d", "x"))
}
CELLS["early a"] = replace(CELLS["a"], shape="early")  # of the same name
X = "x (instrument g)"


def rival(*names: str, gained: float = 9.0) -> Rival:
    return Rival(tuple(CELLS[n] for n in names), cast(Any, None), lambda: cast(Any, None), gained)


@pytest.mark.parametrize(
    ("rivals", "causes", "other"),
    [
        ((("a", 0.5), ("b", 0.3), ("d", 0.2)), {X}, "b"),
        ((("c", 0.5), ("a", 0.3), ("d", 0.2)), {X}, "d"),
        ((("a", 0.91), ("b", 0.09)), {X}, None),
        ((("a", 0.5), ("b", 0.5)), {"a (instrument g)"}, None),
        ((("a", 1.0),), {X}, None),
        ((("early a", 0.5), ("a", 0.5)), {X}, None),
        ((("early a", 0.5), ("a", 0.3), ("d", 0.2)), {X}, "d"),
    ],
)
def test_the_other_course_is_the_weightiest_of_the_claimed_cause(
    rivals: tuple[tuple[str, float], ...], causes: set[str], other: str | None
) -> None:
    given = [(rival(name), share) for name, share in rivals]
    found = other_course(rival("a"), given, causes)
    assert (found and found[1].family.name) == other
    beside = other_course(rival("a", "c"), [(rival("c", "b"), 0.4)], {X})
    assert beside is not None
    assert (beside[1], beside[2]) == (CELLS["b"], CELLS["a"])


@pytest.mark.parametrize(
    ("made", "leaning", "kept"),
    [
        (rival("a", "b", gained=9.5), None, True),
        (rival("a", "b", gained=9.1 - AGAINST), None, True),
        (rival("a", "b", gained=8.9 - AGAINST), None, False),
        (rival("a", "b", gained=9.5), "b", False),
        (None, None, False),
    ],
)
def test_both_stay_if_the_evidence_and_the_room_are_there(
    made: Rival | None, leaning: str | None, *, kept: bool
) -> None:
    search = cast(Any, SimpleNamespace(calibrated=lambda effects, start: made))
    told = with_both(
        search,
        rival("a"),
        [(rival("a"), 0.6), (rival("b"), 0.4)],
        {X},
        lambda cell, _: "leans" if cell.family.name == leaning else None,
    )
    assert (told is not None) == kept
    if told is not None:
        assert made is not None
        assert told[0] is made
        assert f"they gain {made.gained:.1f} nat, a (instrument g) alone 9.0" in told[1]


def test_the_posterior_with_both_lies_where_it_is_expected() -> None:
    """Exact moments of both, held against the line between those of each alone."""
    found, case = told()
    cells = [e.cell for e in found.effects]
    _, mean, covariance = exact(case.readings, cells)
    ends = []
    for k, name in enumerate("ab"):
        _, m, c = exact(case.readings, [cells[k]])
        ends.append(Start((name,), m, c))
    line = ends[0].between(ends[1])
    off = mean - line.mean
    assert off @ np.linalg.solve(line.covariance, off) < 4.0
    spread = np.linalg.eigvals(np.linalg.solve(line.covariance, covariance)).real
    assert np.all(spread < 16.0), "no direction is missed by more than four sds"
