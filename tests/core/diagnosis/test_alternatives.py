"""What else the readings allow, against the exact answer of a network that is jointly Gaussian.

Every blade grows by a s(t) more than the model says, s linear, and three visits hardly tell that
from another course: each course has an exact evidence, and an exact forecast.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from core.calibration.online import RotorSpec, Workspace, update
from core.diagnosis.alternatives import LEAST, Alternatives, alternatives, shares
from core.diagnosis.case import Case
from core.diagnosis.conclude import Rival, Turn
from core.diagnosis.diagnose import Diagnosis, diagnose
from core.diagnosis.families import FAMILIES
from core.diagnosis.grammar import Cell, Facts
from core.diagnosis.hypotheses import Hypothesis
from core.family import Family
from core.model import Model
from core.observation import Inspection
from core.surrogate.formula import FormulaModel
from tests.core.calibration.test_exact import SLOPES, conjugate

HORIZON_H, TIMES, SIGMA, BLADES, SIZE = 4.0, (0.5, 1.0, 1.5), 0.2, 20, 1.5
GROWTH = Family(
    "growth", "blades grow longer than the model says", "reading", "y", "plus", SIZE, 0,
    ("early", "linear", "late"), ("all",), "blade", "physics",
)  # fmt: skip
SPEC = RotorSpec("r", tuple(f"b{b:02d}" for b in range(BLADES)), 1000, 3)


def growing() -> Model:
    base = conjugate(2)
    assert isinstance(base.surrogate, FormulaModel)
    answers = replace(base.surrogate, horizon_h=HORIZON_H, name="growing")
    return Model(replace(base.network, families=(GROWTH,)), answers)


MODEL = growing()


def readings(amplitude: float = 1.2) -> tuple[Inspection, ...]:
    rng = np.random.default_rng(8)
    found = []
    for b in range(BLADES):
        l0, l1 = rng.normal(-1.0, 0.6), rng.normal(0.0, 0.6)
        for k, t in enumerate(TIMES):
            y = 1.6 + SLOPES[0] * l0 + SLOPES[1] * t * l1 + amplitude * t / HORIZON_H
            value = np.array([y + SIGMA * rng.normal()])
            found.append(Inspection(f"{b}-{k}", f"b{b:02d}", "y", t, value, sigma=SIGMA))
    return tuple(found)


DATA = readings()


@pytest.fixture(scope="module")
def open_course() -> tuple[Diagnosis, Case]:
    work = Workspace()
    case = Case(SPEC, DATA, {b: Facts() for b in SPEC.blades})
    state = update(MODEL, SPEC, DATA, workspace=work)
    return diagnose(MODEL, state, case, workspace=work), case


def exact(course: str | None, blades: Sequence[str]) -> tuple[float, np.ndarray, np.ndarray]:
    """Log evidence, and means and sds of the blades at the horizon."""

    def row(blade: str, t: float) -> np.ndarray:
        out, b = np.zeros(2 + 2 * BLADES), int(blade[1:])
        out[0] = 0.8
        if course is not None:
            out[1] = Cell(GROWTH, course, "all", None, None, HORIZON_H).course.at(t)  # type: ignore[arg-type]
        out[2 + 2 * b : 4 + 2 * b] = SLOPES[0], SLOPES[1] * t
        return out

    mean = np.array([2.0, 0.0, *[-1.0, 0.0] * BLADES])
    prior = np.diag(np.array([0.5, SIZE, *[0.6] * (2 * BLADES)]) ** 2)
    x = np.array([row(r.blade, r.time_h) for r in DATA])
    off = np.array([r.values[0] for r in DATA]) - x @ mean
    spread = x @ prior @ x.T + SIGMA**2 * np.eye(len(DATA))
    gain = np.linalg.solve(spread, x @ prior).T
    evidence = -0.5 * (off @ np.linalg.solve(spread, off) + np.linalg.slogdet(spread)[1])
    ahead = np.array([row(b, HORIZON_H) for b in blades])
    covariance = ahead @ (prior - gain @ x @ prior) @ ahead.T
    return float(evidence), ahead @ (mean + gain @ off), np.sqrt(np.diag(covariance))


def test_courses_have_their_exact_shares_and_forecasts(open_course: tuple[Diagnosis, Case]) -> None:
    found, case = open_course
    assert (found.verdict.word, found.verdict.names) == ("effect", ("growth",))
    told = alternatives(found.before, found.rivals, case, "y", HORIZON_H)
    assert told is not None
    courses = [one.effects[0].shape for one in told.each]
    assert sorted(courses) == ["early", "late", "linear"]
    truth = {c: exact(c, SPEC.blades) for c in (*courses, None)}
    w = np.exp([truth[c][0] for c in courses] - np.max([truth[c][0] for c in courses]))
    w /= w.sum()
    assert min(w) > LEAST, "all of them are open"
    assert [one.share for one in told.each] == pytest.approx(w, abs=0.02)
    for one, course in zip(told.each, courses, strict=True):
        _, mean, sd = truth[course]
        of_a_blade = np.sqrt(np.mean(sd**2))
        assert one.mean == pytest.approx(mean.mean(), abs=0.1 * of_a_blade)
        assert one.sd == pytest.approx(of_a_blade, rel=0.06)
    every = np.array([truth[c][1] for c in courses])
    together = w @ every
    inside = w @ np.array([truth[c][2] ** 2 for c in courses])
    sd = np.sqrt(np.mean(inside + w @ (every - together) ** 2))
    assert told.together[0] == pytest.approx(together.mean(), abs=0.1 * sd)
    assert told.together[1] == pytest.approx(sd, rel=0.06)
    assert sd > 1.05 * np.sqrt(np.mean(inside)), "courses differ in what they foretell"
    assert told.before[0] == pytest.approx(truth[None][1].mean(), abs=0.1 * sd)


def test_forecasts_are_of_blades_that_are_on_the_rotor(
    open_course: tuple[Diagnosis, Case],
) -> None:
    found, case = open_course
    serving = ("b03", "b11")
    told = alternatives(found.before, found.rivals, replace(case, serving=serving), "y", HORIZON_H)
    assert isinstance(told, Alternatives)
    assert told.blades == serving
    means = [exact(one.effects[0].shape, serving)[1].mean() for one in told.each]
    assert [one.mean for one in told.each] == pytest.approx(means, abs=0.1)
    assert alternatives(found.before, found.rivals[:1], case, "y", HORIZON_H) is None


WEAR, SPALLED, FOULING, OFFSET = (
    next(f for f in FAMILIES if f.name == name)
    for name in ("coating wear", "coating spallation", "fouling", "campaign offset")
)
LINEAR, LATE = (Cell(WEAR, s, "coating_lot", "C2") for s in ("linear", "late"))  # type: ignore[arg-type]
STEP = Cell(SPALLED, "step", "coating_lot", "C2", 2e4)
GAS, ZERO = Cell(FOULING, "linear", "all"), Cell(OFFSET, "constant", "campaign", "c2")
PRICES = {LINEAR: 5.0, LATE: 5.0, STEP: 5.0 + np.log(2.0), GAS: 5.0, ZERO: 4.0}


def rival(gained: float, *effects: Cell) -> Rival:
    return Rival(effects, MODEL, lambda: pytest.fail("nobody looked at its particles"), gained)


KNOWN = (
    rival(30.0, LINEAR, ZERO), rival(30.0, STEP, ZERO), rival(20.0, LATE, ZERO),
    rival(30.0, GAS, ZERO), rival(40.0, LINEAR, GAS), rival(50.0, LINEAR), rival(15.0, ZERO),
)  # fmt: skip


def turn(cells: Sequence[Cell], weights: Sequence[float], took: Cell) -> Turn:
    hypotheses = tuple(
        Hypothesis((i,), (cell.name,), 9.0, w)
        for i, (cell, w) in enumerate(zip(cells, weights, strict=True))
    )
    return Turn(hypotheses, (took.name,), {}, tuple(cells))


def test_rivals_have_the_settled_causes_and_shares_of_evidence_and_prior() -> None:
    sure = [turn((ZERO,), (1.0,), ZERO), turn((LINEAR, STEP), (0.6, 0.4), LINEAR)]
    found = shares(KNOWN[0], KNOWN, sure, PRICES)
    assert [one.effects for one, _ in found] == [(LINEAR, ZERO), (STEP, ZERO)]
    assert [w for _, w in found] == pytest.approx([2 / 3, 1 / 3])


def test_where_the_cause_is_open_others_in_its_place_are_rivals_too() -> None:
    torn = [turn((ZERO,), (1.0,), ZERO), turn((LINEAR, GAS), (0.5, 0.5), LINEAR)]
    found = shares(KNOWN[0], KNOWN, torn, PRICES)
    assert [one.effects for one, _ in found] == [(LINEAR, ZERO), (GAS, ZERO), (STEP, ZERO)]
    assert [w for _, w in found] == pytest.approx([0.4, 0.4, 0.2])


def test_where_one_is_sure_and_another_open_it_may_be_the_sure_one_alone() -> None:
    """By its price, too: with nothing more in the model there is none to pay for it."""
    alone = (*KNOWN[:-1], rival(25.0, ZERO))
    torn = [turn((ZERO,), (1.0,), ZERO), turn((LINEAR, GAS), (0.5, 0.5), LINEAR)]
    found = shares(alone[0], alone, torn, PRICES)
    every = [(LINEAR, ZERO), (GAS, ZERO), (ZERO,), (STEP, ZERO)]
    assert [one.effects for one, _ in found] == every
    assert [w for _, w in found] == pytest.approx(np.array([2, 2, 2, 1]) / 7)
    both = [turn((ZERO,), (1.0,), ZERO), turn((LINEAR, STEP), (0.6, 0.4), LINEAR)]
    assert all(len(one.effects) == 2 for one, _ in shares(alone[0], alone, both, PRICES))
    neither = [turn((ZERO, GAS), (0.5, 0.5), ZERO), turn((LINEAR, GAS), (0.5, 0.5), LINEAR)]
    assert all(len(one.effects) == 2 for one, _ in shares(alone[0], alone, neither, PRICES))


def test_forecasts_are_of_whom_the_difference_concerns() -> None:
    from core.diagnosis.alternatives import _differing

    facts = {b: Facts(coating_lot="C2" if b in ("b1", "b3") else "C1") for b in ("b1", "b2", "b3")}
    assert _differing(KNOWN[:2], facts, ("b1", "b2")) == ("b1",), "b3 has left"
    assert _differing(KNOWN[2:4], facts, ("b1", "b2")) == ("b1", "b2"), "the gas is everybody's"
