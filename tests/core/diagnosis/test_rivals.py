"""A set that is not separable by design, and the inspections that split it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.calibration.online import Workspace, update
from core.calibration.state import RotorSpec
from core.diagnosis import conclude, rivals
from core.diagnosis.case import Case
from core.diagnosis.conclude import Turn
from core.diagnosis.diagnose import Diagnosis, diagnose
from core.diagnosis.grammar import Facts
from core.diagnosis.rivals import rivals_of, splitting
from core.diagnosis.separate import separation_json
from core.diagnosis.tell import to_json
from core.observation import Inspection
from tests.core.calibration.test_exact import SLOPES, conjugate
from tests.core.diagnosis.fleet import READING

MODEL, SIGMA, BLADES = conjugate(2), 0.15, 10
SPEC = RotorSpec("r", tuple(f"b{b}" for b in range(BLADES)), particles=1600, seed=3)


def confounded() -> list[Inspection]:
    """The second campaign, 0.6 too long, was the only one that instrument g2 read."""
    rng = np.random.default_rng(11)
    found = []
    for b in range(BLADES):
        local = np.array([-1.0, 0.0]) + 0.6 * rng.normal(size=2)
        for k, t in enumerate((0.5, 1.0, 1.5)):
            y = 1.6 + SLOPES[0] * local[0] + SLOPES[1] * t * local[1] + SIGMA * rng.normal()
            found.append(
                Inspection(f"{b}-{k}", f"b{b}", "y", t, np.array([y + 0.6 * (k == 1)]), sigma=SIGMA,
                           campaign=f"c{k}", instrument="g2" if k == 1 else "g1")
            )  # fmt: skip
    return found


@pytest.fixture(scope="module")
def torn() -> tuple[Diagnosis, Case, Workspace]:
    data, work = confounded(), Workspace()
    families = [f for f in READING if f.name in ("instrument offset", "campaign offset")]
    case = Case(SPEC, tuple(data), {b: Facts() for b in SPEC.blades}, families)
    state = update(MODEL, SPEC, data, workspace=work)
    return diagnose(MODEL, state, case, workspace=work), case, work


def test_the_rivals_are_those_of_the_verdict_with_the_evidence_that_it_saw(
    torn: tuple[Diagnosis, Case, Workspace],
) -> None:
    found, case, work = torn
    assert found.verdict.word == "not separable"
    rivals = rivals_of(found, case, work)
    assert {n for r in rivals for n in r.names} == set(found.verdict.names)
    assert len(rivals) == len(found.verdict.names) == 3
    base = found.before[1].meta["log_evidence"]
    seen = {tuple(c.name for c in cells): gained for cells, gained in found.tried}
    for one in rivals:
        gained = one.state.meta["log_evidence"] - base
        assert gained == pytest.approx(seen[one.names], abs=1e-6)


def test_what_was_calibrated_is_told_with_its_course_for_one_name_may_have_several(
    torn: tuple[Diagnosis, Case, Workspace],
) -> None:
    found, case, _ = torn
    told = to_json(found, case)["calibrated"]
    every = [tuple((e["name"], e["shape"], e["step_h"]) for e in one["effects"]) for one in told]
    assert len(set(every)) == len(every), "no two read alike"
    assert [[name for name, _, _ in one] for one in every] == [one["names"] for one in told]


def test_a_rival_is_called_as_the_verdict_has_it(
    torn: tuple[Diagnosis, Case, Workspace], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By its cause, where how this runs is open."""
    found, case, work = torn
    cause = lambda self, name: "zero" if name.startswith("instrument") else name  # noqa: E731
    monkeypatch.setattr(Turn, "called", cause)
    names = ("zero", *(n for n in found.verdict.names if n.startswith("campaign")))
    other = replace(found, verdict=replace(found.verdict, names=names))
    called = {one.names: one.called for one in rivals_of(other, case, work)}
    assert set().union(*called.values()) == set(names)
    assert called["instrument offset (instrument g2)",] == ("zero",)


