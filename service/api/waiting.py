"""Readers that wait for a version are woken by the commit that brings it.

One thread watches the database while somebody waits, and tells the event loop; a waiting request
holds no thread and no connection.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Protocol

IDLE_S = 0.5  # between looks while nobody waits


class Watcher(Protocol):
    """Sleeps until something was committed (service.worker.wake)."""

    def wait(self, timeout_s: float) -> bool: ...
    def skip(self) -> None: ...
    def close(self) -> None: ...


class Changes:
    """Hints that something was committed."""

    def __init__(self, open_watcher: Callable[[], Watcher]) -> None:
        self._open = open_watcher
        self._waiters = 0
        self._busy = threading.Event()
        self._closed = threading.Event()
        self._event = asyncio.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin to watch; called inside the event loop."""
        loop = asyncio.get_running_loop()
        self._thread = threading.Thread(target=self._watch, args=(loop,), daemon=True)
        self._thread.start()

    def _watch(self, loop: asyncio.AbstractEventLoop) -> None:
        watcher = self._open()
        try:
            while not self._closed.is_set():
                told = watcher.wait(0.2) if self._busy.wait(IDLE_S) else self._skipped(watcher)
                if told and not self._closed.is_set():
                    loop.call_soon_threadsafe(self._fire)
        finally:
            watcher.close()

    def _skipped(self, watcher: Watcher) -> bool:
        """Whether somebody came meanwhile, who may have looked before what was skipped."""
        watcher.skip()
        return self._busy.is_set()

    def _fire(self) -> None:
        self._event.set()
        self._event = asyncio.Event()

    @property
    def closing(self) -> bool:
        return self._closed.is_set()

    def begin_close(self) -> None:
        """Let everybody who waits go; called inside the event loop, not in a signal's handler."""
        self._closed.set()
        self._busy.set()
        self._fire()

    def close(self) -> None:
        self.begin_close()
        if self._thread is not None:
            self._thread.join()

    @asynccontextmanager
    async def waiting(self) -> AsyncIterator[None]:
        """While inside, the database is watched."""
        self._waiters += 1
        self._busy.set()
        try:
            yield
        finally:
            self._waiters -= 1
            if self._waiters == 0 and not self.closing:
                self._busy.clear()

    def event(self) -> asyncio.Event:
        """Set at the next commit: take it before looking, wait for it after."""
        return self._event
