"""Effects that a model lacks, behind the `Science` port: `core.diagnosis` of the service's rotors.

A diagnosis calibrates the rotor itself, from the readings that count. That is the sealed posterior
of the same number of particles, for a sealed posterior is a function of readings, seed and
algorithm alone.

Which hour of the rotor a reading was taken at is told by campaigns alone (`core.diagnosis.clock`).
A blade's `time_h0` is kept as given, but whose hours it counts is said nowhere, and a wrong offset
would move every effect of the rotor's clock.

Imported when it is first needed, with the compiled kernels of the calibration.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, MutableMapping, Sequence
from itertools import count
from typing import Any

from core.blade.inputs import DORMANT, IN_TIME
from core.builtin.plans import STANDARD, WIDE
from core.calibration.online import Workspace, update
from core.calibration.state import RotorSpec
from core.diagnosis import (
    FAMILIES,
    BeforeAfter,
    Case,
    Diagnosis,
    Facts,
    Family,
    before_after,
    diagnose,
    to_json,
)
from core.diagnosis.alternatives import alternatives
from core.diagnosis.clock import with_offsets
from core.diagnosis.families import families_for
from core.diagnosis.moving import follows
from core.diagnosis.noticed import noticed
from core.diagnosis.pictures import pictures
from core.diagnosis.report import held_out
from core.diagnosis.rivals import splitting
from core.diagnosis.search import STEPS
from core.diagnosis.separate import separation_json
from core.diagnosis.tell import discrepancy_json
from core.diagnosis.transfer import conditions, transferred
from core.diagnosis.widen import Widened, widen
from core.errors import InputError
from core.family import odd_size
from core.model import Model
from core.observation import Inspection
from core.surrogate.driven import Driven
from service.choices import with_adoptions
from service.ports import BladeRecord, Json, Progress
from service.variant import effects_between

CONSTANT = frozenset({*DORMANT} - {*IN_TIME})  # the blade's finite elements run none of these
RANKED = 10  # steps at most, of inspections that would split what is not separable


def read_families(
    told: Sequence[Json],
    inputs: Sequence[str],
    quantities: Sequence[str],
    there: Sequence[Family] = FAMILIES,
) -> tuple[Family, ...]:
    """Families as a request tells them.

    there  those that the model is asked for anyway

    Raises InputError for one that is none, that has the name of another, or that concerns an input
    or a quantity that the model has not.
    """
    found: list[Family] = []
    for i, one in enumerate(told):
        family = Family.from_json(one)
        if family.name in {known.name for known in (*there, *found)}:
            raise InputError(
                f"families[{i}].name", family.name, "is there already", "choose another name"
            )
        known = sorted(inputs if family.target == "input" else quantities)
        if family.of not in known:
            what = f"is no {family.target} of the model"
            raise InputError(f"families[{i}].of", family.of, what, f"use {', '.join(known)}")
        found.append(family)
    return tuple(found)


def families_of(model: Model, told: Sequence[Json]) -> tuple[Family, ...]:
    """Families that a model may be asked for; see `read_families`.

    Raises InputError as well for readings at many nodes, which no bias can be of
    (`core.network`), for a size that cannot be meant (`core.family.odd_size`), for courses in time
    of an input alone where nothing can be followed in time, and for any of an input that the
    blade's finite elements cannot run in time.
    """
    surrogate = model.surrogate
    base = surrogate.base if isinstance(surrogate, Driven) else surrogate
    inputs = {i.name: i.high - i.low for i in getattr(base, "inputs", ())}
    quantities = [q.name for q in model.network.quantities]
    found = read_families(told, [*inputs], quantities, families_for(model.network))
    blade = model.network.name in (STANDARD.name, WIDE.name)
    still = {p.name for p in model.network.of_level("dormant")} & CONSTANT if blade else set()
    scalar = [q.name for q in model.network.quantities if q.kind != "vector"]
    for i, one in enumerate(found):
        if one.target == "reading" and one.of not in scalar:
            what = "is read at many nodes: what is off there cannot enter the model"
            raise InputError(f"families[{i}].of", one.of, what, f"use {', '.join(scalar)}")
        if one.target == "input" and "constant" not in one.shapes and not follows(surrogate):
            what = "run in time, and no simulation run of this model has the creep strain (a field "
            what += "ceeq) by which an input that runs is followed: it would never be found"
            raise InputError(f"families[{i}].shapes", [*one.shapes], what, "use constant")
        if one.target == "input" and one.of in still and one.shapes != ("constant",):
            what = f"run in time, and {one.of} does not: no finite elements of the blade say what "
            what += "such a course would do"
            raise InputError(f"families[{i}].shapes", [*one.shapes], what, "use constant alone")
        if one.target == "input":
            odd = odd_size(one, inputs[one.of])
        else:
            read = model.network.quantity(one.of)
            odd = odd_size(one, read.high - read.low, read.sigma_obs.low)
        if odd is not None:
            raise InputError(f"families[{i}].size", one.size, *odd)
    return found


def compared(model: Model, readings: Sequence[Inspection]) -> str:
    """The quantity that both models are held against: that of most readings, of those that a model
    tells without a node's number; "" where there is none."""
    asked = {
        q.name
        for q in model.network.quantities
        if q.kind == "scalar" or q.default_node in model.part(q.name).named
    }
    count = Counter(r.quantity for r in readings if r.values.size == 1 and r.quantity in asked)
    return max(sorted(count), key=count.__getitem__, default="")


