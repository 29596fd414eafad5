"""Connections and transactions on SQLite and PostgreSQL.

SQLite runs in WAL mode with a busy timeout of 30 s and full synchronisation; a transaction that
writes begins with ``BEGIN IMMEDIATE``, so that two writers queue instead of failing half-way.
Of the pool's connections those used last are used next, so that few of them fill their caches, and
of SQLite's `KEPT` stay open.
PostgreSQL runs READ COMMITTED, where a statement sees what was committed before it, whatever is
around it. So those that only read go without BEGIN and COMMIT, each a message and an answer.
A connection that rested for `RESTED_S` is asked whether it is alive before it is used; where the
server went away within that time, a statement fails as where it goes away during one.
Rows are locked by name where order matters, and a transaction whose
process says nothing for `SILENT_S` is ended by the server: a frozen process does not hold its locks
for ever. (Not so right after an `executemany`, which psycopg sends as a pipeline: its last message
ends the server's timer. Who waits for such locks is told so after twice `SILENT_S`.)
A server that vanishes without a word (`LIMITS`) is noticed within half a minute, and no thread
waits longer for it.
What is said of a failed statement names its parameters nowhere: they are readings and digests.
`now_s()` is the database's clock, the only clock that leases know, and `begun_s()` when its server
was started.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from threading import RLock
from typing import Any
from weakref import WeakKeyDictionary

from sqlalchemy import Connection, Dialect, Double, Engine, Pool, create_engine, event, make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, DisconnectionError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.functions import FunctionElement

from core.errors import InputError
from service.errors import StoreAwayError

WRITE = "bladetwin_write"
LEVEL = "isolation_level"
RESTS = "bladetwin_rests"
RESTED_S = 1.0
SILENT_S = 30.0
BUSY_S = 30.0
# Of a connection whose server vanishes without a word: libpq's names, which an URL may set itself.
LIMITS = {
    "connect_timeout": "10",
    "keepalives_idle": "15",
    "keepalives_interval": "5",
    "keepalives_count": "3",
    "tcp_user_timeout": "30000",
}
PAGES = "cache_size=-500"  # KiB of a connection: emptied by every write of another one
KEPT = 8  # SQLite's connections that stay open; a burst opens more, for as long as it lasts
_WRITERS: WeakKeyDictionary[Pool, RLock] = WeakKeyDictionary()


class now_s(FunctionElement[float]):
    """Seconds since 1970 by the database's clock."""

    type = Double()
    inherit_cache = True


@compiles(now_s, "sqlite")
def _now_sqlite(element: Any, compiler: Any, **kw: Any) -> str:
    return "((julianday('now') - 2440587.5) * 86400.0)"


@compiles(now_s, "postgresql")
def _now_postgresql(element: Any, compiler: Any, **kw: Any) -> str:
    return "extract(epoch from clock_timestamp())::double precision"


class begun_s(FunctionElement[float]):
    """When the database's server was started, as `now_s`; SQLite has none that could be away: 0."""

    type = Double()
    inherit_cache = True


@compiles(begun_s, "sqlite")
def _begun_sqlite(element: Any, compiler: Any, **kw: Any) -> str:
    return "0.0"


@compiles(begun_s, "postgresql")
def _begun_postgresql(element: Any, compiler: Any, **kw: Any) -> str:
    return "extract(epoch from pg_postmaster_start_time())::double precision"


def open_engine(url: str) -> Engine:
    """An engine for ``sqlite:///file`` or ``postgresql://…``; anything else is refused."""
    try:
        parsed = make_url(url)
    except ArgumentError:
        raise InputError(
            "BLADETWIN_DATABASE_URL", "…", "is no database URL", "write sqlite:///bladetwin.db"
        ) from None
    backend = parsed.get_backend_name()
    if backend == "postgresql":
        parsed = parsed.set(drivername="postgresql+psycopg")
        given = {name: value for name, value in LIMITS.items() if name not in parsed.query}
        parsed = parsed.update_query_dict(given)
        engine = create_engine(
            parsed,
            connect_args={"cursor_factory": _postgres_cursor()},
            pool_size=20,
            max_overflow=40,
            pool_use_lifo=True,
            hide_parameters=True,
        )
        event.listen(engine, "connect", _prepare_postgres)
        event.listen(engine, "checkin", _rest)
        event.listen(engine, "checkout", partial(_wake, engine.dialect))
        return engine
    if backend != "sqlite" or not parsed.database or parsed.database == ":memory:":
        raise InputError(
            "BLADETWIN_DATABASE_URL",
            parsed.render_as_string(hide_password=True),
            "is neither a SQLite file nor PostgreSQL",
            "write sqlite:///bladetwin.db or postgresql://user@host/name",
        )
    engine = create_engine(
        parsed.set(drivername="sqlite+pysqlite"),
        connect_args={"isolation_level": None, "timeout": BUSY_S, "check_same_thread": False},
        pool_size=KEPT,
        max_overflow=60 - KEPT,
        pool_use_lifo=True,
        hide_parameters=True,
    )
    event.listen(engine, "connect", _prepare_sqlite)
    event.listen(engine, "begin", _begin_sqlite)
    return engine


