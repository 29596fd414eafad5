"""How often a diagnosis gives the right name, a wrong one, or none: simulated rotors, all counted.

A verdict on one of the sets of `effect_sets` is

    right         the planted name, or its cause, alone; of what is outside: `unattributed` or
                  `adequate`; of a clean set: `adequate`; where no reading could tell: `not
                  separable`, with the planted name in the set
    in the set    `not separable`, with the planted name in the set
    silent        `unattributed` or `adequate`, where something is planted that has a name
    wrong         any other: a name that is not there

Where an effect is put into the model, both models are calibrated without a sixth of the readings
and predict these, and the fleet at the plan's horizon (`report`), where the truth is known.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from core.calibration.online import Workspace, update
from core.diagnosis.diagnose import Diagnosis, diagnose
from core.diagnosis.report import before_after
from core.diagnosis.verdict import Verdict
from core.errors import BladetwinError, InputError
from core.model import Model, rotor_blade_wide
from core.validation.effect_plans import plan as plan_of
from core.validation.effect_sets import ALIKE, CLEAN, CONDITIONS, NAMED, OUTSIDE, SIZE, Set, made
from core.validation.effect_sets import conditions as conditions_of
from core.validation.records import Record, code_digest, records


def judged(condition: str, truth: frozenset[str], verdict: Verdict) -> str:
    """Right, in the set, silent or wrong."""
    nothing = verdict.word in ("adequate", "unattributed")
    if condition in CLEAN:
        return "right" if verdict.word == "adequate" else "silent" if nothing else "wrong"
    if condition in OUTSIDE:
        return "right" if nothing else "wrong"
    if nothing:
        return "silent"
    if condition in ALIKE:
        told = verdict.word == "not separable" and truth & set(verdict.names)
        return "right" if told else "wrong"
    if verdict.word == "not separable":
        return "in the set" if truth & set(verdict.names) else "wrong"
    return "right" if len(verdict.names) == 1 and set(verdict.names) <= truth else "wrong"


@cache
def _model() -> Model:
    return rotor_blade_wide()


def one(
    condition: str,
    number: int,
    seed: int,
    particles: int,
    plan: str = "rotor-20",
    size: float = SIZE,
) -> Record:
    """The record of a set; one that cannot be calibrated counts as wrong, with its error."""
    start = time.process_time()
    found: Record = {"condition": condition, "number": number}
    given = made(plan_of(plan), condition, number, seed, particles, size)
    work, model = Workspace(), _model()
    try:
        state = update(model, given.case.spec, given.case.readings, workspace=work)
        told = diagnose(model, state, given.case, workspace=work)
        moved = compared(told, given, plan_of(plan).horizon_h, work) if told.effects else {}
    except BladetwinError as error:
        alarm = condition in CLEAN  # where nothing is, an error is no "adequate"
        return found | {"outcome": "wrong", "alarm": alarm, "error": str(error)}
    verdict = told.verdict
    return found | {
        "outcome": judged(condition, given.truth, verdict),
        "word": verdict.word,
        "alarm": told.first.word != "adequate",
        "names": list(verdict.names),
        "truth": sorted(given.truth),
        "p": verdict.p,
        "gained_nat": round(told.gained, 2),
        "effects": {e.cell.name: [round(e.mean, 5), round(e.sd, 5)] for e in told.effects},
        "reasons": list(verdict.reasons),
        "tried": [[" and ".join(names), round(gained, 2)] for names, gained in told.tried],
        "refused": {" and ".join(names): why[:200] for names, why in told.refused},
        **moved,
        "cpu_s": round(time.process_time() - start, 1),
    }


def compared(told: Diagnosis, given: Set, horizon_h: float, work: Workspace) -> dict[str, Any]:
    """Both models on readings that they did not use: as they were read, and without noise."""
    models, states = (told.before[0], told.after[0]), (told.before[1], told.after[1])
    horizon = horizon_h or max(r.time_h for r in given.case.readings)
    both = before_after(
        models,
        given.case.spec,
        given.case.readings,
        horizon,
        workspace=work,
        states=states,
    )
    exact = np.array([given.exact[name] for name in both.held])
    found: dict[str, Any] = {"held": len(both.held)}
    for when, scored, forecast in zip(
        ("before", "after"), (both.before, both.after), both.forecast, strict=True
    ):
        off = np.array(scored.means) - exact
        found[when] = {
            "rmse": round(scored.rmse, 5),
            "bias": round(scored.bias, 5),
            "exact_rmse": round(float(np.sqrt(np.mean(off**2))), 5),
            "exact_bias": round(float(np.mean(off)), 5),
            "log_score": round(scored.log_score, 4),
            "inside_95": round(scored.within_95, 4),
            "width_95": round(scored.width, 5),
        }
        if given.ahead:
            truth = float(np.mean([given.ahead[b] for b in given.case.spec.blades]))
            found[when]["forecast_error"] = round(forecast[0] / truth - 1.0, 5)
    return found


def table(records: Sequence[Record]) -> dict[str, Mapping[str, float]]:
    """By condition: sets, alarms, and each outcome as a share of all sets."""
    found: dict[str, Mapping[str, float]] = {}
    for condition in CONDITIONS:
        own = [r for r in records if r["condition"] == condition]
        if not own:
            continue
        shares = {
            what: sum(r["outcome"] == what for r in own) / len(own)
            for what in ("right", "in the set", "silent", "wrong")
        }
        alarms = sum(bool(r.get("alarm")) for r in own) / len(own)
        found[condition] = {"sets": len(own), "alarms": alarms, **shares}
    return found


def improvement(records: Sequence[Record]) -> dict[str, Mapping[str, float]]:
    """By condition, what an effect in the model changes on readings that neither model used.

    sets         with an effect in the model after, whether its name is settled or not
    rmse, bias   after over before, of predictions against readings without noise: rms over the
                 sets, and of the mean of the bias's sizes
    better       share of the sets whose log score is better after
    inside 95    share of the readings in their 95 % interval after
    forecast     error of the fleet's mean at the horizon after over before, means of its sizes,
                 where the plan has a horizon
    """
    found: dict[str, Mapping[str, float]] = {}
    for condition in CONDITIONS:
        own = [r for r in records if r["condition"] == condition and "after" in r]
        if not own:
            continue

        def ratio(what: str, own: Sequence[Record] = own) -> float:
            sizes = [[abs(r[when][what]) for when in ("before", "after")] for r in own]
            before, after = np.mean(sizes, axis=0)
            return float(after / before)

        squares = [[r[when]["exact_rmse"] ** 2 for when in ("before", "after")] for r in own]
        rms = np.sqrt(np.mean(squares, axis=0))
        held = sum(r["held"] for r in own)
        found[condition] = {
            "sets": len(own),
            "rmse": float(rms[1] / rms[0]),
            "bias": ratio("exact_bias"),
            "better": sum(r["after"]["log_score"] > r["before"]["log_score"] for r in own)
            / len(own),
            "inside 95": sum(r["held"] * r["after"]["inside_95"] for r in own) / held,
        } | ({"forecast": ratio("forecast_error")} if "forecast_error" in own[0]["after"] else {})
    return found


def run(
    conditions: Mapping[str, int],
    *,
    seed: int,
    particles: int,
    processes: int = 1,
    plan: str = "rotor-20",
    size: float = SIZE,
    folder: str | Path | None = None,
    commit: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Record]:
    """All sets of the conditions, by name and number of sets; `folder` as in `coverage.run`."""
    possible = conditions_of(plan_of(plan))
    unknown = sorted(set(conditions) - set(possible))
    if unknown:
        raise InputError("conditions", unknown, "are unknown", f"use {', '.join(possible)}")
    file = None
    if folder is not None:
        text = repr((seed, particles, plan, size, commit, code_digest(), _model().digest))
        file = Path(folder) / f"effects-{sha256(text.encode()).hexdigest()[:12]}.jsonl"
    calls = {
        (condition, n): (condition, n, seed, particles, plan, size)
        for n in range(max(conditions.values()))  # by number: a cut study holds some of each
        for condition, count in conditions.items()
        if n < count
    }
    return records(
        calls,
        one,
        lambda record: (str(record["condition"]), int(record["number"])),
        file=file,
        processes=processes,
        progress=progress,
    )


def model_digest() -> str:
    """Of the model that is diagnosed."""
    return _model().digest


def marks(found: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """What is asked of such a loop, over all sets of a kind, as shares.

    alarms on clean sets (at a nominal 5 %); of effects that have a name: alarms, the right one, a
    wrong one; of those outside of the grammar: no name
    """

    def mean(kinds: Sequence[str], *what: str) -> float:
        own = [found[k] for k in kinds if k in found]
        total = sum(one["sets"] for one in own)
        return sum(one["sets"] * one[w] for one in own for w in what) / total if total else np.nan

    return {
        "clean, alarms": mean(CLEAN, "alarms"),
        "named, alarms": mean(NAMED, "alarms"),
        "named, right": mean(NAMED, "right"),
        "named, right or in the set": mean(NAMED, "right", "in the set"),
        "named, wrong": mean(NAMED, "wrong"),
        "alike, not separable": mean(ALIKE, "right"),
        "outside, no name": mean(OUTSIDE, "right"),
    }