def diagnosed(
    model: Model,
    spec: RotorSpec,
    blades: Sequence[BladeRecord],
    readings: Sequence[Inspection],
    families: Sequence[Json],
    compare_h: float | None,
    progress: Progress,
    kept: MutableMapping[str, Any] | None = None,
    heed: Callable[[], None] = lambda: None,
) -> Json:
    """Verdict, effects, everything tried, and both models before and after (`core.diagnosis`).

    ``adds`` is what an adoption adds to the rotor's network (`service.variant`): the effects that
    are claimed, or, where a lack has no name, the discrepancy that the readings bear out.

    kept  where an earlier attempt found the posteriors; those are not searched again
    heed  called every few seconds; what it raises ends the work
    """
    elsewhere = conditions(spec.known, sorted({r.blade for r in readings}))
    total = STEPS + 4 + max(RANKED, 1 + 2 * len(elsewhere))
    later = count(STEPS + 4)

    def then(what: str) -> None:
        progress(what, min(next(later), total - 1), total)

    own = {b.id: Facts(b.lot, b.coating_lot) for b in blades}
    facts = with_offsets(own, readings, {})
    serving = tuple(b.id for b in blades if b.retired_seq is None)
    case = Case(spec, tuple(readings), facts, families_of(model, families), serving=serving)
    case.cells(model)  # refuses at once where there is nothing to look for
    work = Workspace(kept, heed)
    progress("calibration", 0, total)
    state = update(model, spec, case.readings, workspace=work)

    def during(what: str, done: int, _: int) -> None:
        progress(what, 1 + done, total)

    found = diagnose(model, state, case, during, work)
    quantity = compared(model, readings)
    claimed = found.verdict.word == "effect"
    wide, after = None, found.after if claimed else None
    if found.verdict.word == "unattributed" and quantity:
        progress("a discrepancy that has no name", STEPS + 1, total)
        hour = compare_h or model.surrogate.horizon_h
        wide = widen(model, state, case, quantity, hour, work)
        after = (wide.model, wide.state) if wide is not None and wide.borne_out else None
    both: BeforeAfter | None = None
    if after is not None and compare_h is not None and held_out(readings, quantity):
        steps = iter(range(STEPS + 1, total - 1))
        both = before_after(
            (found.before[0], after[0]),
            spec,
            case.readings,
            compare_h,
            quantity,
            lambda what: progress(what, next(steps), total),
            work,
            (found.before[1], after[1]),
            case.present,
        )
    then("pictures and inspections to come")
    split = splitting(found, case, work, then)
    apart = None if split is None else separation_json(split)
    others = None
    if found.foretold and compare_h is not None and quantity:
        others = alternatives(found.before, found.rivals, case, quantity, compare_h)
    unseen = None
    if found.scan is not None:
        then("what would have been noticed")
        could = len(case.once(model)) < len(case.read_h)
        unseen = noticed(found.scan, case.noise(model, state), case.seed, case.dealt, could=could)
    told = to_json(found, case, both, pictures(found, case), apart, wide, others, unseen)
    if claimed and compare_h is not None:
        held = transferred(
            (found.before[0], found.after[0]),
            spec,
            readings,
            quantity,
            then,
            work,
            (found.before[1], found.after[1]),
        )
        told["conditions"] = [one.to_json() for one in held]
        told["reasons"] += [
            f"it does not hold at {one.input} = {one.value:g}: {one.fault} there when no reading "
            "of it is known"
            for one in held
            if not one.holds
        ]
    if others is not None:
        told["alternatives"] = with_adoptions(told["alternatives"], found)
    return told | {"adds": _adds(found, wide)}


def _adds(found: Diagnosis, wide: Widened | None) -> Json | None:
    """What an adoption would put into the rotor's network; None where there is nothing to."""
    if found.verdict.word == "effect":
        return effects_between(found.before[0].network, found.after[0].network)
    if wide is None or not wide.borne_out:
        return None
    return {"quantities": {wide.quantity: {"discrepancy": discrepancy_json(wide.discrepancy)}}}
