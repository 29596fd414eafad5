"""Server-sent events: every commit once and in order, from any event on, and nothing held."""

from __future__ import annotations

import asyncio
import itertools
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
import uvicorn
from sqlalchemy import delete, func, select

from core.observation import Inspection
from service.api.feed import LOOK_AGAIN_S, Feed
from service.api.routers import events as routes
from service.api.server import Server
from service.api.waiting import Changes
from service.bootstrap import make_app, make_worker
from service.client import Client, ProblemError
from service.fake import FakeScience
from service.handlers import events as use
from service.handlers.rotors import create_rotor, retry, view_rotor
from service.ports import BladeRecord
from service.settings import Settings
from service.sse import events
from service.store import outbox
from service.store import tables as t
from service.store.engine import transaction
from service.store.outbox import SqlOutbox, trim
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker
from tests.patience import PATIENCE_S, until
from tests.service.conftest import RunningServer
from tests.service.test_processes import serving

Make = Callable[..., Inspection]
Post = Callable[..., int]
Json = dict[str, Any]
KEPT = 5


@pytest.fixture
def settings(database_url: str) -> Settings:
    return Settings(
        database_url=database_url,
        science="fake",
        lease_s=30.0,
        retry_base_s=0.0,
        seal_after_s=0.0,
        heartbeat_s=0.3,
        keep_events=KEPT,
    )


@contextmanager
def listening(api: httpx.Client, **given: Any) -> Iterator[Iterator[str]]:
    """The lines of a rotor's stream; a read that waits for too long fails."""
    headers = given.pop("headers", {})
    url = f"/v1/rotors/{given.pop('rotor', 'r1')}/events"
    with api.stream("GET", url, params=given, headers=headers, timeout=PATIENCE_S) as answer:
        assert answer.status_code == 200, answer.read()
        assert answer.headers["content-type"].startswith("text/event-stream")
        yield answer.iter_lines()


def take(lines: Iterator[str], count: int) -> list[Json]:
    return list(itertools.islice(events(lines), count))


def versions(found: list[Json]) -> list[int]:
    return [one["version"] for one in found]


def live(worker: Worker, post: Post, rotor: str, readings: list[Inspection]) -> None:
    for one in readings:
        post(rotor, one)
        worker.drain()


def test_each_version_is_told_once_as_it_is_committed(
    api: httpx.Client, worker: Worker, rotor: str, reading: Make, post: Post
) -> None:
    worker.drain()
    with listening(api) as lines:
        first = next(events(lines))
        assert (first["event"], first["rotor"], first["version"]) == ("applied", "r1", 1)
        live(worker, post, rotor, [reading(f"i{i}") for i in range(3)])
        found = take(lines, 3)
    assert versions(found) == [2, 3, 4]
    assert [one["through_seq"] for one in found] == [1, 2, 3]
    assert [one["sealed"] for one in found] == [True] * 3
    numbers = [first["id"], *(one["id"] for one in found)]
    assert numbers == sorted(set(numbers))


def test_a_lost_connection_goes_on_from_any_event_without_a_gap(
    api: httpx.Client, worker: Worker, rotor: str, reading: Make, post: Post
) -> None:
    worker.drain()
    live(worker, post, rotor, [reading(f"i{i}") for i in range(4)])
    with listening(api, after=0) as lines:
        whole = take(lines, 5)
    assert versions(whole) == [1, 2, 3, 4, 5]
    for known in range(1, 5):
        number = whole[known - 1]["id"]
        with listening(api, after=number) as lines:
            assert take(lines, 5 - known) == whole[known:]
        header = {"Last-Event-ID": str(number)}
        with listening(api, headers=header) as lines:
            assert take(lines, 5 - known) == whole[known:]
        with listening(api, after=0, headers=header) as lines:  # as browsers connect again
            assert take(lines, 5 - known) == whole[known:]


