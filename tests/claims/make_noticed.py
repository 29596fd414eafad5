"""Makes results/noticed/result.json: whether effects of the size that is told are noticed.

    python -m tests.claims.make_noticed [--sets 8] [--seed N] [--out FILE]

Of each clean set of `effect_sets` in the plan fleet-100 (finite elements, 100 blades read three
times) it is asked from which size on wear, fouling, a step of the gas and a campaign's offset would
have been noticed (`core.diagnosis.noticed`). Effects of that size, finite elements scaled to it or
put on the readings, stand in another set of the same number, and half as large in a third; noise
and labels are drawn anew. All are kept, those without a size as well, and those whose finite
elements would have to be scaled by more than two.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from core.calibration.online import Workspace, update
from core.diagnosis.noticed import PROBABILITY, Trial
from core.diagnosis.verdict import ALARM, DEALT
from core.errors import InputError
from core.model import rotor_blade_wide
from core.validation import effect_fleet as fleet
from core.validation.effect_plans import NOISE, plan
from core.validation.effect_sets import Set, made
from service.studies.result import commit

FILE = Path(__file__).with_name("results") / "noticed" / "result.json"
PLAN, PARTICLES = plan("fleet-100"), 1000
RUN = {"wear": fleet.LOST, "fouling": fleet.FOULED, "step": fleet.HOTTER}  # amplitudes as they ran
CELLS = {
    "wear": ("coating wear", "linear"),
    "fouling": ("fouling", "linear"),
    "step": ("firing temperature step", "step"),
    "campaign": ("campaign offset", "constant"),
}
Json = dict[str, Any]


def scanned(given: Set) -> Any:
    model, work = rotor_blade_wide(), Workspace()
    state = update(model, given.case.spec, given.case.readings, workspace=work)
    return given.case.scan(model, state), given.case.noise(model, state)


def place(trial: Trial, condition: str, given: Set) -> int:
    """Of the cell as it is planted: of a step and a campaign the one at that hour."""
    name, shape = CELLS[condition]
    own = [
        i for i, c in enumerate(trial.scan.cells) if (c.family.name, c.shape) == (name, shape)
        and c.whom in ("all", "campaign")
    ]  # fmt: skip
    odd = float(PLAN.visits_h[PLAN.odd_visits[0]])
    if condition == "step":
        return min(own, key=lambda i: abs((trial.scan.cells[i].step_h or 0.0) - 29_000.0))
    if condition == "campaign":
        offsets = {f.offset_h for f in given.case.facts.values()}
        (visit,) = {
            r.campaign for r in given.case.readings
            if any(abs(r.time_h + h - odd) < 1.0 for h in offsets
                   if given.case.facts[r.blade].offset_h == h)
        }  # fmt: skip
        return next(i for i in own if trial.scan.cells[i].value == visit)
    return own[0]


def in_noises(condition: str, number: int, size: float) -> float | None:
    """The size that `made` wants: noises of an offset, or of the change at the last visit of the
    rotor that it takes for it; none where the finite elements would be scaled up too far."""
    if condition == "campaign":
        return size / NOISE
    for rotor in range(PLAN.rotors):
        noises = size / RUN[condition] / PLAN.strength(rotor, condition, 1.0)
        try:
            among = PLAN.with_effect(condition, noises)
        except InputError:
            continue
        if among[number % len(among)] == rotor:
            return float(noises)
    return None


def alarms(condition: str, number: int, seed: int, noises: float) -> bool:
    given = made(PLAN, condition, number, seed, PARTICLES, noises)
    scan, _ = scanned(given)
    return bool(scan.chance(DEALT, given.case.seed) <= ALARM)


def one(number: int, seed: int) -> list[Json]:
    given = made(PLAN, "clean", number, seed, PARTICLES)
    scan, noise = scanned(given)
    trial = Trial.of(scan, given.case.seed)
    found = []
    for condition in CELLS:
        size = trial.size(place(trial, condition, given), noise)
        record: Json = {"set": number, "condition": condition, "size": size}
        if size is not None:
            noises = in_noises(condition, number, size)
            record["noises"] = noises
        if size is not None and noises is not None:
            record |= {"alarms": alarms(condition, number, seed + 1, noises)}
            record |= {"half": alarms(condition, number, seed + 2, 0.5 * noises)}
        found.append(record)
        print(record, file=sys.stderr, flush=True)
    return found


def main(
    sets: Annotated[int, typer.Option(help="Clean sets; four effects are planted for each.")] = 8,
    seed: Annotated[int, typer.Option(help="Seed of noise and labels.")] = 1,
    out: Annotated[Path, typer.Option(help="File of the result.")] = FILE,
) -> None:
    """Sizes that are told, and whether effects of them are noticed."""
    made_by = commit()
    records = [record for number in range(sets) for record in one(number, seed)]
    asked = [r for r in records if "alarms" in r]
    told = {
        "commit": made_by,
        "seed": seed,
        "sets": sets,
        "probability": PROBABILITY,
        "planted": len(asked),
        "noticed": float(np.mean([r["alarms"] for r in asked])),
        "half as large": float(np.mean([r["half"] for r in asked])),
        "records": records,
    }
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(told, indent=1) + "\n")
    print(json.dumps({k: v for k, v in told.items() if k != "records"}))


if __name__ == "__main__":
    typer.run(main)
