"""A lease that ran out while the database was restarted is not a death over its rotor."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from sqlalchemy import false, select, update

from core.observation import Inspection
from service.store import tables as t
from service.store.engine import begun_s, is_sqlite, now_s, transaction
from service.store.unit_of_work import SqlStore
from service.worker import claiming
from service.worker.claiming import claim

LEASE_S = 0.2
Make = Callable[..., Inspection]
Post = Callable[..., int]


def attempts(store: SqlStore, last_beat: Any) -> int:
    """Counted after a second claim, where the first one's holder last prolonged its lease then."""
    assert claim(store.engine, "first", LEASE_S) is not None
    with transaction(store.engine, write=True) as connection:
        beaten = update(t.cursor).values(lease_until=last_beat + LEASE_S)
        connection.execute(beaten)
    taken = claim(store.engine, "second", LEASE_S)
    assert taken is not None
    with transaction(store.engine, write=False) as connection:
        row = connection.execute(select(t.cursor.c.attempts, t.cursor.c.takeovers)).one()
    assert row.takeovers == 1
    assert row.attempts == taken.attempts
    return int(row.attempts)


def test_the_claim_after_a_restart_is_not_counted(
    store: SqlStore, rotor: str, reading: Make, post: Post
) -> None:
    """SQLite has no server, and its leases are never outlived."""
    post(rotor, reading("a"))
    if is_sqlite(store.engine):
        assert attempts(store, now_s() - 1e6) == 2
    else:
        assert attempts(store, begun_s() - 1.0) == 1


def test_one_of_a_worker_that_fell_silent_while_the_database_was_there_is(
    store: SqlStore, rotor: str, reading: Make, post: Post
) -> None:
    post(rotor, reading("a"))
    assert attempts(store, now_s() - 2 * LEASE_S) == 2


def test_were_it_not_looked_at_a_restart_would_count(
    store: SqlStore, rotor: str, reading: Make, post: Post, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(claiming, "outlived", lambda lease_s: false())
    post(rotor, reading("a"))
    assert attempts(store, begun_s() - 1.0) == 2
