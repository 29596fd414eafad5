"""What is told of a noise that is stated too small, and of one that is stated rightly.

A finite-element rotor of a plan without any effect (`effect_sets`) is read with a noise that is
known. Every reading says what it is (`sigma`), but a factor too small: `times` 1 is the truth. Held
against each rotor's state are what it tells of its noise (`noisier`) and which blades it calls
exchanged, for none is; as the control, which it calls so where the noise is believed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np

from core.calibration.exchanged import exchanged
from core.calibration.noisier import Scatter
from core.calibration.online import begun
from core.errors import InputError
from core.model import Model, rotor_blade_wide
from core.validation.effect_plans import NOISE
from core.validation.effect_plans import plan as plan_of
from core.validation.effect_sets import made
from core.validation.records import Record, code_digest, records

TIMES = (1.0, 1.5, 2.0, 3.0)


def one(times: float, number: int, seed: int, particles: int, plan: str) -> Record:
    """The record of a rotor."""
    given = made(plan_of(plan), "clean", number, seed, particles)
    stated = [replace(reading, sigma=NOISE / times) for reading in given.case.readings]
    step = begun(_model(), given.case.spec, stated)
    found, accused = step.settled
    looked, looking = step.looking.at(found, accused), step.looking
    told = looked.scatter.told(looked.paired)
    bad = {blade["blade"] for blade in accused}
    given_of = (step.messages, found, bad, looking.messages_of, looked.looks)
    return {
        "times": times,
        "number": number,
        "told": max((kind["times"] for kind in told), default=0.0),
        "contradicted": len(bad),
        "exchanges": len(looked.exchanged),
        "exchanges believed": len(exchanged(*given_of, Scatter({}))),
    }


def _model() -> Model:
    return rotor_blade_wide()


def run(
    rotors: int,
    times: Sequence[float] = TIMES,
    *,
    seed: int,
    particles: int,
    plan: str = "rotor-20",
    processes: int = 1,
    folder: str | Path | None = None,
    commit: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Record]:
    """All rotors, each with every factor; `folder` as in `coverage.run`."""
    if wrong := sorted(k for k in times if not 0.1 <= k <= 10.0):
        raise InputError("times", wrong, "are out of range", "use 0.1 to 10")
    file = None
    if folder is not None:
        told = (seed, particles, plan, commit, code_digest(), _model().digest)
        file = Path(folder) / f"stated-{sha256(repr(told).encode()).hexdigest()[:12]}.jsonl"
    calls = {(k, n): (k, n, seed, particles, plan) for n in range(rotors) for k in times}
    key = lambda record: (float(record["times"]), int(record["number"]))  # noqa: E731
    return records(calls, one, key, file=file, processes=processes, progress=progress)


def table(found: Sequence[Record]) -> dict[str, dict[str, float]]:
    """By factor: rotors; how many are told of, and the least, median and largest s of those; in how
    many a blade contradicts, two look exchanged, and would if the noise were believed.

    >>> case = {"contradicted": 0, "exchanges": 0, "exchanges believed": 2}
    >>> for name, row in table([case | {"times": 3.0, "told": s} for s in (0.0, 2.5)]).items():
    ...     print(name, row)
    3 {'rotors': 2, 'told': 1, 'contradicted': 0, 'exchanges': 0, 'exchanges believed': 2, 'least': 2.5, 'median': 2.5, 'most': 2.5}
    """  # noqa: E501
    out: dict[str, dict[str, float]] = {}
    for times in sorted({one["times"] for one in found}):
        own = [one for one in found if one["times"] == times]
        row: dict[str, float] = {"rotors": len(own)}
        for name in ("told", "contradicted", "exchanges", "exchanges believed"):
            row[name] = sum(bool(one[name]) for one in own)
        if sizes := [one["told"] for one in own if one["told"]]:
            row |= {"least": min(sizes), "median": float(np.median(sizes)), "most": max(sizes)}
        out[f"{times:g}"] = row
    return out
