"""What a worker remembers of its rotors: the last states of a few, the readings of many.

A state is used only while its version is the one that the claim read. Readings are of the log,
which only grows, so that those through an entry hold for ever, and an update reads what came since.
To read and check the readings of a rotor anew costs some 25 µs for each (SQL, JSON, digest):
without memory an update takes the longer the longer its rotor is in service, and a worker that
cares for many rotors would do little else. States are large, so few of them are kept; readings are
small and kept up to a number of bytes.

A database that was restored, or whose place a replica took that had not heard of the last commits,
goes on from an earlier moment and may come to the same numbers by another way. So what a memory
ends with is compared with the database before it is used (`service.worker.task`).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from core.observation import Entry
from service.ports import Event, RotorState

ENTRY_BYTES = 520  # an entry with its reading, measured; values beyond one and nodes are added
ROTOR_BYTES = 800  # a rotor without entries, measured
NO_VERSION = -1
Mark = tuple[str, str, float]


@dataclass(slots=True)
class Memory:
    """What a worker remembers of a rotor: valid for one version only.

    version  `NO_VERSION` where only the readings are remembered
    anew     the stored state is not used, and all that replaces it is written
    last     what entry `through` is called by; None: no entry
    digest   what the version is called by; None: none yet
    """

    version: int
    through: int
    state: RotorState | None
    sha256: dict[str, str]
    entries: list[Entry]
    anew: bool = False
    last: Mark | None = None
    digest: str | None = None


def mark(events: Sequence[Event], before: Mark | None) -> Mark | None:
    """What the last of the entries is called by; without any, what the one before them is."""
    if not events:
        return before
    return events[-1].event_id, events[-1].digest, events[-1].received_at


def size(entries: Iterable[Entry]) -> int:
    """Bytes that entries take in memory, about.

    >>> size([Entry(1, "retraction", "a"), Entry(2, "retraction", "b")])
    1040
    """
    total = 0
    for entry in entries:
        total += ENTRY_BYTES
        if (reading := entry.inspection) is not None:
            total += reading.values.nbytes - reading.values.itemsize
            total += 0 if reading.nodes is None else reading.nodes.nbytes
    return total


class Memories:
    """The rotors that a worker saw last; used by one thread.

    states       how many are kept with their state, and whatever readings they have
    readings_mb  size of the readings that are kept of further ones, MiB
    """

    def __init__(self, states: int, readings_mb: float) -> None:
        self._most, self._limit = states, int(readings_mb * 2**20)
        self._states: OrderedDict[str, Memory] = OrderedDict()
        self._readings: OrderedDict[str, tuple[Memory, int]] = OrderedDict()
        self._bytes = 0

    def get(self, rotor_id: str) -> Memory | None:
        """What is remembered of a rotor; None: nothing."""
        if (whole := self._states.get(rotor_id)) is not None:
            return whole
        return self._readings.get(rotor_id, (None, 0))[0]

    def put(self, rotor_id: str, memory: Memory) -> None:
        """Remember a rotor as the one seen last; what is beyond a limit is forgotten."""
        self.forget(rotor_id)
        self._states[rotor_id] = memory
        while len(self._states) > self._most:
            name, old = self._states.popitem(last=False)
            taken = ROTOR_BYTES + size(old.entries)
            rest = Memory(NO_VERSION, old.through, None, {}, old.entries, last=old.last)
            self._readings[name] = (rest, taken)
            self._bytes += taken
        while self._bytes > self._limit:
            _, (_, freed) = self._readings.popitem(last=False)
            self._bytes -= freed

    def forget(self, rotor_id: str) -> None:
        """All that is remembered of a rotor."""
        self._states.pop(rotor_id, None)
        _, freed = self._readings.pop(rotor_id, (None, 0))
        self._bytes -= freed
