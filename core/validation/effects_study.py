"""How often a diagnosis gives the right name, a wrong one, or none: simulated rotors, all counted.

A set is one of the finite-element rotors (20 blades, `fe_rotors`), read at six visits by three
instruments, with noise drawn anew; labels of blades, lots, coatings, campaigns and instruments are
drawn too, so that no name gives anything away. What is planted (`CONDITIONS`) comes from finite
elements (`effect_truths`) or is put on readings by the formulas below, none of them the surrogate.
A third of the planted kinds is outside of the grammar. Clean sets come with normal noise, with
heavy tails (t with three degrees of freedom), and with material that creeps in bursts: increments
between visits from a gamma distribution with a coefficient of variation of `BURSTS`.

A verdict is

    right         the planted name, or its cause, alone; of what is outside: `unattributed` or
                  `adequate`; of a clean set: `adequate`
    in the set    `not separable`, with the planted name in the set
    silent        `unattributed` or `adequate`, where something is planted that has a name
    wrong         any other: a name that is not there
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from core.calibration.online import RotorSpec, Workspace, update
from core.diagnosis.case import Case
from core.diagnosis.clock import with_offsets
from core.diagnosis.diagnose import diagnose
from core.diagnosis.grammar import Facts
from core.diagnosis.verdict import Verdict
from core.errors import BladetwinError, InputError
from core.model import Model, rotor_blade_wide
from core.observation import Inspection
from core.rng import seed_of, stream
from core.validation import fe_rotors
from core.validation.effect_truths import ROTORS, VISITS_H, WORN, offset_h, share
from core.validation.records import Record, code_digest, records

Array = NDArray[np.float64]
NOISE, VISITS, INSTRUMENTS = 0.02, 6, 3
BURSTS = 0.15
OFFSET, GAIN, ODD = 0.04, 0.1, 0.06
CLEAN = ("clean", "clean, heavy tails", "clean, bursts")
NAMED = ("campaign", "instrument", "gain", "wear", "step", "tertiary")
OUTSIDE = ("pulse", "alternating", "some blades late")
CONDITIONS = (*CLEAN, *NAMED, *OUTSIDE)


@dataclass(frozen=True)
class Set:
    """A simulated rotor: readings, facts of its blades, and the names that would be right."""

    case: Case
    truth: frozenset[str]


def _labels(rng: np.random.Generator, prefix: str, count: int) -> list[str]:
    return [f"{prefix}{n}" for n in rng.choice(900, count, replace=False) + 100]


def made(condition: str, number: int, seed: int, particles: int) -> Set:
    """Set `number` of a condition."""
    rng = stream(seed, "effects", condition, number)
    truth = fe_rotors.load()
    rotor = (
        ROTORS[number % len(ROTORS)]
        if condition in ("wear", "step", "tertiary", "pulse")
        else (number % len(truth.inputs))
    )
    count = fe_rotors.BLADES
    blades, lots = _labels(rng, "b", count), _labels(rng, "l", 3)
    coats, visits = _labels(rng, "c", 3), _labels(rng, "v", VISITS)
    readers = _labels(rng, "s", INSTRUMENTS)
    own_h = np.array(VISITS_H)
    curves = np.stack([truth.at("elongation", rotor, h) for h in own_h], axis=1)
    if condition in ("wear", "step", "tertiary", "pulse"):
        curves = curves * share(rotor, condition)
    if condition == "clean, bursts":
        steps = np.diff(curves, axis=1, prepend=0.0)
        shape = 1.0 / BURSTS**2
        curves = np.cumsum(steps * rng.gamma(shape, 1.0 / shape, steps.shape), axis=1)
    coat_of = [0 if b in WORN else 1 if b < WORN[0] else 2 for b in range(count)]
    odd = set(rng.choice(count, count // 3, replace=False).tolist())
    readings = []
    for b in range(count):
        for v in range(VISITS):
            k = v - round(offset_h(b) / VISITS_H[0])
            if k < 0:
                continue
            by = (b + v) % INSTRUMENTS
            noise = rng.standard_t(3) / np.sqrt(3) if condition == CLEAN[1] else rng.normal()
            y = float(curves[b, k])
            y *= 1.0 + GAIN * (condition == "gain" and by == 0)
            y += OFFSET * (condition == "campaign" and v == 3)
            y += OFFSET * (condition == "instrument" and by == 0)
            y += ODD * (-1) ** (b // 2 + v) * (condition == "alternating")
            y += ODD * (condition == "some blades late" and b in odd and v >= 4)
            at = (f"r{rng.integers(10**9)}", blades[b], "elongation", own_h[k])
            values = np.array([round(y + NOISE * noise, 5)])
            readings.append(Inspection(*at, values, instrument=readers[by], campaign=visits[v]))
    facts = {
        name: Facts(lot=lots[b % 3], coating_lot=coats[coat_of[b]]) for b, name in enumerate(blades)
    }
    spec = RotorSpec(
        f"set{number}", tuple(sorted(blades)), particles, seed_of(seed, number) % 2**31
    )
    data = tuple(readings[i] for i in rng.permutation(len(readings)))
    right = {
        "campaign": {f"campaign offset (campaign {visits[3]})"},
        "instrument": {f"instrument offset (instrument {readers[0]})"},
        "gain": {f"instrument gain (instrument {readers[0]})"},
        "wear": {f"{what} (coating lot {coats[0]})" for what in ("coating wear", "coating loss")},
        "step": {"firing temperature step", "gas temperature"},
        "tertiary": {"accelerating creep"},
    }
    case = Case(spec, data, with_offsets(facts, data, {}))
    return Set(case, frozenset(right.get(condition, set())))


def judged(condition: str, truth: frozenset[str], verdict: Verdict) -> str:
    """Right, in the set, silent or wrong."""
    nothing = verdict.word in ("adequate", "unattributed")
    if condition in CLEAN:
        return "right" if verdict.word == "adequate" else "silent" if nothing else "wrong"
    if condition in OUTSIDE:
        return "right" if nothing else "wrong"
    if nothing:
        return "silent"
    if verdict.word == "not separable":
        return "in the set" if truth & set(verdict.names) else "wrong"
    return "right" if len(verdict.names) == 1 and set(verdict.names) <= truth else "wrong"


@cache
def _model() -> Model:
    return rotor_blade_wide()


def one(condition: str, number: int, seed: int, particles: int) -> Record:
    """The record of a set; one that cannot be calibrated counts as wrong, with its error."""
    start = time.process_time()
    found: Record = {"condition": condition, "number": number}
    given = made(condition, number, seed, particles)
    work, model = Workspace(), _model()
    try:
        state = update(model, given.case.spec, given.case.readings, workspace=work)
        told = diagnose(model, state, given.case, workspace=work)
    except BladetwinError as error:
        return found | {"outcome": "wrong", "error": str(error)}
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
        "cpu_s": round(time.process_time() - start, 1),
    }


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


def run(
    conditions: Mapping[str, int],
    *,
    seed: int,
    particles: int,
    processes: int = 1,
    folder: str | Path | None = None,
    commit: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Record]:
    """All sets of the conditions, by name and number of sets; `folder` as in `coverage.run`."""
    unknown = sorted(set(conditions) - set(CONDITIONS))
    if unknown:
        raise InputError("conditions", unknown, "are unknown", f"use {', '.join(CONDITIONS)}")
    file = None
    if folder is not None:
        text = repr((seed, particles, commit, code_digest(), _model().digest))
        file = Path(folder) / f"effects-{sha256(text.encode()).hexdigest()[:12]}.jsonl"
    calls = {
        (condition, n): (condition, n, seed, particles)
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
        "outside, no name": mean(OUTSIDE, "right"),
    }
