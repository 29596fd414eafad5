"""A process that is frozen inside a transaction does not hold its locks for ever (PostgreSQL).

On SQLite writers wait 30 s for it and are told 503; see the table of faults.
"""

from __future__ import annotations

import time
from typing import Any

import pytest
from sqlalchemy import text
from sqlalchemy.exc import ProgrammingError

from service.errors import StoreAwayError
from service.store import postgres
from service.store.engine import open_engine, transaction
from tests.patience import PATIENCE_S

SILENT_S = 0.5


def locked_out(url: str, patience_s: float) -> float:
    """How long another writer, who has this patience, waits for a row that a frozen process has
    locked. The others' connections have no such limit as `postgres.SILENT_S`."""
    engine = open_engine(url)
    frozen = engine.connect().execution_options(isolation_level="AUTOCOMMIT")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(postgres, "SILENT_S", 0.0)
        other = open_engine(url)
        with transaction(other, write=True) as connection:
            connection.execute(text("CREATE TABLE thing (id INTEGER)"))
            connection.execute(text("INSERT INTO thing VALUES (1)"))
    try:
        begun = time.monotonic()
        own: Any = frozen.connection.driver_connection
        own.execute("BEGIN; UPDATE thing SET id = 2")  # one message: it is frozen after it
        with transaction(other, write=True) as connection:
            connection.execute(text(f"SET statement_timeout = {round(1e3 * patience_s)}"))
            connection.execute(text("UPDATE thing SET id = 3"))
        return time.monotonic() - begun
    finally:
        frozen.invalidate()
        frozen.close()
        engine.dispose()
        other.dispose()


on_postgresql = pytest.mark.parametrize("database_url", ["postgresql"], indirect=True)


@on_postgresql
def test_the_database_ends_a_transaction_that_says_nothing(
    database_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(postgres, "SILENT_S", SILENT_S)
    assert locked_out(database_url, PATIENCE_S) > SILENT_S * 0.8


@on_postgresql
def test_without_the_limit_a_frozen_process_keeps_its_locks(
    database_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(postgres, "SILENT_S", 0.0)
    with pytest.raises(StoreAwayError, match="QueryCanceled"):
        locked_out(database_url, 3 * SILENT_S)


@on_postgresql
def test_who_waits_for_a_frozen_process_is_told_so(
    database_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the server makes of the transaction: after an executemany it may not end it."""
    limit_s = postgres.LOCKED_S
    monkeypatch.setattr(postgres, "LOCKED_S", 2 * SILENT_S)
    engine, other = open_engine(database_url), open_engine(database_url)
    with transaction(engine, write=True) as connection:
        connection.execute(text("CREATE TABLE thing (id INTEGER)"))
        connection.execute(text("INSERT INTO thing VALUES (1)"))
    frozen = engine.connect()
    frozen.execute(text("SET idle_in_transaction_session_timeout = 0"))
    frozen.execute(text("UPDATE thing SET id = 2"))
    begun = time.monotonic()
    with (
        pytest.raises(StoreAwayError, match="LockNotAvailable"),
        transaction(other, write=True) as connection,
    ):
        connection.execute(text("UPDATE thing SET id = 3"))
    assert time.monotonic() - begun < 0.8 * limit_s
    frozen.close()
    engine.dispose()
    other.dispose()


@on_postgresql
def test_a_process_that_wakes_after_it_is_told_that_nothing_was_stored(database_url: str) -> None:
    limit = text(f"SET idle_in_transaction_session_timeout = {round(1e3 * SILENT_S)}")
    engine = open_engine(database_url)
    with transaction(engine, write=True) as connection:
        connection.execute(text("CREATE TABLE thing (id INTEGER)"))

    def freeze() -> None:
        with transaction(engine, write=True) as connection:
            connection.execute(text("INSERT INTO thing VALUES (1)"))
            connection.execute(limit)
            time.sleep(3 * SILENT_S)

    with pytest.raises(StoreAwayError, match="nothing was stored"):
        freeze()
    with transaction(engine, write=True) as connection:
        assert connection.execute(text("SELECT count(*) FROM thing")).scalar() == 0
        connection.execute(text("INSERT INTO thing VALUES (2)"))
    engine.dispose()


@on_postgresql
def test_a_mistake_of_ours_is_not_taken_for_a_database_that_is_away(database_url: str) -> None:
    engine = open_engine(database_url)
    with pytest.raises(ProgrammingError), transaction(engine, write=True) as connection:
        connection.execute(text("SELECT * FROM nothing_of_that_name"))
    engine.dispose()
