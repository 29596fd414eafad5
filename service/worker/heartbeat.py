"""A lease prolonged by a thread while its work runs."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from service.errors import StoreAwayError


@contextmanager
def heartbeats(beat: Callable[[], bool], lease_s: float) -> Iterator[None]:
    """Call `beat` every third of the lease while the block runs, until it says the lease is lost.

    A database that is away for a moment is no loss: the next beat comes.
    """
    stop = threading.Event()

    def beats() -> None:
        while not stop.wait(lease_s / 3):
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
