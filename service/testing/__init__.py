"""The service in memory, for users' own tests.

    from service.testing import in_memory

    def test_mine():
        with in_memory() as twin:
            twin.create_rotor("r1", blades=["B01"])
            twin.wait_for("r1", twin.post_csv("r1", text))
            assert twin.prediction("r1", "B01", "elongation", times=[8000])["mean"][0] > 0

It is the service itself: application, database, workers in threads, so that an answer is as
asynchronous as from `bladetwin serve`; only nothing listens on a port. Events stream, long polls
wait, timeouts hold. A worker applies, seals and registers; another one diagnoses and computes
residuals (``diagnosers=0``: none); with a `webhook_key_file` a third one sends.

What it believes comes from the exact Gaussian twin (`service.fake`), which answers in
milliseconds, or with ``in_memory(science="core")`` from the blade physics, after some seconds of
loading and with bits that may differ in the last digit from those of a worker in a process of its
own. The database is a SQLite file in a temporary folder, for in memory that SQLite shares between
connections a reader is refused while another thread writes. It is not flushed to disk, and removed
at the end.

Where a worker dies every request that is open ends with WorkerDiedError, and so does leaving.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Any

from service.client import AsyncClient, Client
from service.ports import Science
from service.testing.running import Running, WorkerDiedError

__all__ = [
    "InMemory",
    "InMemoryAsync",
    "Running",
    "WorkerDiedError",
    "in_memory",
    "in_memory_async",
]


class InMemory(Client):
    """A client of a service in memory, with a key of every scope where it asks for keys.

    running   the service: `running.key("read")` makes a key, `running.http(key)` a connection for
              another `Client(http=…)`
    """

    def __init__(self, running: Running) -> None:
        super().__init__(http=running.http(running.own_key()))
        self.running = running


class InMemoryAsync(AsyncClient):
    """The same to be awaited, in any loop."""

    def __init__(self, running: Running) -> None:
        super().__init__(http=running.async_http(running.own_key()))
        self.running = running


@contextmanager
def in_memory(science: str | Science = "fake", **settings: Any) -> Iterator[InMemory]:
    """A service of one's own until the block ends; any number at once, each alone.

    science    fake, core, or a `Science` (e.g. ``FakeScience(delay_s=1.0)``)
    settings   by their names in `service.settings.Settings`, e.g. ``keys="always"``; the
               environment does not count
    """
    with Running(science, settings) as running, InMemory(running) as twin:
        yield twin


@asynccontextmanager
async def in_memory_async(
    science: str | Science = "fake", **settings: Any
) -> AsyncIterator[InMemoryAsync]:
    """The same with a client to be awaited; the loop goes on while it begins and ends."""
    running = Running(science, settings)
    await asyncio.to_thread(running.__enter__)
    try:
        async with InMemoryAsync(running) as twin:
            yield twin
    except BaseException:
        await asyncio.to_thread(running.__exit__, *sys.exc_info())
        raise
    await asyncio.to_thread(running.__exit__, None, None, None)
