"""What waits for a receiver that is away is bounded, and what is dropped is told."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import ColumnElement, Connection, event, select, text, update

from service.client import Client, read_webhook
from service.handlers.rotors import create_rotor
from service.handlers.webhooks import create_webhook, delete_webhook, find_webhook, list_deliveries
from service.ports import BladeRecord
from service.settings import Settings
from service.store import hook_tables as t
from service.store import untold
from service.store.engine import is_sqlite, transaction
from service.store.outbox import post as note
from service.store.unit_of_work import SqlStore
from service.store.webhooks import prune
from service.worker.deliver import Deliverer
from service.worker.hook_lease import claim_webhook
from tests.patience import PATIENCE_S, behind_a_lock, until
from tests.service.receiver import Receiver, receiving, then

Serving = Callable[..., AbstractContextManager[httpx.Client]]
MOST = 3


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(untold, "WAITING", MOST)


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    with receiving() as running:
        yield running


@pytest.fixture
def settings(settings: Settings, tmp_path: Path) -> Settings:
    file = tmp_path / "webhook_key"
    file.write_text("7d" * 32 + "\n")
    given = {"webhook_key_file": str(file), "webhook_networks": "127.0.0.0/8, ::1"}
    return settings.model_copy(
        update=given | {"webhook_timeout_s": PATIENCE_S, "webhook_max_attempts": 9}
    )


@pytest.fixture
def rotors(store: SqlStore, rotor: str) -> list[str]:
    create_rotor(store, "r2", "rotor-blade", [BladeRecord("B1")], 64, 7)
    return [rotor, "r2"]


@pytest.fixture
def hook(store: SqlStore, settings: Settings, receiver: Receiver) -> Callable[[str], str]:
    def make(name: str) -> str:
        key, allowed = settings.webhook_key_file, settings.webhook_networks
        return str(create_webhook(store, key, allowed, name, receiver.url, None, None)[1])

    return make


@pytest.fixture
def happens(store: SqlStore) -> Callable[..., None]:
    """Blockings of a rotor, each in a transaction of its own."""

    def happen(rotor: str, *errors: str) -> None:
        for error in errors:
            with transaction(store.engine, write=True) as connection:
                note(connection, rotor, "blocked", {"error": error, "event": None})

    return happen


def sent(store: SqlStore, settings: Settings, **given: Any) -> None:
    """Send what can be sent, as if every pause had passed."""
    with transaction(store.engine, write=True) as connection:
        connection.execute(update(t.delivery).values(not_before=None))
    Deliverer(store.engine, settings, f"sender-{os.urandom(3).hex()}", **given).drain()


def said(receiver: Receiver, rotor: str) -> list[Any]:
    """What came of a rotor: errors in order, and of gaps the number that was dropped."""
    data = [json.loads(one.body)["data"] for one in receiver.got]
    return [one.get("error", one.get("dropped")) for one in data if one["rotor"] == rotor]


def waiting(store: SqlStore, rotor: str, name: str = "ops") -> list[str]:
    found = reversed(list_deliveries(store, name, "pending", None, 1000))
    data = [json.loads(one.body)["data"] for one in found if one.rotor_id == rotor]
    return [one.get("error", "gap") for one in data]


def dropped(store: SqlStore, name: str = "ops") -> int:
    return find_webhook(store, name).counts.get("dropped", 0)


def test_the_newest_wait_and_a_gap_in_the_place_of_the_others_is_sent_first(
    store: SqlStore, settings: Settings, rotors: list[str], receiver: Receiver,
    hook: Callable[[str], str], happens: Callable[..., None], serving: Serving,
) -> None:  # fmt: skip
    secret = hook("ops")
    happens("r1", "e0", "e1", "e2")
    happens("r2", "f0", "f1")
    assert (waiting(store, "r1"), dropped(store)) == (["e0", "e1", "e2"], 0)
    happens("r1", "e3", "e4")
    assert waiting(store, "r1") == ["gap", "e2", "e3", "e4"]
    assert waiting(store, "r2") == ["f0", "f1"], "a rotor drops nothing of another's"
    with serving() as http:
        told = Client(http=http).webhook("ops")["deliveries"]
        assert told == {"pending": 6, "delivered": 0, "dead": 0, "dropped": 2}
        assert "\nbladetwin_deliveries_dropped 2\n" in http.get("/metrics").text
        assert http.get("/v1/operations").json()["gauges"]["deliveries_dropped"] == 2
        (gap,) = [one for one in Client(http=http).deliveries("ops") if one["event"] == "gap"]
        assert gap["rotor"] == "r1"
    sent(store, settings)
    assert (said(receiver, "r1"), said(receiver, "r2")) == ([2, "e2", "e3", "e4"], ["f0", "f1"])
    first = next(one for one in receiver.got if json.loads(one.body)["data"]["rotor"] == "r1")
    read = read_webhook(secret, first.headers, first.body)
    assert (read["type"], read["data"]["dropped"]) == ("gap", 2)
    assert read["data"]["first"] <= read["data"]["last"] <= read["timestamp"]


def test_a_gap_that_was_told_is_followed_by_one_that_counts_on(
    store: SqlStore, settings: Settings, rotor: str, receiver: Receiver,
    hook: Callable[[str], str], happens: Callable[..., None],
) -> None:  # fmt: skip
    hook("ops")
    happens(rotor, *(f"e{n}" for n in range(5)))
    sent(store, settings)
    happens(rotor, *(f"f{n}" for n in range(4)))
    sent(store, settings)
    assert said(receiver, rotor) == [2, "e2", "e3", "e4", 3, "f1", "f2", "f3"]


def test_a_gap_that_grows_while_it_is_sent_is_told_again_under_another_id(
    store: SqlStore, settings: Settings, rotor: str, receiver: Receiver,
    hook: Callable[[str], str], happens: Callable[..., None],
) -> None:  # fmt: skip
    """And a delivery that is dropped while it is sent stays what it became."""
    hook("ops")
    bodies: list[Any] = []

    def meanwhile(url: str, headers: Any, body: bytes, *rest: Any) -> int:
        if len(bodies) < 2:
            happens(rotor, *(f"e{len(bodies)}{n}" for n in range(MOST + len(bodies))))
        data = json.loads(body)["data"]
        bodies.append((headers["webhook-id"], data.get("dropped", data.get("error"))))
        return 204

    happens(rotor, "a0")
    sent(store, settings, send=meanwhile)
    assert [one[1] for one in bodies] == ["a0", 1, 5, "e11", "e12", "e13"]
    assert len({one[0] for one in bodies}) == len(bodies)
    assert dropped(store) == 5


def test_a_receiver_that_is_away_is_not_tried_faster_for_what_is_dropped(
    store: SqlStore, settings: Settings, rotor: str, receiver: Receiver,
    hook: Callable[[str], str], happens: Callable[..., None],
) -> None:  # fmt: skip
    hook("ops")
    happens(rotor, *(f"e{n}" for n in range(MOST)))
    receiver.answer = then(500)
    sent(store, settings.model_copy(update={"retry_base_s": 1000.0}))
    (before,) = [one for one in list_deliveries(store, "ops", None, None, 9) if one.attempts]
    happens(rotor, "e3", "e4")
    (after,) = [one for one in list_deliveries(store, "ops", None, None, 9) if one.attempts]
    assert (after.event, after.attempts, after.not_before) == ("gap", 1, before.not_before)
    assert "500" in str(after.last_error)
    assert len(receiver.got) == 1


def test_dead_ones_that_are_no_longer_kept_are_counted(
    store: SqlStore, settings: Settings, rotors: list[str], receiver: Receiver,
    hook: Callable[[str], str], happens: Callable[..., None],
) -> None:  # fmt: skip
    hook("ops")
    for name in rotors:
        happens(name, "e0", "e1")
    receiver.answer = then(*[500] * 9)
    sent(store, settings.model_copy(update={"webhook_max_attempts": 1}))
    dead = len(list_deliveries(store, "ops", "dead", None, 9))
    assert dead > 1
    with transaction(store.engine, write=True) as connection:
        prune(connection, "ops", {"dead": 1})
    assert dropped(store) == dead - 1


def test_many_rotors_may_drop_at_once_while_the_webhook_is_deleted(
    store: SqlStore, rotors: list[str], hook: Callable[[str], str], happens: Callable[..., None]
) -> None:
    """Nothing is left of it, no one is ended, and another webhook's counts are right."""
    hook("ops")
    hook("other")
    happens("r1", *(f"e{n}" for n in range(MOST)))
    happens("r2", *(f"f{n}" for n in range(MOST)))
    faults: list[BaseException] = []

    def go(work: Callable[[], Any]) -> None:
        try:
            work()
        except BaseException as error:
            faults.append(error)

    def drop(name: str) -> Callable[[], None]:
        return lambda: happens(name, *(f"g{n}" for n in range(20)))

    works = [drop("r1"), drop("r2"), lambda: delete_webhook(store, "ops")]
    threads = [threading.Thread(target=go, args=(work,)) for work in works]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert faults == []
    assert dropped(store, "other") == 40
    with transaction(store.engine, write=False) as connection:
        left = connection.execute(select(t.untold.c.webhook_id).distinct()).scalars().all()
    assert left == ["other"]


