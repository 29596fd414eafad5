"""What the readings of a plan could tell of an effect at best, before any of them is drawn.

An oracle knows where every parameter and every noise lies, and what the effect does to each
reading, g, to first order. Blades' parameters and shared ones imitate of it what they can; with
the information I of `core.diagnosis.scores` between signatures,

    alone     ½ I_gg nats of log likelihood are expected for the effect, if it is there
    left      ½ (I_gg − I_gj² / (1 + I_jj)) of them once a rival j of another cause is in the model,
              at its best amplitude; the least over all rivals of the grammar
    alarm     chance of a one-sided test at 5 % that knows what it looks for, Φ(√I_gg − 1.645)
    searched  chance of an alarm by all cells of the grammar at 5 % family-wise, their scores normal
              about I_g with covariance I (`SETS` drawn, and as many without the effect): what the
              price of searching leaves of `alarm`
    name      chance that the log odds against the nearest rival, normal with mean `left` and
              variance 2 `left`, pass those of `core.diagnosis.verdict.NAMED`

No diagnosis can do better, and one that searches a whole grammar does as `searched` says at best.
Where `name` is low, "not separable" is the right answer and a right name is luck; where `alarm` is
low, so is an alarm.
Two rivals together may come nearer than one; priors may tell rivals apart by their sizes. Both are
left out. What the oracle is asked about is what the study plants (`effect_sets`), never a cell of
the grammar; the sensitivities come from a calibration of the same rotor without the effect.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from core.calibration.online import Workspace, update
from core.diagnosis.chance import family_wise
from core.diagnosis.grammar import Cell
from core.diagnosis.scan import Scan
from core.diagnosis.scores import Scores
from core.diagnosis.verdict import ALARM as FAMILY_WISE
from core.diagnosis.verdict import NAMED
from core.errors import InputError
from core.model import Model, rotor_blade_wide
from core.rng import stream
from core.validation.effect_plans import NOISE, SCAN_NOISE, Plan
from core.validation.effect_plans import plan as plan_of
from core.validation.effect_sets import Set, effect_of, made
from core.validation.records import Record, records

Array = NDArray[np.float64]
ALARM = 1.645
SETS = 400
MOST_ROTORS = 4


@dataclass(frozen=True, slots=True)
class Possible:
    """Expected nats for an effect, alone and beside its nearest rival, and what they allow."""

    alone: float
    rival: str | None
    left: float
    searched: float = 0.0

    @property
    def alarm(self) -> float:
        """Chance of an alarm.

        >>> round(Possible(2.0, None, 2.0).alarm, 2)
        0.64
        """
        return float(ndtr(np.sqrt(2.0 * self.alone) - ALARM))

    @property
    def name(self) -> float:
        """Chance of the right name, not a rival's and not both.

        >>> [round(Possible(40.0, "fouling", left).name, 2) for left in (0.1, 2.2, 10.0)]
        [0.0, 0.5, 0.96]
        """
        if self.left <= 0:
            return 0.0
        odds = np.log(NAMED / (1.0 - NAMED))
        return float(ndtr((self.left - odds) / np.sqrt(2.0 * self.left)))


def possible(
    model: Model, given: Set, seed: int = 0, workspace: Workspace | None = None
) -> Possible:
    """Of what is planted in a set; InputError where nothing is."""
    data = given.case.readings
    change = {r.id: given.exact[r.id] - given.sound[r.id] for r in data}
    if not any(np.any(one) for one in change.values()):
        raise InputError("set", given.case.spec.id, "has no effect", "plant one")
    rng = stream(seed, "oracle")
    noise = {"elongation": NOISE, "deformation": SCAN_NOISE}
    sound = tuple(
        replace(r, values=given.sound[r.id] + noise[r.quantity] * rng.normal(size=r.values.shape))
        for r in data
    )
    case = replace(given.case, readings=sound)
    state = update(model, case.spec, sound, workspace=workspace)
    scan = case.scan(model, state)
    seen = scan.seen
    g = by_rows(model, seen, change)
    information = seen.cross(np.concatenate([g[:, :, None], scan.g], axis=2))
    alone = 0.5 * float(information[0, 0])
    named, alarms = len(scan.cells), searched(scan, information[0, 1:], stream(seed, "searched"))
    rivals = [c for c in range(named) if not _right(scan.cells[c], given.truth)]
    left = {c: _left(information, c + 1, scan.cells[c]) for c in rivals}
    nearest = min(rivals, key=lambda c: left[c], default=None)
    if nearest is None:
        return Possible(alone, None, alone, alarms)
    return Possible(alone, scan.cells[nearest].name, left[nearest], alarms)


def by_rows(model: Model, seen: Scores, change: Mapping[str, Array]) -> Array:
    """What a change of readings, by their ids, makes of their rows, (B, n)."""
    out = np.zeros(seen.place.shape)
    bases: dict[bytes, Array] = {}
    for b, rows in enumerate(seen.rows):
        for place, reading in enumerate(rows.readings):
            at, moved = seen.place[b] == place, change[reading.id].reshape(-1)
            if place in rows.mixings and reading.nodes is not None:
                key = reading.nodes.tobytes()
                if key not in bases:
                    phi = model.part(reading.quantity).deformation_modes(reading.nodes.tolist())
                    bases[key] = np.linalg.qr(phi.reshape(len(moved), -1))[0]
                moved = rows.mixings[place].turn @ (bases[key].T @ moved)
            out[b, at] = moved
    return out


def searched(scan: Scan, across: Array, rng: np.random.Generator) -> float:
    """Chance of an alarm by a whole scan: `SETS` normal scores about `across` and about nothing.

    across  what the effect adds to the score of each column, (C,)
    """
    value, vector = np.linalg.eigh(scan.information)
    root = vector * np.sqrt(np.maximum(value, 0.0))
    null, there = rng.standard_normal((2, SETS, len(across))) @ root.T
    dealt, found = (np.array([scan.by_scores(u) for u in sets]) for sets in (null, there + across))
    alone = scan.of_one_blade
    return float(np.mean([family_wise(own, dealt, alone) <= FAMILY_WISE for own in found]))


def _right(cell: Cell, truth: frozenset[str]) -> bool:
    return bool({cell.name, cell.cause} & truth)


def _left(information: Array, j: int, cell: Cell) -> float:
    """Expected nats of column 0 once column j is in, at its best amplitude (0 against its sign)."""
    across = float(information[0, j])
    if cell.family.sign and across < 0:  # columns are directed: what goes the other way is none
        return 0.5 * float(information[0, 0])
    return 0.5 * float(information[0, 0] - across**2 / (1.0 + information[j, j]))


def by_rotor(
    model: Model,
    plan: Plan,
    condition: str,
    seed: int,
    particles: int,
    size: float,
    workspace: Workspace | None = None,
) -> list[Possible]:
    """On each of the rotors that a study plants a condition in, `MOST_ROTORS` at most."""
    effect = effect_of(condition, plan)
    rotors = (
        plan.with_effect(effect, size if plan.scaled else None) if effect else range(plan.rotors)
    )
    return [
        possible(model, made(plan, condition, n, seed, particles, size), seed, workspace)
        for n in range(min(len(rotors), MOST_ROTORS))
    ]


def bounds(
    plan: Plan,
    conditions: Sequence[str],
    seed: int,
    particles: int,
    size: float,
    progress: Callable[[int], None] | None = None,
    processes: int = 1,
) -> dict[str, dict[str, float | list[str]]]:
    """By condition, means over the plan's rotors; `rivals` are those nearest in any of them."""
    found = records(
        {c: (plan.name, c, seed, particles, size) for c in conditions},
        _bound,
        lambda record: str(record["condition"]),
        processes=processes,
        progress=None if progress is None else lambda done, _: progress(done),
    )
    return {one.pop("condition"): one for one in found}


def _bound(plan: str, condition: str, seed: int, particles: int, size: float) -> Record:
    model, work = rotor_blade_wide(), Workspace()
    every = by_rotor(model, plan_of(plan), condition, seed, particles, size, work)
    means = {
        what: round(float(np.mean([getattr(one, what) for one in every])), 3)
        for what in ("alone", "left", "alarm", "searched", "name")
    }
    rivals = sorted({one.rival.split(" (")[0] for one in every if one.rival})
    return {"condition": condition, **means, "rivals": rivals}