def _prepare_sqlite(connection: Any, record: Any) -> None:
    for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON", PAGES):
        connection.execute(f"PRAGMA {pragma}").close()


def _prepare_postgres(connection: Any, record: Any) -> None:
    milliseconds = round(1e3 * SILENT_S)
    connection.execute(f"SET idle_in_transaction_session_timeout = {milliseconds}").close()
    connection.execute(f"SET lock_timeout = {2 * milliseconds}").close()
    connection.commit()


def _postgres_cursor() -> type[Any]:
    """psycopg's cursor, whose columns are told by name and type alone.

    That is what SQLAlchemy asks for, of every result; psycopg's own description looks up each
    column's type in its registry: a seventh of the time of a small statement.
    """
    from psycopg import Cursor

    class Light(Cursor[Any]):
        @property
        def description(self) -> Any:
            result = self.pgresult
            if result is None or not result.nfields:
                return None
            known, coding = range(result.nfields), self._encoding
            return [
                ((result.fname(i) or b"").decode(coding), result.ftype(i), *5 * (None,))
                for i in known
            ]

    return Light


def _rest(connection: Any, record: Any) -> None:
    record.info[RESTS] = time.monotonic()


def _wake(dialect: Dialect, connection: Any, record: Any, proxy: Any) -> None:
    """DisconnectionError, upon which the pool opens another: a connection that rested is dead."""
    since = record.info.get(RESTS)
    if since is None or time.monotonic() - since < RESTED_S:
        return
    try:
        dialect.do_ping(connection)
    except dialect.loaded_dbapi.Error as error:
        raise DisconnectionError(str(error)) from error


def _begin_sqlite(connection: Connection) -> None:
    write = connection.get_execution_options().get(WRITE, False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if write else "BEGIN")


@contextmanager
def _turn(engine: Engine, write: bool) -> Iterator[None]:
    """On SQLite the writers of one process go one after the other.

    SQLite itself lets whoever happens to look when the lock is free have it: others look again
    after up to 100 ms, each holding a thread, so that under load workers and reads wait for posts.
    """
    if not (write and is_sqlite(engine)):
        yield
        return
    lock = _WRITERS.setdefault(engine.pool, RLock())
    if not lock.acquire(timeout=BUSY_S):
        raise StoreAwayError("locked by another writer of this process")
    try:
        yield
    finally:
        lock.release()


@contextmanager
def transaction(engine: Engine, *, write: bool) -> Iterator[Connection]:
    """One transaction: committed at the end, rolled back on any error.

    StoreAwayError: the database does not answer, or ended the connection, whatever the driver
    calls that; what it said is the error's cause.
    """
    try:
        with _turn(engine, write), engine.connect() as connection:
            connection = connection.execution_options(**_options(engine, write))
            with connection.begin():
                yield connection
    except (DBAPIError, PoolTimeoutError) as error:
        lost = isinstance(error, DBAPIError) and error.connection_invalidated
        if not (lost or isinstance(error, (OperationalError, PoolTimeoutError))):
            raise
        raise StoreAwayError(type(getattr(error, "orig", None) or error).__name__) from error


def _options(engine: Engine, write: bool) -> dict[str, Any]:
    """Of a transaction: whether it writes, and that statements which only read stand alone."""
    alone = not (write or is_sqlite(engine) or LEVEL in engine.get_execution_options())
    return {WRITE: write} | ({LEVEL: "AUTOCOMMIT"} if alone else {})


@contextmanager
def snapshot(engine: Engine) -> Iterator[Connection]:
    """A reading transaction that sees the database as it was at its first statement.

    SQLite's readers always do; PostgreSQL's does at REPEATABLE READ.
    """
    if is_sqlite(engine):
        with transaction(engine, write=False) as connection:
            yield connection
        return
    with transaction(engine.execution_options(**{LEVEL: "REPEATABLE READ"}), write=False) as c:
        yield c


def is_sqlite(engine: Engine) -> bool:
    """Whether the engine is the embedded database."""
    return engine.dialect.name == "sqlite"
