"""Slots of a rotor: no two blades that run at once are in one.

A blade runs from the entry with which it joins to the one with which it leaves. `time_h0` says
nothing of that: whose hours it counts is not known (`service.effects`). Slots are called by text;
two numbers that differ in leading zeros alone are one slot.
"""

from __future__ import annotations

from collections.abc import Sequence

from core.errors import InputError
from service.ports import BladeRecord


def place(slot: str | None) -> str | None:
    """What a slot is told apart by; None: none is given.

    >>> place("07"), place("7 "), place("0"), place("A07"), place(None)
    ('7', '7', '0', 'A07', None)
    """
    name = (slot or "").strip()
    if name.isascii() and name.isdigit():
        return name.lstrip("0") or "0"
    return name or None


def faults_together(blades: Sequence[BladeRecord]) -> list[InputError]:
    """Blades of one creation that would be in the slot of an earlier one."""
    remedy = "give each blade a slot of its own, or none; a replacement joins once the other left"
    found, there = [], dict[str | None, BladeRecord]()
    for i, blade in enumerate(blades):
        other = there.setdefault(place(blade.slot), blade)
        if other is not blade and place(blade.slot) is not None:
            found.append(_fault(f"blades[{i}].slot", blade, other, remedy))
    return found


def fault_beside(blade: BladeRecord, there: Sequence[BladeRecord], rotor: str) -> InputError | None:
    """What keeps a blade from joining a rotor that has these; None: its slot is free."""
    own = place(blade.slot)
    for other in there:
        if other.retired_seq is None and own is not None and place(other.slot) == own:
            leave = f"POST /v1/rotors/{rotor}/blades/{other.id}/retirement first"
            return _fault("slot", blade, other, f"{leave}, or give another slot")
    return None


def _fault(what: str, blade: BladeRecord, other: BladeRecord, remedy: str) -> InputError:
    problem = f"is where blade {_told(other)} runs; blade {_told(blade)} cannot run there, too"
    return InputError(what, blade.slot, problem, remedy)


def _told(blade: BladeRecord) -> str:
    hours = "" if blade.time_h0 is None else f"; time_h0 = {blade.time_h0:g} h"
    return f"{blade.id} (slot {blade.slot}{hours})"