def test_the_suspect_instrument_reads_again_and_then_another_one(
    torn: tuple[Diagnosis, Case, Workspace],
) -> None:
    """A reading by g2 tells its own offset from the campaign's; g1's takes an instrument more."""
    found, case, work = torn
    steps: list[str] = []
    split = splitting(found, case, work, steps.append)
    everybody = ["what y of all blades would tell"] * 6  # by three readers, now and later
    assert steps[-7:] == ["what one reading would tell", *everybody]
    assert split is not None
    told = separation_json(split)
    assert all(r["called"] == r["names"] for r in told["rivals"])
    best = {one["instrument"]: one for one in reversed(told["single"])}
    assert told["single"][0]["instrument"] == "g2"
    assert best["g2"]["gain_nat"] > 0.3
    assert best["g1"]["gain_nat"] < 0.02, "all rivals expect the same of the usual instrument"
    assert told["single"][0]["blades_alike"] == BLADES
    first, second, *_ = told["set"]
    assert {first["instrument"], second["instrument"]} == {"g2", "another"}
    assert second["share"] > first["share"] > max(r["weight"] for r in told["rivals"])
    whole = told["campaigns"][0]
    assert (whole["instrument"], whole["blades"]) == ("g2", BLADES)
    assert whole["gain_nat"] > told["single"][0]["gain_nat"]


def test_a_single_name_beside_a_sure_one_is_told_from_nothing_more(
    torn: tuple[Diagnosis, Case, Workspace], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sets that forecast stand for it: those of its hypotheses are one."""
    found, case, work = torn
    monkeypatch.setattr(rivals, "rivals_of", lambda found, *given: rivals_of(found, *given)[:1])
    assert splitting(found, case, work) is None
    sure = replace(found, verdict=replace(found.verdict, beside=found.verdict.names[:1]))
    split = splitting(sure, case, work)
    assert split is not None
    told = separation_json(split)["rivals"]
    each = [(tuple(c.name for c in one.effects), share) for one, share in found.rivals]
    assert [(tuple(r["names"]), r["weight"]) for r in told] == each
    assert len(each) > 1


def test_no_inspection_is_asked_of_a_blade_that_has_left(
    torn: tuple[Diagnosis, Case, Workspace],
) -> None:
    found, case, work = torn
    serving = ("b1", "b4")
    split = splitting(found, replace(case, serving=serving), work)
    assert split is not None
    assert {one.blade for one, _ in split.single} <= set(serving)
    assert {b for one, _ in split.campaigns for b, _ in one.blades} == set(serving)


def test_names_too_many_for_an_answer_are_told_apart_by_the_same_inspections(
    torn: tuple[Diagnosis, Case, Workspace], monkeypatch: pytest.MonkeyPatch
) -> None:
    """None of them is claimed; of what would be read the two weightiest stand for all."""
    found, case, work = torn
    monkeypatch.setattr(conclude, "MOST_NAMES", 2)
    other = diagnose(MODEL, found.before[1], case, workspace=work)
    assert other.verdict.word == "unattributed"
    assert other.verdict.names == ()
    assert sorted(other.verdict.several) == sorted(found.verdict.names)
    split, before = splitting(other, case, work), splitting(found, case, work)
    assert split is not None
    assert before is not None
    assert separation_json(split) == separation_json(before)
    monkeypatch.setattr(rivals, "MOST", 2)
    few = rivals_of(other, case, work)
    assert [one.names for one in few] == [one.names for one in before.rivals[:2]]
    monkeypatch.setattr(rivals, "MOST", 1)
    assert splitting(other, case, work) is None


def test_other_verdicts_have_nothing_to_split(torn: tuple[Diagnosis, Case, Workspace]) -> None:
    found, case, work = torn
    for word in ("adequate", "effect", "unattributed"):
        other = replace(found, verdict=replace(found.verdict, word=word))
        assert splitting(other, case, work) is None
