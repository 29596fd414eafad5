"""How PostgreSQL is asked: reading statements stand alone, others do not; dead connections."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
from psycopg.pq import TransactionStatus
from sqlalchemy import Connection, Engine, insert, select, text
from sqlalchemy.exc import IntegrityError

from service.errors import StoreAwayError
from service.store import engine as engines
from service.store import postgres
from service.store import tables as t
from service.store.engine import open_engine, snapshot, transaction
from tests.postgres import Databases

IDLE, OPEN = TransactionStatus.IDLE, TransactionStatus.INTRANS


@pytest.fixture
def url(databases: Databases) -> Iterator[str]:
    name = databases.take()
    yield databases.url(name)
    databases.give(name)


@pytest.fixture
def engine(url: str) -> Iterator[Engine]:
    opened = open_engine(url)
    yield opened
    opened.dispose()


def state(connection: Connection) -> TransactionStatus:
    """What the server is told of a transaction, between two statements."""
    assert connection.execute(text("SELECT 1")).scalar() == 1
    return connection.connection.driver_connection.info.transaction_status  # type: ignore[union-attr]


def own_number(connection: Connection) -> int:
    return int(connection.execute(text("SELECT pg_backend_pid()")).scalar_one())


def kinds(engine: Engine) -> list[str]:
    with transaction(engine, write=False) as connection:
        return list(connection.execute(select(t.model.c.id)).scalars())


ROW = {"id": "m", "version": "1", "digest": "d", "source": "{}", "card": "{}", "created_at": 0.0}


def test_statements_that_read_and_single_ones_stand_alone_and_no_others(engine: Engine) -> None:
    """On one and the same connection, one after the other, whichever came before."""
    numbers = set[int]()
    for _ in range(2):
        with transaction(engine, write=False) as connection:
            numbers.add(own_number(connection))
            assert state(connection) is IDLE
        with transaction(engine, write=True) as connection:
            numbers.add(own_number(connection))
            assert state(connection) is OPEN
        with transaction(engine, write=True, alone=True) as connection:
            numbers.add(own_number(connection))
            assert state(connection) is IDLE
        with snapshot(engine) as connection:
            numbers.add(own_number(connection))
            assert state(connection) is OPEN
            level = connection.execute(text("SHOW transaction_isolation")).scalar()
            assert level == "repeatable read"
    assert len(numbers) == 1


def _half(engine: Engine) -> list[str]:
    """What is there after a transaction that failed at its second statement."""
    with transaction(engine, write=False) as connection:
        state(connection)
    with pytest.raises(IntegrityError):
        _twice(engine)
    return kinds(engine)


def _twice(engine: Engine) -> None:
    with transaction(engine, write=True) as connection:
        connection.execute(insert(t.model), [ROW])
        connection.execute(insert(t.model), [ROW])


def test_a_change_after_a_read_is_whole_or_not_at_all(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = kinds(engine)
    assert _half(engine) == before
    # the mutant: what writes stands alone, too
    monkeypatch.setattr(engines, "_options", lambda *_: {engines.LEVEL: "AUTOCOMMIT"})
    assert _half(engine) == [*before, "m"]


def end(url: str, number: int) -> None:
    other = open_engine(url)
    with transaction(other, write=True) as connection:
        connection.execute(text("SELECT pg_terminate_backend(:number)"), {"number": number})
        alive = text("SELECT count(*) FROM pg_stat_activity WHERE pid = :number")
        while connection.execute(alive, {"number": number}).scalar():
            time.sleep(0.01)
            connection.execute(text("SELECT pg_stat_clear_snapshot()"))
    other.dispose()


def ended(engine: Engine, url: str) -> None:
    """Let the server end the connections that rest in the pool."""
    with transaction(engine, write=False) as first, transaction(engine, write=False) as second:
        numbers = [own_number(first), own_number(second)]
    for number in numbers:
        end(url, number)


def test_a_connection_that_died_resting_is_not_used(
    engine: Engine, url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(postgres, "RESTED_S", 0.0)
    ended(engine, url)
    assert kinds(engine) == []


def test_one_that_died_a_moment_ago_is_told_once(
    engine: Engine, url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And takes the others along: the next request is answered, whatever rests in the pool."""
    monkeypatch.setattr(postgres, "RESTED_S", 60.0)
    ended(engine, url)
    with pytest.raises(StoreAwayError):
        kinds(engine)
    assert kinds(engine) == []


def test_columns_are_told_by_name_and_type(engine: Engine) -> None:
    query = text('SELECT 1::bigint AS n, 0.1::double precision AS "é x", NULL::text AS nothing')
    with transaction(engine, write=False) as connection:
        row = connection.execute(query).one()
        assert dict(row._mapping) == {"n": 1, "é x": 0.1, "nothing": None}
        own = connection.connection.cursor()
        own.execute("SELECT 1::bigint AS n, 'x'::text AS word")
        assert [column[:2] for column in own.description or ()] == [("n", 20), ("word", 25)]
        own.execute("SET lock_timeout = 1000")
        assert own.description is None
        own.close()