def sent_meanwhile(store: SqlStore, settings: Settings, after: str, act: Callable[[], None]) -> int:
    """While `act` drops what is too much, a worker notes that the oldest was sent, as soon as a
    statement with these words was said; how often it did."""
    deliverer = Deliverer(store.engine, settings, "sender")
    (oldest,) = list_deliveries(store, "ops", "pending", None, 1000)[-1:]
    lease = claim_webhook(store.engine, "sender", 60.0)
    assert lease is not None
    threads = [
        threading.Thread(target=deliverer.record, args=(lease, oldest, None), kwargs={"counts": 1})
    ]
    begun: list[threading.Thread] = []

    def note(_c: object, _cursor: object, statement: str, *_: object) -> None:
        if after in statement and threads:
            begun.append(threads.pop())
            begun[0].start()  # it may have to wait for who drops
            until("that", lambda: not begun[0].is_alive() or behind_a_lock(store.engine))

    event.listen(store.engine, "after_cursor_execute", note)
    try:
        act()
    finally:
        event.remove(store.engine, "after_cursor_execute", note)
        for thread in begun:
            thread.join()
    return len(begun)


POINTS = {"looked": ("OFFSET", ["e1", "e2", "e3"], 0), "counted": ("INTO untold", ["gap"], 1)}


