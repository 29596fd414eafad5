"""Who waits is woken by a commit, and while nobody does nothing is heaped up for them."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import psycopg
import pytest
from sqlalchemy import Engine, event, text

from core.observation import Inspection
from service.api import waiting
from service.api.routers import rotors
from service.api.waiting import Changes
from service.handlers.rotors import create_rotor
from service.ports import BladeRecord
from service.store.engine import open_engine, transaction
from service.store.outbox import post as note
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker
from service.worker.wake import PostgresWake, open_wake
from tests.patience import AGES_S, PATIENCE_S, until
from tests.postgres import Databases

CHANNEL = "bladetwin_applied"
TELL = text("SELECT count(pg_notify(:channel, :lot || g)) FROM generate_series(1, 1000) AS g")
LISTENER = text(
    "SELECT wait_event FROM pg_stat_activity WHERE datname = current_database()"
    " AND query LIKE 'LISTEN%'"
)


@pytest.fixture
def engine(databases: Databases) -> Iterator[Engine]:
    name = databases.take()
    opened = open_engine(databases.url(name))
    yield opened
    opened.dispose()
    databases.give(name)


def told(engine: Engine, lots: int) -> None:
    """Notes of a thousand rotors at a time, which take more than a connection holds unread."""
    for lot in range(lots):
        with transaction(engine, write=True) as connection:
            connection.execute(TELL, {"channel": CHANNEL, "lot": f"rotor-{lot}-"})


def listens(engine: Engine) -> bool:
    """Whether there is a listener."""
    with transaction(engine, write=False) as connection:
        return bool(connection.execute(LISTENER).all())


def reads(engine: Engine) -> bool:
    """Whether the listener's server waits to be asked, not for the listener to read."""
    with transaction(engine, write=False) as connection:
        return connection.execute(LISTENER).scalar_one() == "ClientRead"


def test_what_is_told_while_nobody_waits_is_read_all_the_same(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """PostgreSQL's queue of notifications has an end, at which no commit succeeds any more."""
    monkeypatch.setattr(waiting, "IDLE_S", 0.02)

    async def idle() -> bool:
        changes = Changes(lambda: open_wake(engine, CHANNEL, 5.0))
        changes.start()
        await asyncio.to_thread(until, "the listener", lambda: listens(engine))
        await asyncio.to_thread(told, engine, 10)
        end, in_a_row = time.monotonic() + PATIENCE_S, 0
        while in_a_row < 5 and time.monotonic() < end:
            await asyncio.sleep(0.05)
            in_a_row = in_a_row + 1 if await asyncio.to_thread(reads, engine) else 0
        changes.close()
        return in_a_row == 5

    assert asyncio.run(idle())


class Skipping:
    """Somebody commits while what nobody waits for is skipped."""

    def __init__(self) -> None:
        self.skips, self.goes_on = threading.Event(), threading.Event()

    def wait(self, timeout_s: float) -> bool:
        time.sleep(timeout_s)
        return False

    def skip(self) -> None:
        self.skips.set()
        self.goes_on.wait(PATIENCE_S)

    def close(self) -> None: ...


def test_who_comes_while_hints_are_skipped_misses_none() -> None:
    async def come() -> bool:
        watcher = Skipping()
        changes = Changes(lambda: watcher)
        changes.start()
        await asyncio.to_thread(watcher.skips.wait, PATIENCE_S)
        async with changes.waiting():
            event = changes.event()
            watcher.goes_on.set()
            woken = asyncio.create_task(event.wait())
            done, _ = await asyncio.wait([woken], timeout=PATIENCE_S)
            woken.cancel()
        changes.close()
        return bool(done)

    assert asyncio.run(come())


def test_a_standby_is_listened_to_once_it_takes_over(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A standby refuses LISTEN with an error that psycopg calls an internal one."""
    real, refused = psycopg.Connection.execute, 0

    def execute(self: Any, query: Any, *given: Any, **named: Any) -> Any:
        nonlocal refused
        if str(query).startswith("LISTEN") and refused < 2:
            refused += 1
            raise psycopg.errors.ReadOnlySqlTransaction("cannot execute LISTEN during recovery")
        return real(self, query, *given, **named)

    monkeypatch.setattr(psycopg.Connection, "execute", execute)
    wake = open_wake(engine, CHANNEL, 5.0)
    assert isinstance(wake, PostgresWake)
    assert [wake.wait(0.01), refused] == [True, 2]
    assert wake.wait(0.01), "it listens now, and what was before gave no hint"
    assert not wake.wait(0.01)
    told(engine, 1)
    assert wake.wait(PATIENCE_S)
    wake.close()


def test_who_waits_looks_at_little_when_other_rotors_move_on(
    api: httpx.Client,
    store: SqlStore,
    worker: Worker,
    rotor: str,
    reading: Callable[..., Inspection],
    post: Callable[..., int],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each commit wakes all who wait; a rotor with all of its blades is read at the ends alone."""
    create_rotor(store, "r2", "rotor-blade", [BladeRecord("B1")], 64, 7)
    worker.drain()
    monkeypatch.setattr(rotors, "LOOK_AGAIN_S", AGES_S)
    looks = {"rotor": 0, "blades": 0}
    here = threading.current_thread()

    def said(_c: object, _cursor: object, statement: str, *_: object) -> None:
        if "FROM rotor JOIN cursor" in statement and threading.current_thread() is not here:
            looks["blades" if "FROM blade" in statement else "rotor"] += 1

    answers: list[httpx.Response] = []
    url = f"/v1/rotors/{rotor}?wait_for=1&timeout=50"
    waits = threading.Thread(target=lambda: answers.append(api.get(url)))
    event.listen(store.engine, "after_cursor_execute", said)
    waits.start()
    until("its first look", lambda: looks["blades"])
    for number in range(5):
        with transaction(store.engine, write=True) as connection:
            note(connection, "r2", "blocked", {"error": str(number), "event": None})
        until("that it is woken all the same", lambda number=number: looks["rotor"] > number)
    post(rotor, reading("a"))
    worker.drain()
    waits.join()
    event.remove(store.engine, "after_cursor_execute", said)
    assert answers[0].json()["applied_seq"] == 1
    assert looks["blades"] <= 2
