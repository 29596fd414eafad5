"""Clients that listen to a rotor's events are woken when it has news.

One task for all of them asks, after a commit, for the newest note of each rotor that somebody
listens to, in one query, and wakes those whose rotor has a new one. A client that waits holds a
socket and an `asyncio.Event`: no thread, no connection of the database.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager

from starlette.concurrency import run_in_threadpool

from service.api.waiting import Changes

log = logging.getLogger("bladetwin.api")
LOOK_AGAIN_S = 1.0
PAUSE_S = 0.02  # commits that come in a burst are looked at together


class Feed:
    """Wakes the listeners of rotors that have news."""

    def __init__(self, changes: Changes, newest: Callable[[Sequence[str]], dict[str, int]]) -> None:
        self._changes = changes
        self._newest = newest
        self._listeners: dict[str, set[asyncio.Event]] = {}
        self._task: asyncio.Task[None] | None = None

    @property
    def closing(self) -> bool:
        """The server stops: streams end."""
        return self._changes.closing

    @property
    def listeners(self) -> int:
        """Streams that are open now."""
        return sum(map(len, self._listeners.values()))

    @asynccontextmanager
    async def listening(self, rotor_id: str) -> AsyncIterator[asyncio.Event]:
        """An event that is set whenever the rotor has news, or the server stops."""
        event = asyncio.Event()
        self._listeners.setdefault(rotor_id, set()).add(event)
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._watch())
        try:
            yield event
        finally:
            own = self._listeners[rotor_id]
            own.discard(event)
            if not own:
                del self._listeners[rotor_id]

    async def close(self) -> None:
        """Return when the last look has ended; the changes have to be closing."""
        if self._task is not None:
            await self._task

    async def _watch(self) -> None:
        seen: dict[str, int] = {}
        async with self._changes.waiting():
            while self._listeners and not self.closing:
                committed = self._changes.event()
                try:
                    found = await run_in_threadpool(self._newest, list(self._listeners))
                except Exception as error:  # the task must outlive it: all listeners hang on it
                    log.error("%s: %s Listeners wait.", type(error).__name__, error)
                    found = seen
                self._wake([rotor for rotor in found if seen.get(rotor) != found[rotor]])
                seen = found
                if self.closing:
                    break
                try:
                    await asyncio.wait_for(committed.wait(), LOOK_AGAIN_S)
                except TimeoutError:
                    continue
                await asyncio.sleep(PAUSE_S)
        self._wake(list(self._listeners))

    def _wake(self, rotors: Sequence[str]) -> None:
        for rotor in rotors:
            for event in self._listeners.get(rotor, ()):
                event.set()
