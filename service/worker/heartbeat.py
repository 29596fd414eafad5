"""A lease prolonged by a thread while its work runs."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

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
    stop, due = threading.Event(), deadline or Deadline()

    def beats() -> None:
        while not stop.wait(max(0.0, min(lease_s / 3, due.left_s))):
            if due.left_s <= 0.0:
                overdue()
                return
            with suppress(StoreAwayError):
                if not beat():
                    return

    thread = threading.Thread(target=beats, name="heartbeat", daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
