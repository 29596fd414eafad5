"""A diagnosis of 100 blades, as a worker makes it: its steps, and how long each takes.

    python tests/benchmarks/bench_diagnosis.py [WHAT]   (a number of visits, or fleet, many, …)

Finite-element elongations of `core.builtin.worn_plan` at so many (default 6) equal steps to
24,000 h, with 0.02 mm of noise; one coating lot wears, one visit reads 0.02 mm too much. All of it
is diagnosed by `rotor-blade-wide` over the whole grammar with pairs, before and after included.
With `fleet` it is a hundred blades of five ages at three visits, whose coatings all wear, which
such readings do not tell from other causes: the inspections that would are worked out as well.
With `many` it is one whose gas steps, and too many names for an answer share the evidence.
With `clean` it is one read six times in which nothing is: what would have been noticed is told.
With `hours` each blade is read at hours of its own, up to 400 h off its visits; with `scans` forty
blades are scanned at two visits and all coatings wear; with `pulse` the gas is hotter for a while,
which no name is for.
Peak memory is that of the process.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import service.one_thread  # noqa: F401  before numpy

# isort: split
import numpy as np

from core.builtin import inspection_plan, worn_plan
from core.calibration.online import RotorSpec
from core.model import rotor_blade_wide
from core.observation import Inspection
from core.rng import stream
from core.validation.effect_plans import plan
from core.validation.effect_sets import made
from service.effects import diagnosed
from service.ports import BladeRecord

LAST_H, NOISE, PARTICLES, BLADES, APART = 24_000.0, 0.02, 1000, 100, 400


def readings(visits: int) -> list[Inspection]:
    """Of the first 100 blades, at equal steps."""
    worn, rng, found = worn_plan.load(), stream(7, "bench-diagnosis"), []
    names = list(inspection_plan.blades())[:BLADES]
    for k in range(visits):
        hour = LAST_H * (k + 1) / visits
        for b, name in enumerate(names):
            y = float(np.interp(hour, worn.time_h, worn.elongation[b]))
            y += worn_plan.OFFSET * (k == visits // 2) + NOISE * rng.standard_normal()
            at = (f"{name}-{k}", name, "elongation", hour, np.array([round(y, 4)]))
            found.append(Inspection(*at, campaign=f"visit-{k}"))
    return found


def of_a_lot(visits: int) -> tuple[RotorSpec, list[BladeRecord], Sequence[Inspection]]:
    """One lot wears, one visit is off: two effects that can be told."""
    given = readings(visits)
    names = sorted({r.blade for r in given})
    records = [BladeRecord(b, coating_lot=worn_plan.coating_lot(b)) for b in names]
    return RotorSpec("bench", tuple(names), PARTICLES, 0), records, given


def of_a_fleet(
    condition: str, seed: int, name: str, number: int
) -> tuple[RotorSpec, list[BladeRecord], Sequence[Inspection]]:
    """Blades of five ages, with an effect that cannot be told from others or with none."""
    case = made(plan(name), condition, number, seed, PARTICLES).case
    facts = sorted(case.facts.items())
    records = [BladeRecord(b, lot=f.lot, coating_lot=f.coating_lot) for b, f in facts]
    return case.spec, records, case.readings


def at_hours_of_their_own(given: Sequence[Inspection]) -> list[Inspection]:
    """The same readings, each visit of a blade up to `APART` hours sooner or later."""
    rng, moved = stream(1, "bench-hours"), dict[tuple[str, float], float]()
    for r in given:
        moved.setdefault((r.blade, r.time_h), float(rng.integers(-APART, APART)))
    return [replace(r, time_h=r.time_h + moved[r.blade, r.time_h]) for r in given]


def main() -> None:
    asked, model = sys.argv[1] if len(sys.argv) > 1 else "6", rotor_blade_wide()
    fleets: dict[str, tuple[str, int, str, int]] = {
        "fleet": ("wear", 424242, "fleet-100", 0),
        "many": ("step", 7975784, "fleet-100", 0),
        "clean": ("clean", 5, "fleet-six-visits", 1),
        "hours": ("wear", 3164367, "fleet-100", 0),
        "scans": ("wear", 3164367, "fleet-scans", 0),
        "pulse": ("pulse", 2154717, "fleet-one-age", 0),
    }
    rotor = of_a_fleet(*fleets[asked]) if asked in fleets else of_a_lot(int(asked))
    spec, records, given = rotor
    if asked == "hours":
        given = at_hours_of_their_own(given)
    steps: list[tuple[str, float, float]] = []

    def progress(what: str, done: int, total: int) -> None:
        steps.append((what, time.perf_counter(), time.process_time()))

    found = diagnosed(model, spec, records, given, [], 50_000.0, progress)
    steps.append(("end", time.perf_counter(), time.process_time()))
    for (what, wall, cpu), (_, wall_1, cpu_1) in pairwise(steps):
        if wall_1 - wall >= 0.05:
            print(f"{wall_1 - wall:6.1f} s wall {cpu_1 - cpu:6.1f} s processor  {what}")
    (_, wall, cpu), (_, wall_1, cpu_1) = steps[0], steps[-1]
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{len(given)} readings: {wall_1 - wall:.1f} s wall, {cpu_1 - cpu:.1f} s of processor,")
    print(f"{memory:.0f} MB; {found['verdict']}: {', '.join(found['names'])}")


if __name__ == "__main__":
    main()
