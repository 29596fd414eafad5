"""Which inspection next: by how much each would narrow what is asked for."""

from __future__ import annotations

from core.errors import InputError, RangeError
from core.log import effective
from core.observation import Inspection
from service.entries import entries_of
from service.handlers.blades import blades_of
from service.handlers.questions import question
from service.handlers.reads import Basis, health
from service.ports import BladeRecord, Event, Json, PlanTarget, Science, Store, Transaction

PAGE = 2000
MOST_READINGS = 5  # of a set


def target_of(
    found: Basis, quantity: str | None, time_h: float | None, parameter: str | None
) -> PlanTarget:
    """What is to be known better, checked against the model.

    A parameter, or a quantity (default: the model's first) of the basis' blade at an hour (default:
    the model's last); where nothing is named, the first shared parameter.

    Raises InputError or FaultsError.
    """
    blade = None if found.blade is None else found.blade.id
    if parameter is not None:
        if quantity is not None or time_h is not None:
            raise InputError(
                "parameter", parameter, "is given beside a prediction", "give one of the two"
            )
        level = {p.name: p.level for p in found.card.network.parameters}.get(parameter)
        if level not in ("local", "shared"):
            names = [
                p.name for p in found.card.network.parameters if p.level in ("local", "shared")
            ]
            raise InputError(
                "parameter", parameter, "is not calibrated", f"use one of {', '.join(names)}"
            )
        if level == "local" and blade is None:
            raise InputError("blade", None, f"is missing: {parameter} is a blade's", "name a blade")
        return PlanTarget(blade if level == "local" else None, None, None, parameter)
    if blade is None and quantity is None and time_h is None:
        shared = [p.name for p in found.card.network.parameters if p.level == "shared"]
        if shared:
            return PlanTarget(None, None, None, shared[0])
    if blade is None:
        raise InputError("blade", None, "is missing", "name a blade, or a shared parameter")
    hours = None if time_h is None else [time_h]
    asked = question(found.card, quantity, hours, None, 0.95)
    if found.card.outputs[asked.quantity].kind == "vector":
        raise InputError(
            "quantity", asked.quantity, "has three components", "use elongation or ceeq"
        )
    hour = found.card.horizon_h if time_h is None else time_h
    known = None if found.blade is None else found.blade.known
    return PlanTarget(blade, asked.quantity, hour, None, known)


def plan(store: Store, science: Science, found: Basis, target: PlanTarget, count: int) -> Json:
    """Candidates by what they leave of the target's sd, and the best set of `count`.

    Raises RangeError for a count outside 1 … 5, InputError where no blade runs or has hours left.
    """
    if not 1 <= count <= MOST_READINGS:
        raise RangeError("count", count, f"lies outside 1 … {MOST_READINGS}", "ask for a small set")
    rotor, through = found.state.rotor_id, found.state.through_seq
    with store.read() as tx:
        there = [b for b in blades_of(tx, rotor) if b.added_seq <= through]
        readings = counting(tx, rotor, through)
    blades = [b for b in there if runs(b, through)]
    if not blades:
        raise InputError("blades", [b.id for b in there][:5], "have all retired", "add a blade")
    told = science.plan(
        found.card, found.state.meta, found.arrays(store), blades, readings, target, count
    )
    aim = {
        "blade": target.blade,
        "quantity": target.quantity,
        "time_h": target.time_h,
        "parameter": target.parameter,
        "unit": told["unit"],
        "mean": told["mean"],
        "sd": told["sd"],
    }
    return {
        "target": aim,
        "single": told["single"],
        "set": told["set"],
        "health": health(found.state),
    }


def counting(tx: Transaction, rotor: str, through: int) -> tuple[Inspection, ...]:
    """The readings that count as of an entry of a rotor's log."""
    events: list[Event] = []
    while page := tx.log.entries(rotor, events[-1].seq if events else 0, through, PAGE):
        events += page
    return effective(entries_of(events))


def runs(blade: BladeRecord, through: int) -> bool:
    """Whether a blade is in the rotor as of an entry of its log."""
    gone = blade.retired_seq is not None and blade.retired_seq <= through
    return blade.added_seq <= through and not gone
