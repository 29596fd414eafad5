"""How often a diagnosis gives the right name, a wrong one, or none: simulated rotors, all counted.

A verdict on one of the sets of `effect_sets` is

    right         the planted name, or its cause, alone; of what is outside: `unattributed` or
                  `adequate`; of a clean set: `adequate`; where no reading could tell: `not
                  separable`, with the planted name in the set
    in the set    `not separable`, with the planted name in the set
    silent        `unattributed` or `adequate`, where something is planted that has a name
    wrong         any other: a name that is not there

and where two effects are planted

    right         the names of both, and no other; of what has no name: none
    one           that of one, alone or surely beside a set
    in the set    `not separable`, with one of the names in the set, none claimed
    silent, wrong as above

What an effect in the model changes is in `effect_gains`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from core.calibration.online import Workspace, update
from core.diagnosis.diagnose import diagnose
from core.diagnosis.verdict import Verdict
from core.errors import BladetwinError, InputError
from core.model import Model, rotor_blade_wide
from core.validation.effect_gains import compared, foretold
from core.validation.effect_plans import plan as plan_of
from core.validation.effect_sets import (
    ALIKE,
    CLEAN,
    CONDITIONS,
    NAMED,
    OUTSIDE,
    PAIRS,
    SIZE,
    made,
    pairs,
)
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


def judged_two(each: Sequence[frozenset[str]], verdict: Verdict) -> str:
    """The same where two effects are planted: `each` has the names of each that has any."""
    if verdict.word in ("adequate", "unattributed"):
        return "silent"
    claimed = set(verdict.names if verdict.word == "effect" else verdict.beside)
    there = frozenset[str]().union(*each)
    found = sum(bool(claimed & own) for own in each)
    if claimed - there or len(claimed) > found:
        return "wrong"
    if found == len(each):
        return "right"
    if found:
        return "one"
    return "in the set" if set(verdict.names) & there else "wrong"


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
        horizon_h, moved = plan_of(plan).horizon_h, dict[str, Any]()
        if told.effects:
            moved = compared(told, given, horizon_h, work)
        elif told.foretold:
            moved = foretold(told, given, horizon_h)
    except BladetwinError as error:
        alarm = condition in CLEAN  # where nothing is, an error is no "adequate"
        return found | {"outcome": "wrong", "alarm": alarm, "error": str(error)}
    verdict = told.verdict
    return found | {
        "outcome": judged_two(given.each, verdict)
        if condition in PAIRS
        else judged(condition, given.truth, verdict),
        "word": verdict.word,
        "alarm": told.first.word != "adequate",
        "names": list(verdict.names),
        **({"beside": list(verdict.beside)} if condition in PAIRS else {}),
        "truth": sorted(given.truth),
        "p": verdict.p,
        "gained_nat": round(told.gained, 2),
        "effects": {e.cell.name: [round(e.mean, 5), round(e.sd, 5)] for e in told.effects},
        "placebos": [[p.effect, p.by, p.count, p.won] for p in told.placebos],
        "reasons": list(verdict.reasons),
        "tried": [[" and ".join(c.name for c in cells), round(g, 2)] for cells, g in told.tried],
        "refused": {" and ".join(names): why[:200] for names, why in told.refused},
        **moved,
        "cpu_s": round(time.process_time() - start, 1),
    }


def table(records: Sequence[Record]) -> dict[str, Mapping[str, float]]:
    """By condition: sets, alarms, and each outcome as a share of all sets."""
    found: dict[str, Mapping[str, float]] = {}
    for condition in (*CONDITIONS, *PAIRS):
        own = [r for r in records if r["condition"] == condition]
        if not own:
            continue
        shares = {
            what: sum(r["outcome"] == what for r in own) / len(own)
            for what in (
                *("right", "in the set", "silent", "wrong"),
                *(["one"] * (condition in PAIRS)),
            )
        }
        alarms = sum(bool(r.get("alarm")) for r in own) / len(own)
        found[condition] = {"sets": len(own), "alarms": alarms, **shares}
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
    possible = (*conditions_of(plan_of(plan)), *pairs(plan_of(plan)))
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
    wrong one; of those outside of the grammar: no name. Kinds that were not asked for have none.

    >>> marks({"clean": {"sets": 4, "alarms": 0.25}})
    {'clean, alarms': 0.25}
    """

    asked: dict[str, tuple[Sequence[str], tuple[str, ...]]] = {
        "clean, alarms": (CLEAN, ("alarms",)),
        "named, alarms": (NAMED, ("alarms",)),
        "named, right": (NAMED, ("right",)),
        "named, right or in the set": (NAMED, ("right", "in the set")),
        "named, wrong": (NAMED, ("wrong",)),
        "alike, not separable": (ALIKE, ("right",)),
        "outside, no name": (OUTSIDE, ("right",)),
        "pairs, both": (PAIRS, ("right",)),
        "pairs, both or one": (PAIRS, ("right", "one")),
        "pairs, wrong": (PAIRS, ("wrong",)),
    }
    out: dict[str, float] = {}
    for mark, (kinds, what) in asked.items():
        own = [found[k] for k in kinds if k in found]
        if total := sum(one["sets"] for one in own):
            out[mark] = sum(one["sets"] * one[w] for one in own for w in what) / total
    return out
