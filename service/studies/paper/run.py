"""The four calibrations in processes of their own, and their numbers put together."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, as_completed
from dataclasses import dataclass
from typing import Any

import service.one_thread  # noqa: F401  before numpy, as in every process
from core.builtin import inspection_plan
from core.errors import InputError
from core.pools import process_pool
from core.validation import paper, paper_scan
from core.validation.paper import CASES, WAYS, Case, Strategy
from service.studies.paper.numbers import Drawn, Told, surrogate, told
from service.studies.paper.statements import judged

Json = dict[str, Any]
LEAST = 100  # particles, of a blade or of a set of the schedule


@dataclass(frozen=True)
class Study:
    """Numbers (plain JSON) and what the pictures show, by case."""

    numbers: Json
    drawn: dict[str, list[Drawn]]


def both(
    delta: bool, blades: int, particles: int, seed: int, ways: Sequence[Strategy] = WAYS
) -> dict[str, list[Told]]:
    """Offline and online with or without delta, by the name of their case."""
    plan, scan, known = inspection_plan.load(), paper_scan.load(), dict[str, Told]()
    found = paper.calibrated(delta, plan, paper.chosen(blades), particles, seed, ways)
    return {
        Case(strategy, delta).name: told(delta, stages, plan, scan, known)
        for strategy, stages in found.items()
    }


def by_schedule(case: Case, blades: int, particles: int, seed: int) -> Json:
    """The paper's own schedule on the same readings."""
    return paper.scheduled(case, inspection_plan.load(), paper.chosen(blades), particles, seed)


def run(
    *,
    blades: int = 100,
    particles: int = 4000,
    seed: int = 7,
    processes: int = 2,
    schedule: int = 0,
    progress: Callable[[int], None] | None = None,
) -> Study:
    """All cases, `processes` at a time.

    particles  of each blade;  schedule: particles of the paper's own schedule, 0: it is not run
    """
    if processes < 1:
        raise InputError("processes", processes, "compute nothing", "give 1 or more")
    if particles < LEAST:
        raise InputError("particles", particles, "are too few", f"give {LEAST} or more")
    if schedule and schedule < LEAST:
        raise InputError("schedule", schedule, "are too few particles", f"give {LEAST}, or 0")
    paper.chosen(blades)
    start = time.monotonic()
    made: dict[str, list[Told]] = {}
    literal: dict[str, Json] = {}
    with process_pool(processes) as pool:
        jobs: dict[Future[Any], Case | None] = {
            pool.submit(both, d, blades, particles, seed): None for d in (True, False)
        }
        if schedule:
            jobs |= {pool.submit(by_schedule, c, blades, schedule, seed): c for c in CASES}
        for done, job in enumerate(as_completed(jobs), 1):
            case = jobs[job]
            if case is None:
                made |= job.result()
            else:
                literal[case.name] = job.result()
            if progress is not None:
                progress(done)
    found: Json = {
        "cases": {c.name: [numbers for numbers, _ in made[c.name]] for c in CASES},
        "schedule": {c.name: literal[c.name] for c in CASES if c.name in literal},
    }
    drawn = {c.name: [shown for _, shown in made[c.name]] for c in CASES}
    found["surrogate"] = surrogate(inspection_plan.load())
    found |= {"blades": blades, "particles": particles, "seed": seed, "processes": processes}
    found["schedule_particles"] = schedule
    found["statements"] = [one.to_json() for one in judged(found)]
    found["calibration_s"] = round(time.monotonic() - start, 1)
    return Study(found, drawn)
