"""What a worker remembers of its rotors: the last states, the readings of more.

A state is used only while its version is the one that the claim read. To read one anew takes
long, but a state may be of some kilobytes or of tens of megabytes: so they are kept up to a number
of bytes, and to a number. Readings are of the log, which only grows, so that those through an entry
hold for ever, and an update reads what came since.
To read and check the readings of a rotor anew costs some 25 µs for each (SQL, JSON, digest):
without memory an update takes the longer the longer its rotor is in service, and a worker that
cares for many rotors would do little else. They are kept packed (`packing`), up to a number of
bytes.

A database that was restored, or whose place a replica took that had not heard of the last commits,
goes on from an earlier moment and may come to the same numbers by another way. So what a memory
ends with is compared with the database before it is used (`service.worker.task`).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field

from service.ports import Event, PartlyLoaded, RotorState
from service.worker.packing import PackedLog

ROTOR_BYTES = 800  # a rotor without entries, measured
ARRAY_BYTES = 600  # an array's objects, SHA-256 and place in the description beside its numbers
NO_VERSION = -1
Mark = tuple[str, str, float]


@dataclass(slots=True)
class Memory:
    """What a worker remembers of a rotor: valid for one version only.

    version  `NO_VERSION` where only the readings are remembered
    anew     the stored state is not used, and all that replaces it is written
    last     what entry `through` is called by; None: no entry
    digest   what the version is called by; None: none yet
    log      the entries through that one
    """

    version: int
    through: int
    state: RotorState | None
    sha256: dict[str, str]
    anew: bool = False
    last: Mark | None = None
    digest: str | None = None
    log: PackedLog = field(default_factory=PackedLog)

    @property
    def state_bytes(self) -> int:
        """Of the state's arrays that are in memory; those still to be loaded are not."""
        if self.state is None:
            return 0
        arrays = self.state.arrays
        held = arrays.held if isinstance(arrays, PartlyLoaded) else arrays
        return sum(array.nbytes for array in held.values()) + ARRAY_BYTES * len(arrays)

    @property
    def log_bytes(self) -> int:
        return ROTOR_BYTES + self.log.nbytes


def mark(events: Sequence[Event], before: Mark | None) -> Mark | None:
    """What the last of the entries is called by; without any, what the one before them is."""
    if not events:
        return before
    return events[-1].event_id, events[-1].digest, events[-1].received_at


class Memories:
    """The rotors that a worker saw last; used by one thread.

    states       how many are kept with their state
    states_mb    size of these states, MiB; that of the last one is kept whatever its size
    readings_mb  size of the readings, MiB; those of the last one are kept whatever their size
    """

    def __init__(self, states: int, states_mb: float, readings_mb: float) -> None:
        self._most, self._room = states, int(states_mb * 2**20)
        self._limit = int(readings_mb * 2**20)
        self._sizes: dict[str, int] = {}  # of the states
        self._held = 0  # their sum
        self._states: OrderedDict[str, Memory] = OrderedDict()
        self._logs: OrderedDict[str, Memory] = OrderedDict()  # without their states
        self._bytes = 0  # of the logs

    def get(self, rotor_id: str) -> Memory | None:
        """What is remembered of a rotor; None: nothing."""
        return self._states.get(rotor_id) or self._logs.get(rotor_id)

    def put(self, rotor_id: str, memory: Memory) -> None:
        """Remember a rotor as the one seen last; what is beyond a limit is forgotten."""
        self.forget(rotor_id)
        self._states[rotor_id] = memory
        self._sizes[rotor_id] = size = memory.state_bytes
        self._held += size
        self._logs[rotor_id] = rest = Memory(
            NO_VERSION, memory.through, None, {}, last=memory.last, log=memory.log
        )
        self._bytes += rest.log_bytes
        while len(self._states) > self._most or (self._held > self._room and len(self._states) > 1):
            self._drop(next(iter(self._states)))
        while self._bytes > self._limit and len(self._logs) > 1:
            self.forget(next(iter(self._logs)))

    def _drop(self, rotor_id: str) -> None:
        """Its state, if it is kept."""
        self._states.pop(rotor_id, None)
        self._held -= self._sizes.pop(rotor_id, 0)

    def forget(self, rotor_id: str) -> None:
        """All that is remembered of a rotor."""
        self._drop(rotor_id)
        rest = self._logs.pop(rotor_id, None)
        self._bytes -= 0 if rest is None else rest.log_bytes
