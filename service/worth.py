"""Which inspection next, behind the `Science` port: `core.planning` of the service's rotors.

Works on a stored posterior with 2,000 particles of each blade at most, so that a hundred blades are
answered within a request.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from core.calibration.state import RotorState
from core.errors import InputError
from core.model import Model
from core.observation import Inspection
from core.planning.candidates import Candidate, candidates
from core.planning.worth import Target, worth
from service.export.units import unit_of
from service.ports import BladeRecord, Json, PlanTarget

MOST_PARTICLES = 2000
SHOWN = 20


def planned(
    model: Model,
    state: RotorState,
    blades: Sequence[BladeRecord],
    readings: Sequence[Inspection],
    target: PlanTarget,
    count: int,
) -> Json:
    """The target as it is known now, the best single readings, and the best set of `count`."""
    asked = candidates(model, [b.id for b in blades], readings)
    if not asked:
        raise InputError(
            "blades",
            [b.id for b in blades][:5],
            "have no hours left in the model",
            "add a blade, or register a model that covers more hours",
        )
    known = {b.id: b.known for b in blades if b.known is not None}
    if target.blade is not None and target.known is not None:
        known[target.blade] = target.known
    aim = Target(target.blade, target.quantity, target.time_h, target.parameter)
    found = worth(model, state, aim, asked, known, count, MOST_PARTICLES)
    if target.parameter is not None:
        unit = unit_of(model.network, target.parameter) or "1"
    else:
        unit = model.network.quantity(target.quantity or "").unit
    merged = by_whomever(found.single)
    single = {merged[one]: left for one, left in found.single}
    return {
        "unit": unit,
        "mean": found.mean,
        "sd": found.sd,
        "single": [told(*one, found.sd) for one in [*single.items()][:SHOWN]],
        "set": [told(merged[one], left, found.sd) for one, left in found.grown],
    }


def by_whomever(single: Sequence[tuple[Candidate, float]]) -> dict[Candidate, Candidate]:
    """Each candidate, without its instrument where all instruments would leave the same sd.

    >>> a, b = (Candidate("B1", "elongation", 8000.0, 0.0, name) for name in ("g1", "g2"))
    >>> [c.instrument for c in by_whomever([(a, 0.2), (b, 0.2)]).values()]
    [None, None]
    >>> [c.instrument for c in by_whomever([(a, 0.2), (b, 0.1)]).values()]
    ['g1', 'g2']
    """
    bare = {one: replace(one, instrument=None) for one, _ in single}
    lefts = dict[Candidate, set[float]]()
    for one, left in single:
        lefts.setdefault(bare[one], set()).add(left)
    return {one: bare[one] if len(lefts[bare[one]]) == 1 else one for one, _ in single}


def told(candidate: Candidate, left: float, now: float) -> Json:
    """A candidate and the sd that it leaves; `narrower` is the share of the sd that it takes."""
    return {
        **candidate.to_json(),
        "sd_after": left,
        "narrower": 1.0 - left / now if now > 0 else 0.0,
    }
