"""A lease prolonged by a thread while its work runs."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from service.errors import StoreAwayError


@contextmanager
def heartbeats(
    beat: Callable[[], bool],
    lease_s: float,
    most_s: float = math.inf,
    overdue: Callable[[], None] = lambda: None,
) -> Iterator[None]:
    """Call `beat` every third of the lease while the block runs, until it says the lease is lost.

    A database that is away for a moment is no loss: the next beat comes. After `most_s` there is
    none any more, and `overdue` is called: a thread that beats does not know whether the work goes
    on or hangs.
    """
    stop = threading.Event()
    end = time.monotonic() + most_s

    def beats() -> None:
        while not stop.wait(max(0.0, min(lease_s / 3, end - time.monotonic()))):
            if time.monotonic() >= end:
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