@pytest.mark.parametrize("point", POINTS)
def test_what_is_sent_while_it_is_dropped_is_one_of_both(
    store: SqlStore, settings: Settings, rotors: list[str], hook: Callable[[str], str],
    happens: Callable[..., None], point: str,
) -> None:  # fmt: skip
    """On PostgreSQL, where the worker that sends does not wait for the rotor's lock."""
    if is_sqlite(store.engine):
        pytest.skip("one writes at a time")
    after, first, count = POINTS[point]
    hook("ops")
    happens("r1", "e0", "e1", "e2")
    assert sent_meanwhile(store, settings, after, lambda: happens("r1", "e3")) == 1
    assert (waiting(store, "r1")[: len(first)], dropped(store)) == (first, count)


def test_without_the_lock_what_was_dropped_is_told_as_sent(
    store: SqlStore, settings: Settings, rotors: list[str], hook: Callable[[str], str],
    happens: Callable[..., None], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    if is_sqlite(store.engine):
        pytest.skip("one writes at a time")

    def seen(connection: Connection, which: ColumnElement[bool]) -> Sequence[Any]:
        return connection.execute(select(t.delivery).where(which).order_by(t.delivery.c.id)).all()

    monkeypatch.setattr(untold, "locked", seen)
    after, _, _ = POINTS["counted"]
    hook("ops")
    happens("r1", "e0", "e1", "e2")
    assert sent_meanwhile(store, settings, after, lambda: happens("r1", "e3")) == 1
    assert waiting(store, "r1") == ["e1", "e2", "e3"], "the gap is not sent"


def test_the_bound_is_looked_for_by_the_index_alone(
    store: SqlStore, rotor: str, hook: Callable[[str], str], happens: Callable[..., None]
) -> None:
    """It is looked for at every commit of a rotor."""
    if not is_sqlite(store.engine):
        pytest.skip("of a small table PostgreSQL reads all")
    hook("ops")
    happens(rotor, "e0")
    query = (
        "EXPLAIN QUERY PLAN SELECT id FROM delivery WHERE webhook_id = 'ops' AND status = 'pending'"
        " AND rotor_id = 'r1' ORDER BY id DESC LIMIT 1 OFFSET 1000"
    )
    with transaction(store.engine, write=False) as connection:
        (row,) = connection.execute(text(query)).all()
    assert "COVERING INDEX ix_delivery_heads" in row[-1]
