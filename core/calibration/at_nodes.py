"""What messages made at shared nodes, in case they are asked for it again; up to so many bytes.

The boxes of a closed form (`boxes`) and the proposals of many local parameters (`collapsed`) take
megabytes a blade and set of nodes. A blade's draws need those of its column, and the sealed state
those of the quick one at the same nodes; hardly anybody asks later. But a process keeps thousands
of messages (`workspace.KEPT`). So what all of them hold together is bounded: beyond `MOST_BYTES`
those that were asked longest ago let go of theirs, and make it anew, the same to the last bit, if
they are asked after all.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import partial
from threading import RLock
from typing import Any, Generic, Protocol, TypeVar
from weakref import ref

EACH = 2  # sets of nodes of a message
MOST_BYTES = 2**28  # of all messages of this process, but for the one that was asked last


class Weighty(Protocol):
    """What takes memory."""

    @property
    def nbytes(self) -> int: ...


T = TypeVar("T", bound=Weighty)
_LOCK = RLock()  # one for all: a message may be let go of by another one's thread
_HELD: OrderedDict[int, tuple[ref[AtNodes[Any]], int]] = OrderedDict()


class AtNodes(Generic[T]):
    """What one message made, by what tells the nodes."""

    def __init__(self) -> None:
        self._made: OrderedDict[Hashable, T] = OrderedDict()

    def of(self, key: Hashable, make: Callable[[], T]) -> T:
        """What is kept by this key, or made."""
        with _LOCK:
            found = self._made.get(key)
        made = make() if found is None else found
        with _LOCK:
            self._made[key] = made
            while len(self._made) > EACH:
                self._made.popitem(last=False)
            _hold(self)
        return made

    @property
    def nbytes(self) -> int:
        """Of all that is kept."""
        with _LOCK:
            return sum(one.nbytes for one in self._made.values())

    def let_go(self) -> None:
        """Keep nothing."""
        with _LOCK:
            self._made.clear()


def held_bytes() -> int:
    """Of all messages together."""
    with _LOCK:
        return sum(size for _, size in _HELD.values())


def _hold(owner: AtNodes[Any]) -> None:
    """Note what it holds, as the last that was asked; others let go beyond `MOST_BYTES`."""
    own = id(owner)
    _HELD.pop(own, None)
    _HELD[own] = ref(owner, partial(_gone, own)), owner.nbytes
    total = held_bytes()
    while total > MOST_BYTES and len(_HELD) > 1:
        _, (other, size) = _HELD.popitem(last=False)
        total -= size
        if (alive := other()) is not None:
            alive.let_go()


def _gone(own: int, which: ref[AtNodes[Any]]) -> None:
    with _LOCK:
        if own in _HELD and _HELD[own][0] is which:
            del _HELD[own]
