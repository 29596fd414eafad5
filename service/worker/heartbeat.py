"""A lease prolonged by a thread while its work runs.

To start a thread and to end it takes as long as to ask the database, and most work is over before
the first beat. So a thread that works has one other thread beside it, which sleeps from beat to
beat over the ends and beginnings of its works, and ends where it wakes and none is under way.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field

from service.errors import StoreAwayError


class Deadline:
    """When the work at hand, or the step of it that is under way, has taken too long."""

    def __init__(self, seconds: float = math.inf) -> None:
        self.seconds = seconds
        self.again()

    def again(self) -> None:
        """The next step begins."""
        self.end = time.monotonic() + self.seconds

    @property
    def left_s(self) -> float:
        return self.end - time.monotonic()


@dataclass(eq=False)
class _Work:
    """A block of `heartbeats` that is under way."""

    beat: Callable[[], bool]
    every_s: float
    deadline: Deadline
    overdue: Callable[[], None]
    next: float = field(init=False)

    def __post_init__(self) -> None:
        self.rest()

    def rest(self) -> None:
        self.next = time.monotonic() + self.every_s

    @property
    def due(self) -> float:
        """When something is to be done for it."""
        return min(self.next, self.deadline.end)

    def goes_on(self) -> bool:
        """Beat, if it is time to; False: no more."""
        if self.deadline.left_s <= 0.0:
            self.overdue()
            return False
        if self.next <= time.monotonic():
            with suppress(StoreAwayError):
                if not self.beat():
                    return False
            self.rest()
        return True


class _Heart(threading.local):
    """What beats for the works of one thread; who asks for one has that of its own thread."""

    def __init__(self) -> None:
        self.own = Pulse()


class Pulse:
    """Works that are under way, and the thread that beats for them. A beat has the lock, so that
    who ends a work waits for its beat."""

    def __init__(self) -> None:
        self._turn = threading.Condition()
        self._works: list[_Work] = []
        self._wakes = math.inf  # when the thread does
        self._beating = False
        self._thread: threading.Thread | None = None

    def add(self, work: _Work) -> None:
        with self._turn:
            self._works.append(work)
            if not self._beating:
                self._beating, self._wakes = True, work.due
                name = f"heartbeat of {threading.current_thread().name}"
                self._thread = threading.Thread(target=self._run, name=name, daemon=True)
                self._thread.start()
            elif work.due < self._wakes:
                self._turn.notify()

    def remove(self, work: _Work) -> None:
        with self._turn:
            if work in self._works:
                self._works.remove(work)

    def end(self) -> None:
        """No work is under way: end the thread, if there is one."""
        with self._turn:
            self._wakes = -math.inf  # it may not sleep yet
            self._turn.notify()
            thread, self._thread = self._thread, None
        if thread is not None:
            thread.join()

    def _run(self) -> None:
        with self._turn:
            try:
                # The work that it was begun for may be over by now, and the next one not begun.
                if (left_s := self._wakes - time.monotonic()) > 0.0:
                    self._turn.wait(left_s)
                while self._works:
                    work = min(self._works, key=lambda one: one.due)
                    self._wakes, left_s = work.due, work.due - time.monotonic()
                    if left_s > 0.0:
                        self._turn.wait(left_s)
                        continue
                    self._works.remove(work)
                    if work.goes_on():
                        self._works.append(work)
            finally:
                self._beating = False


_HEART = _Heart()


def rest() -> None:
    """Who calls this works no more: the thread that beat for it ends."""
    _HEART.own.end()


@contextmanager
def heartbeats(
    beat: Callable[[], bool],
    lease_s: float,
    deadline: Deadline | None = None,
    overdue: Callable[[], None] = lambda: None,
) -> Iterator[None]:
    """Call `beat` every third of the lease while the block runs, until it says the lease is lost.

    A database that is away for a moment is no loss: the next beat comes. After the deadline there
    is none any more, and `overdue` is called: a thread that beats does not know whether the work
    goes on or hangs.
    """
    work, pulse = _Work(beat, lease_s / 3, deadline or Deadline(), overdue), _HEART.own
    pulse.add(work)
    try:
        yield
    finally:
        pulse.remove(work)