def test_more_notes_than_a_page_come_whole(
    api: httpx.Client,
    worker: Worker,
    rotor: str,
    reading: Make,
    post: Post,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(use, "PAGE", 2)
    worker.drain()
    live(worker, post, rotor, [reading(f"i{i}") for i in range(4)])
    with listening(api, after=0) as lines:
        assert versions(take(lines, 5)) == [1, 2, 3, 4, 5]


def test_rotors_do_not_hear_of_each_other(
    api: httpx.Client, store: SqlStore, worker: Worker, rotor: str, reading: Make, post: Post
) -> None:
    create_rotor(store, "other", "rotor-blade", [BladeRecord("B1")], 64, 7)
    worker.drain()
    with listening(api) as here, listening(api, rotor="other") as there:
        mine, theirs = events(here), events(there)
        assert {next(mine)["rotor"], next(theirs)["rotor"]} == {"r1", "other"}
        live(worker, post, "other", [reading("a")])
        assert next(theirs)["version"] == 2
        live(worker, post, rotor, [reading("b")])
        assert (last := next(mine))["rotor"] == "r1"
        assert last["version"] == 2


class Failing(FakeScience):
    def update(self, *args: Any, **given: Any) -> Any:
        raise ValueError("never works")


def test_a_blocked_rotor_is_told_with_its_error(
    api: httpx.Client, store: SqlStore, worker: Worker, settings: Settings, rotor: str
) -> None:
    worker.drain()
    with listening(api) as lines:
        assert next(events(lines))["version"] == 1
        create = make_worker(store, Failing(), settings, "failing")
        with store.write() as tx:
            tx.connection.execute(t.cursor.update().values(dirty=True, version=0))
        create.drain()
        found = take(lines, 1)[0]
    assert found["event"] == "blocked"
    assert found["error"].startswith("ValueError: never works")


def reset_after_retention(api: httpx.Client, store: SqlStore, worker: Worker) -> None:
    """From before what is kept a client is told so, and never gets a gap in silence."""
    with store.read() as tx:
        numbers = [note.id for note in tx.outbox.after("r1", 0, 100)]
    trim(store.engine, "r1", 2)
    with listening(api, after=numbers[0]) as lines:
        told = events(lines)
        first = next(told)
        assert first["event"] == "reset", "a gap in silence"
        assert (first["rotor"], first["version"], first["through_seq"]) == ("r1", 5, 4)
        assert first["id"] == numbers[-1]
    with listening(api, after=numbers[-3]) as lines:
        assert versions(take(lines, 2)) == [4, 5], "the last that was dropped is known"


def four_readings(worker: Worker, rotor: str, reading: Make, post: Post) -> None:
    worker.drain()
    live(worker, post, rotor, [reading(f"i{i}") for i in range(4)])


def test_a_replay_from_before_what_is_kept_begins_with_a_reset(
    api: httpx.Client, store: SqlStore, worker: Worker, rotor: str, reading: Make, post: Post
) -> None:
    four_readings(worker, rotor, reading, post)
    reset_after_retention(api, store, worker)
    with listening(api, after=10**9) as lines:
        told = events(lines)
        assert next(told)["event"] == "reset", "an id of another database"
        live(worker, post, rotor, [reading("new")])
        assert next(told)["version"] == 6, "and it goes on"


def test_an_id_that_the_rotor_never_had_begins_with_a_reset(
    store: SqlStore, worker: Worker, rotor: str, reading: Make, post: Post
) -> None:
    """A database that was restored gives numbers again: others may have gone beyond the one that a
    client knows before it comes back, and what its rotor had meanwhile would not be told."""
    four_readings(worker, rotor, reading, post)
    with store.read() as tx:
        known = tx.outbox.newest([rotor])[rotor]
    with transaction(store.engine, write=True) as connection:
        lost = t.outbox.c.id > known - 2
        connection.execute(delete(t.outbox).where(t.outbox.c.rotor_id == rotor, lost))
    create_rotor(store, "r2", "rotor-blade", [BladeRecord("B1")], 64, 7)
    worker.drain()
    live(worker, post, "r2", [reading(f"i{i}") for i in range(3)])
    assert use.news(store, rotor, known).reset
    assert not use.news(store, rotor, known - 2).reset


def test_without_the_question_what_is_missing_a_gap_is_noticed(
    api: httpx.Client,
    store: SqlStore,
    worker: Worker,
    rotor: str,
    reading: Make,
    post: Post,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    four_readings(worker, rotor, reading, post)
    monkeypatch.setattr(SqlOutbox, "missing", lambda self, rotor_id, number: False)
    with pytest.raises(AssertionError, match="a gap in silence"):
        reset_after_retention(api, store, worker)


def count_notes(store: SqlStore) -> int:
    with store.read() as tx:
        return int(tx.connection.execute(select(func.count()).select_from(t.outbox)).scalar_one())


def test_the_outbox_stays_bounded_by_updates_and_by_blockings_and_numbers_never_come_again(
    store: SqlStore, worker: Worker, settings: Settings, rotor: str, reading: Make, post: Post
) -> None:
    live(worker, post, rotor, [reading(f"i{i}") for i in range(3 * 16)])
    assert count_notes(store) <= KEPT + 16
    with store.read() as tx:
        newest = tx.outbox.newest([rotor])[rotor]
    post(rotor, reading("bad"))
    failing = make_worker(store, Failing(), settings, "failing")
    for _ in range(2 * KEPT):
        failing.drain()
        assert view_rotor(store, rotor).rotor.blocked
        retry(store, rotor)
    assert count_notes(store) == KEPT
    with store.read() as tx:
        assert [n.kind for n in tx.outbox.after(rotor, newest, 100)] == ["blocked"] * KEPT
        assert tx.outbox.newest([rotor])[rotor] == newest + 2 * KEPT
    trim(store.engine, rotor, 0)
    assert count_notes(store) == 1, "the newest stays, or SQLite would give its number again"


def test_what_was_dropped_is_never_said_to_be_less(
    store: SqlStore,
    worker: Worker,
    rotor: str,
    post: Post,
    reading: Make,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two workers trim at once: the one that looked first writes last."""
    four_readings(worker, rotor, reading, post)
    with store.read() as tx:
        numbers = [note.id for note in tx.outbox.after(rotor, 0, 100)]
    real, waiting = outbox.transaction, [True]

    def late(engine: Any, *, write: bool) -> Any:
        if write and waiting and waiting.pop():
            trim(engine, rotor, 1)
        return real(engine, write=write)

    monkeypatch.setattr(outbox, "transaction", late)
    trim(store.engine, rotor, 3)
    with store.read() as tx:
        assert [note.id for note in tx.outbox.after(rotor, 0, 100)] == numbers[-1:]
        assert tx.outbox.missing(rotor, numbers[-3])
        assert not tx.outbox.missing(rotor, numbers[-2])


def test_a_silent_stream_gives_signs_of_life(api: httpx.Client, worker: Worker, rotor: str) -> None:
    worker.drain()
    with listening(api) as lines:
        alive = [line for line in itertools.islice(lines, 12) if line == ": alive"]
    assert len(alive) >= 2


@contextmanager
def raw_clients(server: RunningServer, count: int) -> Iterator[list[socket.socket]]:
    """Connections that asked for the stream and got its beginning."""
    request = b"GET /v1/rotors/r1/events HTTP/1.1\r\nHost: localhost\r\n\r\n"
    sockets = []
    try:
        for _ in range(count):
            one = socket.create_connection(("127.0.0.1", server.port), timeout=PATIENCE_S)
            sockets.append(one)
            one.sendall(request)
        for one in sockets:
            seen = b""
            while b"event: applied" not in seen:
                seen += (more := one.recv(4096))
                assert more, f"ended after {seen!r}"
        yield sockets
    finally:
        for one in sockets:
            one.close()


def test_idle_clients_hold_no_thread_and_no_connection_and_are_let_go(
    api: httpx.Client,
    server: RunningServer,
    store: SqlStore,
    worker: Worker,
    rotor: str,
    reading: Make,
    post: Post,
) -> None:
    worker.drain()
    pool: Any = store.engine.pool
    feed: Feed = server.switch.app.state.feed  # type: ignore[attr-defined]
    with raw_clients(server, 2):
        threads, held = threading.active_count(), pool.checkedout()
    with raw_clients(server, 60) as clients:
        until("idleness", lambda: pool.checkedout() <= max(held, 1))
        asked: list[int] = []
        begun = time.monotonic()
        real = feed._newest
        feed._newest = lambda names: asked.append(len(names)) or real(names)
        assert threading.active_count() <= threads + 40, "the pool of the event loop, at most"
        time.sleep(1.2)
        looks = len(asked)
        most = (time.monotonic() - begun) / LOOK_AGAIN_S + 3
        assert looks <= most, "one look for all of them a second"
        assert set(asked) <= {1}
        live(worker, post, rotor, [reading("a")])
        for one in clients:
            seen = b""
            while b'"version": 2' not in seen:
                seen += (more := one.recv(4096))
                assert more, f"ended after {seen!r}"
    until("the end of all listeners", lambda: feed.listeners == 0)


def test_a_commit_between_the_first_read_and_the_listening_is_not_missed(
    store: SqlStore,
    science: FakeScience,
    settings: Settings,
    worker: Worker,
    rotor: str,
    reading: Make,
    post: Post,
) -> None:
    """Another listener's look has seen it already, so that no further look would wake this one."""
    patient = settings.model_copy(update={"heartbeat_s": 3600.0})
    app = make_app(store, science, patient)
    services, feed = app.state.services, app.state.feed
    worker.drain()

    async def scene() -> str:
        services.changes.start()
        first = use.news(store, rotor, None)
        async with feed.listening(rotor) as other:
            await asyncio.wait_for(other.wait(), PATIENCE_S)
            other.clear()
            await asyncio.to_thread(live, worker, post, rotor, [reading("a")])
            await asyncio.wait_for(other.wait(), PATIENCE_S)
            stream = routes.stream(services, feed, rotor, first)
            text = ""
            while '"version": 2' not in text:
                text += await asyncio.wait_for(anext(stream), PATIENCE_S)
            await stream.aclose()
        services.changes.close()
        return text

    assert asyncio.run(scene()).count("event: applied") == 2


class InTheHandler(Server):
    """The mutant: who waits is released by the signal's handler itself."""

    def handle_exit(self, sig: int, frame: Any) -> None:
        if self.changes is not None:
            self.changes.begin_close()
        super().handle_exit(sig, frame)


@pytest.mark.parametrize(("kind", "hangs"), [(Server, False), (InTheHandler, True)])
def test_a_stop_signal_that_comes_inside_a_lock_does_not_wait_for_it(
    kind: type[Server], hangs: bool
) -> None:
    """A handler runs in the thread that it interrupts, which cannot give its lock back."""
    server = kind(uvicorn.Config(Feed))
    server.changes = Changes(lambda: pytest.fail("nobody watches"))
    handler = threading.Thread(target=server.handle_exit, args=(signal.SIGTERM, None), daemon=True)
    with server.changes._busy._cond:
        handler.start()
        handler.join(0.5 if hangs else PATIENCE_S)
        assert handler.is_alive() == hangs
    handler.join(PATIENCE_S)
    assert server.should_exit


def test_streams_end_when_the_server_stops(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'x.db'}"
    settings = Settings(database_url=url, science="fake", sealers=0, diagnosers=0)
    with serving(settings) as (process, client):
        client.create_rotor("r1", blades=["B1"])
        client.wait_for("r1", 0)
        with Client(str(client._http.base_url)) as other:
            stream = other.events("r1")
            assert next(stream)["version"] == 1
            process.send_signal(signal.SIGTERM)
            assert list(stream) == [], "the end, and no broken connection"
        assert process.wait(PATIENCE_S) == 0


def test_the_client_listens_and_a_rotor_that_is_not_there_is_a_problem(
    api: httpx.Client, worker: Worker, rotor: str
) -> None:
    worker.drain()
    twin = Client(http=api)
    stream = twin.events("r1", after=0)
    assert next(stream)["version"] == 1
    stream.close()
    with pytest.raises(ProblemError, match="404"):
        next(twin.events("nobody"))
    for given in ({"params": {"after": "-1"}}, {"headers": {"Last-Event-ID": "x"}}):
        answer = api.get("/v1/rotors/r1/events", **given)
        assert answer.status_code == 422
        assert answer.json()["faults"][0]["field"] in ("after", "Last-Event-ID")
