"""Corrections that lead back to themselves.

They would replace one another, and none count. Which of them came first is a matter of arrival, so
that the one that closes the circle is refused. This is looked up while the rotor is locked, in few
questions: other writers wait.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from core.errors import InputError
from service.errors import MOST_FAULTS
from service.ports import Transaction

if TYPE_CHECKING:
    from service.handlers.inspections import Item

LONGEST = 200  # characters of a circle that a fault shows


def circles(tx: Transaction, rotor_id: str, items: Sequence[Item]) -> list[InputError]:
    """Each correction of a batch that closes a circle, by its place."""
    named = {i.reading.id: i.reading.replaces for i in items if i.reading.replaces is not None}
    links = _links(tx, rotor_id, named)
    ends, around = set[str](), dict[str, str]()  # what leads to an end; what stands in a circle
    found: list[InputError] = []
    for item in items:
        own = item.reading.id
        if named.get(own, own) == own or len(found) > MOST_FAULTS:
            continue
        path: dict[str, None] = {}
        above: str | None = own
        while above is not None and not (above in path or above in ends or above in around):
            path[above] = None
            above = links[above]
        if above == own and path:
            shown = " → ".join([*path, own])
            around |= dict.fromkeys(path, shown if len(shown) <= LONGEST else f"{shown[:LONGEST]}…")
        elif own not in around:
            ends.update(path)  # `|=` with keys would copy the set each time
        if own in around:
            problem = f"leads back to {own} ({around[own]})"
            remedy = "give a correction a new id, and name the reading that it corrects"
            found.append(InputError(f"{item.where}replaces", named[own], problem, remedy))
    return found


def _links(tx: Transaction, rotor_id: str, named: Mapping[str, str]) -> dict[str, str | None]:
    """What each correction of a batch names, and what each reading of the log above them names.

    The log is asked level by level, so that a batch costs no more questions than its chains are
    long, times its chunks.
    """
    links: dict[str, str | None] = dict(named)
    above = set(named.values()) - links.keys()
    while above:
        there = tx.log.replaced(rotor_id, sorted(above))
        links |= dict.fromkeys(above) | there
        above = {name for name in there.values() if name is not None} - links.keys()
    return links
