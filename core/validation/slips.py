"""What one mistyped reading does to a rotor: slips of a kind that happens.

A finite-element rotor of a plan without any effect (`effect_sets`) is read, and one reading is
written down wrongly:

    inches     the number in inches, called millimetres
    decimal    the decimal point one place to the right
    digits     its first two digits that differ, the other way round
    sign       with the wrong sign
    swapped    that of another blade of the visit, and the other way round
    slip       a number that is `SLIP` noises off, either way

Where a slip is smaller than `NOTICED` noises nobody could notice it, and nobody has to; all cases
are counted, with their size. Against the same rotor as it was read, the mean of the gas temperature
is held in sds, with blades that contradict `bounded` and, as the control, without. Pairs of blades
that are told as `exchanged` are counted in both: in the rotor as it was read none is. The rotor may
carry an effect that its model lacks (`condition`), which must not be taken for an exchange;
`EACH`: one condition of the plan after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np

from core.calibration.health import blamed
from core.calibration.online import Workspace, begun
from core.calibration.step import Step
from core.calibration.weighed import Weighed
from core.errors import InputError
from core.model import Model, rotor_blade_wide
from core.observation import Inspection
from core.rng import stream
from core.smc.particles import normalised
from core.validation.effect_plans import NOISE
from core.validation.effect_plans import plan as plan_of
from core.validation.effect_sets import conditions, made
from core.validation.records import Record, code_digest, records

WHAT = "t1t_rate"
EACH = "each"
KINDS = ("inches", "decimal", "digits", "sign", "swapped", "slip")
SLIP = (8.0, 40.0)  # noises
NOTICED = 12.0  # noises; smaller slips may be what noise and blades' own parameters explain
MOVED = 1.0  # sds of the posterior; more is told


def slipped(
    kind: str, readings: Sequence[Inspection], rng: np.random.Generator
) -> tuple[tuple[Inspection, ...], tuple[str, ...], float]:
    """The readings with one slip, the ids of those that are wrong, and by how many noises."""
    at = int(rng.integers(len(readings)))
    one = readings[at]
    value = float(one.values[0])
    if kind == "swapped":
        beside = [
            i for i, r in enumerate(readings) if r.campaign == one.campaign and r.blade != one.blade
        ]
        to = int(rng.choice(beside))
        new = {at: float(readings[to].values[0]), to: value}
    else:
        new = {at: _wrong(kind, value, rng)}
    off = max(abs(v - float(readings[i].values[0])) / NOISE for i, v in new.items())
    told = tuple(
        replace(r, values=np.array([new[i]])) if i in new else r for i, r in enumerate(readings)
    )
    return told, tuple(readings[i].id for i in sorted(new)), off


def _wrong(kind: str, value: float, rng: np.random.Generator) -> float:
    if kind == "slip":
        return value + float(rng.choice([-1.0, 1.0]) * rng.uniform(*SLIP)) * NOISE
    if kind == "digits":
        return turned(value)
    return value * {"inches": 1.0 / 25.4, "decimal": 10.0, "sign": -1.0}[kind]


def turned(value: float) -> float:
    """The first two neighbouring digits that differ, the other way round.

    >>> turned(0.4713), turned(1.1325), turned(0.5)
    (0.7413, 1.3125, 0.05)
    """
    text = f"{abs(value):.4f}"
    digits = [i for i, c in enumerate(text) if c.isdigit()]
    first = next((k for k, i in enumerate(digits) if text[i] != "0"), 0)
    for i, j in zip(digits[first:], digits[first + 1 :], strict=False):
        if text[i] != text[j]:
            turn = [*text]
            turn[i], turn[j] = turn[j], turn[i]
            return float(np.copysign(float("".join(turn)), value))
    return value


def _moments(step: Step, found: Weighed) -> tuple[float, float]:
    """Mean and sd of the gas temperature on the unit box."""
    w = normalised(found.log_w)
    u = found.unit[:, step.space.names.index(WHAT)]
    mean = float(w @ u)
    return mean, float(np.sqrt(w @ (u - mean) ** 2))


def one(
    kind: str, number: int, seed: int, particles: int, plan: str, condition: str = "clean"
) -> Record:
    """The record of a case."""
    every = conditions(plan_of(plan))
    condition = every[number % len(every)] if condition == EACH else condition
    given = made(plan_of(plan), condition, number, seed, particles)
    rng = stream(seed, "slips", kind, number)
    wrong, ids, off = slipped(kind, given.case.readings, rng)
    model, work = _model(), Workspace()
    sound = begun(model, given.case.spec, given.case.readings, workspace=work)
    mean, sd = _moments(sound, sound.weighed)
    step = begun(model, given.case.spec, wrong, workspace=work)
    found, accused = step.settled
    told = blamed(step.messages, accused, found.unit[[int(np.argmax(found.log_p))]])
    suspects = [s["reading"] for b in told for s in b["suspects"]]
    blades = {r.blade for r in wrong if r.id in ids}
    shifts = {
        when: round((_moments(step, place)[0] - mean) / sd, 4)
        for when, place in (("moved", found), ("unbounded", step.weigh_with({})))
    }
    pairs = [tuple(one["blades"]) for one in step.exchanged()]
    return {
        "kind": kind,
        "number": number,
        "condition": condition,
        "off": round(off, 2),
        **shifts,
        "contradicted": sorted(b["blade"] for b in told),
        "right": bool(told) and {b["blade"] for b in told} <= blades,
        "named": sorted(suspects) == sorted(ids),
        "among": bool(set(ids) & set(suspects)),
        "accused before": len(sound.settled[1]),
        "exchange told": pairs == [tuple(sorted(blades))],
        "exchanges": len(pairs),
        "exchanges before": len(sound.exchanged()),
    }


def _model() -> Model:
    return rotor_blade_wide()


def run(
    kinds: Mapping[str, int],
    *,
    seed: int,
    particles: int,
    plan: str = "rotor-20",
    condition: str = "clean",
    processes: int = 1,
    folder: str | Path | None = None,
    commit: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Record]:
    """All cases of the kinds, by name and number; `folder` as in `coverage.run`."""
    if unknown := sorted(set(kinds) - set(KINDS)):
        raise InputError("kinds", unknown, "are unknown", f"use {', '.join(KINDS)}")
    if condition not in (possible := (EACH, *conditions(plan_of(plan)))):
        raise InputError("condition", condition, "is unknown", f"use {', '.join(possible)}")
    file = None
    if folder is not None:
        told = (seed, particles, plan, condition, commit, code_digest(), _model().digest)
        file = Path(folder) / f"slips-{sha256(repr(told).encode()).hexdigest()[:12]}.jsonl"
    calls = {
        (kind, n): (kind, n, seed, particles, plan, condition)
        for n in range(max(kinds.values()))
        for kind, count in kinds.items()
        if n < count
    }
    key = lambda record: (str(record["kind"]), int(record["number"]))  # noqa: E731
    return records(calls, one, key, file=file, processes=processes, progress=progress)


def table(found: Sequence[Record]) -> dict[str, dict[str, float]]:
    """By kind, and of all: cases; of those that are `NOTICED` or larger how many, the share that is
    noticed in the right blade alone, and in which the wrong reading is a suspect, and is the only
    one; by how many sds the gas temperature moves at most and in the median, and without bounds;
    and the same at most of the small ones; the share of all cases in which the two blades are told
    as exchanged, how many other pairs are, and how many before the slip."""
    out: dict[str, dict[str, float]] = {}
    for kind in (*KINDS, "all"):
        own = [r for r in found if kind in ("all", r["kind"])]
        if not own:
            continue
        large = [r for r in own if r["off"] >= NOTICED]
        small = [r for r in own if r["off"] < NOTICED]
        row: dict[str, float] = {"cases": len(own), "large": len(large)}
        if large:
            row |= {w: sum(r[w] for r in large) / len(large) for w in ("right", "among", "named")}
            for when in ("moved", "unbounded"):
                sizes = np.abs([r[when] for r in large])
                row |= {f"{when}, median": float(np.median(sizes)), f"{when}, most": sizes.max()}
                row[f"{when}, above {MOVED:g} sd"] = float(np.mean(sizes > MOVED))
        if small:
            row["small, moved at most"] = float(max(abs(r["moved"]) for r in small))
        if all("exchange told" in r for r in own):
            row |= {"exchange told": sum(r["exchange told"] for r in own) / len(own)}
            wrongly = sum(r["exchanges"] - r["exchange told"] for r in own)
            row |= {"exchanges told wrongly": wrongly}
            row["exchanges told before"] = sum(r["exchanges before"] for r in own)
        out[kind] = {k: round(float(v), 4) for k, v in row.items()}
    return out
