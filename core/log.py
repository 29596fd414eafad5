"""Which readings count.

Corrections and retractions are further entries of the log: `effective` folds the log into the
readings that count, in one canonical order, so that every order of arrival gives the same set.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from core.observation import Inspection


@dataclass(frozen=True, slots=True)
class Entry:
    """One entry of the log: an inspection or the retraction of one, with its arrival number."""

    seq: int
    kind: Literal["inspection", "retraction"]
    target: str
    inspection: Inspection | None = None


def effective(entries: Iterable[Entry]) -> tuple[Inspection, ...]:
    """The readings that count, ordered by (time, id).

    A reading counts unless it was retracted or replaced. Retracting a correction brings what it
    replaced back; a chain of corrections counts by its last link. Of two corrections of one reading
    both count: which came later would be a matter of arrival. The result depends on the set of
    entries only, not on their order.

    >>> import numpy as np
    >>> a = Inspection("a", "B1", "elongation", 8000.0, np.array([0.10]))
    >>> b = Inspection("b", "B1", "elongation", 8000.0, np.array([0.11]), replaces="a")
    >>> log = [Entry(1, "inspection", "a", a), Entry(2, "inspection", "b", b)]
    >>> [i.id for i in effective(log)]
    ['b']
    >>> [i.id for i in effective([Entry(3, "retraction", "b"), *log])]
    ['a']
    """
    entries = list(entries)
    gone = {e.target for e in entries if e.kind == "retraction"}
    standing = {
        e.inspection.id: e.inspection
        for e in entries
        if e.inspection is not None and e.inspection.id not in gone
    }
    over = replaced(
        {
            e.inspection.id: e.inspection.replaces
            for e in entries
            if e.inspection is not None and e.inspection.replaces is not None
        },
        gone,
    )
    counts = [i for i in standing.values() if i.id not in over]
    return tuple(sorted(counts, key=lambda i: (i.time_h, i.id)))


def replaced(corrections: Mapping[str, str], gone: Collection[str]) -> set[str]:
    """Of the readings that are not retracted, the ids of those that are replaced.

    A correction that stands replaces the next one up its chain that is not retracted: through one
    that is, a reading stays replaced. None replaces itself.

    corrections   by the id of each, the id that it names
    gone          ids of what was retracted

    >>> replaced({"b": "a", "c": "b"}, {"b"})
    {'a'}
    """
    found = set[str]()
    for own, named in corrections.items():
        if own in gone:
            continue
        above: str | None = named
        passed = {own}
        while above is not None and above in gone and above not in passed:
            passed.add(above)
            above = corrections.get(above)
        if above is not None and above not in passed:
            found.add(above)
    return found
