"""How large an effect has to be until it is noticed: alarms over the effect's size.

    diagnosis  only its first question is asked, whether anything is missing at all, which takes a
               calibration and a scan; names are the business of `effects_study`
    residuals  the tests by which a rotor notices something by itself, before anybody asks
               (`core.diagnosis.omnibus`), which take a calibration a visit

A size is what the effect adds to
the concerned readings of the last visit, in noises (`effect_plans`); size 0 is the clean rotor, and
its alarms are false ones. Beside it stands what oracles would notice that know every parameter's
place (`effect_oracle`): one that knows what to look for, and one that searches the whole grammar.

Sizes that would need the effect, as it was run, scaled by more than `effect_plans.STRONGEST` are
left out.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from core.calibration.online import Workspace, update
from core.diagnosis.omnibus import omnibus
from core.diagnosis.residuals import residuals
from core.diagnosis.verdict import judge
from core.errors import BladetwinError, InputError
from core.model import Model, rotor_blade_wide
from core.validation.effect_oracle import by_rotor
from core.validation.effect_plans import Plan
from core.validation.effect_plans import plan as plan_of
from core.validation.effect_sets import CLEAN, NAMED, OUTSIDE, effect_of, made
from core.validation.effect_sets import conditions as conditions_of
from core.validation.records import Record, code_digest, records

SIZES = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0)
SOUND = CLEAN[0]
By = Literal["diagnosis", "residuals"]


@cache
def _model() -> Model:
    return rotor_blade_wide()


def one(
    condition: str,
    size: float,
    number: int,
    seed: int,
    particles: int,
    plan: str,
    by: By = "diagnosis",
) -> Record:
    """Whether a set alarms; one that cannot be calibrated counts against the diagnosis, as no alarm
    of an effect and as a false one of a clean set, and is kept with its error.

    Of residuals the groups that alarm are kept, too.
    """
    start = time.process_time()
    found: Record = {"condition": condition, "size": size, "number": number}
    given = made(plan_of(plan), condition, number, seed, particles, size)
    model, work, case = _model(), Workspace(), given.case
    try:
        if by == "residuals":
            visits = residuals(model, case.spec, case.readings, case.facts, workspace=work)
            told = omnibus(visits, case.facts, case.spec.seed)
            groups = sorted({test.grouping for test in told.alarms})
            seconds = round(time.process_time() - start, 1)
            least = min((test.p_family for test in told.tests), default=1.0)
            return found | {"alarm": bool(groups), "groups": groups, "p": least, "cpu_s": seconds}
        state = update(model, case.spec, case.readings, workspace=work)
        first = judge(case.scan(model, state), case.spec.seed, dealt=case.dealt)
    except BladetwinError as error:
        return found | {"alarm": condition in CLEAN, "error": str(error)}
    seconds = round(time.process_time() - start, 1)
    return found | {"alarm": first.word != "adequate", "p": first.p, "cpu_s": seconds}


def who(told: str) -> By:
    """Who is to notice; InputError for anybody else.

    >>> who("residuals")
    'residuals'
    """
    found: By | None = next((by for by in get_args(By) if by == told), None)
    if found is None:
        raise InputError("by", told, "notices nothing", f"use {' or '.join(get_args(By))}")
    return found


def sizes_of(plan: Plan, condition: str, sizes: Sequence[float]) -> tuple[float, ...]:
    """Those for which the condition has truths.

    >>> sizes_of(plan_of("fleet-100"), "campaign", (0.5, 4.0))
    (0.5, 4.0)
    """
    effect = effect_of(condition, plan)
    found = []
    for size in sizes:
        try:
            if effect is not None:
                plan.with_effect(effect, size)
        except InputError:
            continue
        found.append(size)
    return tuple(found)


def planned(
    conditions: Sequence[str] | None, sizes: Sequence[float], sets: int, plan: str = "fleet-100"
) -> list[tuple[str, float, int]]:
    """(condition, size, number) of every set: `sets` for each condition at each of its sizes, and
    as many clean ones for every size.

    Raises InputError for a plan whose effects are as they were run, for conditions that it does not
    have, and for sizes that are not above 0.
    """
    chosen = plan_of(plan)
    if not chosen.scaled:
        raise InputError("plan", plan, "has effects of one size", "use fleet-100")
    there = [c for c in (*NAMED, *OUTSIDE) if c in conditions_of(chosen)]
    asked = there if conditions is None else list(conditions)
    if unknown := sorted(set(asked) - set(there)):
        raise InputError("conditions", unknown, "are unknown", f"use {', '.join(there)}")
    if not sizes or min(sizes) <= 0:
        raise InputError("sizes", list(sizes), "are no sizes", "give multiples of the noise, > 0")
    keys = [
        (condition, size, n)
        for n in range(sets)  # by number: a cut study holds some of each
        for condition in asked
        for size in sizes_of(chosen, condition, sizes)
    ]
    return keys + [(SOUND, 0.0, n) for n in range(sets * len(sizes))]


def run(
    keys: Sequence[tuple[str, float, int]],
    *,
    seed: int,
    particles: int,
    plan: str = "fleet-100",
    by: By = "diagnosis",
    processes: int = 1,
    folder: str | Path | None = None,
    commit: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Record]:
    """The records of these sets; `folder` as in `coverage.run`."""
    file = None
    if folder is not None:
        text = repr((seed, particles, plan, by, commit, code_digest(), _model().digest))
        file = Path(folder) / f"power-{sha256(text.encode()).hexdigest()[:12]}.jsonl"
    return records(
        {key: (*key, seed, particles, plan, by) for key in keys},
        one,
        lambda r: (str(r["condition"]), float(r["size"]), int(r["number"])),
        file=file,
        processes=processes,
        progress=progress,
    )


def curves(found: Sequence[Record]) -> dict[str, list[dict[str, float]]]:
    """By condition and in the order of sizes: size, sets, share that alarmed, its standard error.

    The error is that of a share with one alarm and one silence more (Agresti & Coull 1998), so that
    a curve that always alarms is not told for certain.

    >>> sets = [{"condition": "gain", "size": 1.0, "alarm": a} for a in (True, True, False)]
    >>> curves(sets)["gain"][0]["alarms"].__round__(3)
    0.667
    """
    out: dict[str, list[dict[str, float]]] = {}
    for condition in dict.fromkeys(str(r["condition"]) for r in found):
        own = [r for r in found if r["condition"] == condition]
        for size in sorted({float(r["size"]) for r in own}):
            alarms = [bool(r["alarm"]) for r in own if r["size"] == size]
            n, share = len(alarms), sum(alarms) / len(alarms)
            nearly = (sum(alarms) + 1) / (n + 2)
            error = float(np.sqrt(nearly * (1 - nearly) / (n + 2)))
            row = {"size": size, "sets": n, "alarms": share, "error": error}
            out.setdefault(condition, []).append(row)
    return out


def points(found: Mapping[str, Sequence[Mapping[str, float]]]) -> list[tuple[str, float]]:
    """(condition, size) of every point of the curves but the clean one.

    >>> points({"sound": [{"size": 0.0}], "gain": [{"size": 1.0}, {"size": 2.0}]})
    [('gain', 1.0), ('gain', 2.0)]
    """
    return [(name, row["size"]) for name, rows in found.items() for row in rows if row["size"] > 0]


def bounds(
    asked: Sequence[tuple[str, float]],
    seed: int,
    particles: int,
    plan: str,
    progress: Callable[[int], None] | None = None,
) -> dict[str, list[dict[str, Any]]]:
    """Of each of these points the chances of an alarm of both oracles, on average over rotors.

    A larger effect is scaled from fewer rotors (`effect_plans`), so that one rotor's chance would
    compare sizes of different rotors.
    """
    model, work, chosen = _model(), Workspace(), plan_of(plan)
    out: dict[str, list[dict[str, Any]]] = {}
    for done, (condition, size) in enumerate(asked):
        every = by_rotor(model, chosen, condition, seed, particles, size, work)
        told: dict[str, Any] = {"size": size, "rotors": len(every)}
        for what in ("alarm", "searched"):
            told[what] = round(float(np.mean([getattr(one, what) for one in every])), 3)
        out.setdefault(condition, []).append(told)
        if progress is not None:
            progress(done + 1)
    return out
