"""Readings of a file that leave two where one is meant: the service takes them, and both count.

A correction may name a reading that is nowhere, or one that another correction replaces already. A
file that was written anew may give its readings other ids than the last time.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from service.api.problems import Fault, fault
from service.client import Client, ProblemError
from service.handlers.inspections import Item

Said = tuple[object, ...]
SAID = ("blade", "quantity", "time_h", "instrument", "campaign")


def there_is(twin: Client, rotor: str, name: str) -> Mapping[str, Any] | None:
    """A reading of the rotor; None: it has none of this id."""
    try:
        return twin.inspection(rotor, name)
    except ProblemError as error:
        if error.status != 404:
            raise
        return None


def corrections(
    twin: Client, rotor: str, fresh: Sequence[Item], here: Collection[str]
) -> Iterator[Fault]:
    """New corrections that leave another reading beside them.

    here   ids of the file
    """
    first: dict[str, str] = {}
    for item in fresh:
        target = item.reading.replaces
        if target is None:
            continue
        other = first.setdefault(target, item.where)
        stored = None if other != item.where else there_is(twin, rotor, target)
        if other != item.where:
            problem = f"is replaced by {other.rstrip('.')}, too: both will count"
            remedy = "leave one out, or replace the other correction"
        elif stored is not None and stored["status"] == "replaced":
            problem = "is replaced already: its other correction and this one will both count"
            remedy = "replace the correction that counts"
        elif stored is None and target not in here:
            problem = "is no reading of the rotor yet: until it comes, this corrects nothing"
            remedy = "see whether the id is right"
        else:
            continue
        yield fault(f"{item.where}replaces", target, problem, remedy)


def repetitions(
    twin: Client, rotor: str, fresh: Sequence[Item], blades: Collection[str]
) -> Iterator[Fault]:
    """New readings of single values that say what another one says that counts, of the rotor or of
    the file, under another id.

    blades   of the rotor
    """
    named = {item.reading.blade for item in fresh if item.reading.values.shape == (1,)}
    said: dict[Said, str] = {}
    for blade in sorted(named & set(blades)):
        for one in twin.inspections(rotor, blade=blade):
            if one["status"] == "counts" and one["values"] is not None:
                said.setdefault(_said(one), one["id"])
    for item in fresh:
        own = _said(item.reading.to_json())
        other = said.setdefault(own, item.reading.id)
        if other not in (item.reading.id, item.reading.replaces):
            problem = f"says what {other} says (blade, quantity, hours, value): both will count"
            yield fault(
                f"{item.where}id", item.reading.id, problem, "leave it out if it is the same"
            )


def _said(one: Mapping[str, Any]) -> Said:
    return (*(one.get(name) for name in SAID), str(one.get("nodes")), str(one["values"]))
