"""Connections and transactions on SQLite and PostgreSQL.

SQLite runs in WAL mode with a busy timeout of 30 s and full synchronisation; a transaction that
writes begins with ``BEGIN IMMEDIATE``, so that two writers queue instead of failing half-way.
Of the pool's connections those used last are used next, so that few of them fill their caches, and
of SQLite's `KEPT` stay open.
PostgreSQL runs READ COMMITTED, where a statement sees what was committed before it, whatever is
around it. So those that only read go without BEGIN and COMMIT, each a message and an answer; so
does a single statement that writes, which is a transaction as it is.
Rows are locked by name where order matters; what else is PostgreSQL's own is in
`service.store.postgres`.
What is said of a failed statement names its parameters nowhere: they are readings and digests.
`now_s()` is the database's clock, the only clock that leases know, and `begun_s()` when its server
was started.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import RLock
from typing import Any
from weakref import WeakKeyDictionary

from sqlalchemy import Connection, Double, Engine, Pool, create_engine, event, make_url
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.exc import ArgumentError, DBAPIError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.functions import FunctionElement

from core.errors import InputError
from service.errors import StoreAwayError

WRITE = "bladetwin_write"
LEVEL = "isolation_level"
READ_ONLY = "25006"  # what PostgreSQL calls a writing statement where only reading is allowed
BUSY_S = 30.0
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
        from service.store.postgres import open_postgres  # the driver, where it is wanted

        return open_postgres(parsed)
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
def transaction(engine: Engine, *, write: bool, alone: bool = False) -> Iterator[Connection]:
    """One transaction: committed at the end, rolled back on any error.

    alone   it is a single statement that writes: PostgreSQL commits it by itself

    StoreAwayError: the database does not answer, may only be read, or ended the connection,
    whatever the driver calls that; what it said is the error's cause.
    """
    try:
        with _turn(engine, write), engine.connect() as connection:
            connection = connection.execution_options(**_options(engine, write, alone))
            with connection.begin():
                yield connection
    except (DBAPIError, PoolTimeoutError) as error:
        lost = isinstance(error, DBAPIError) and error.connection_invalidated
        lost = lost or getattr(getattr(error, "orig", None), "sqlstate", None) == READ_ONLY
        if not (lost or isinstance(error, (OperationalError, PoolTimeoutError))):
            raise
        said = getattr(error, "orig", None) or error
        raise StoreAwayError(type(said).__name__, " ".join(str(said).split())) from error


def away(url: str, error: StoreAwayError) -> str:
    """What a command says of a database that does not answer: which, why, what to do."""
    place = make_url(url)
    remedy = "see that the server runs, has that database, and takes this user and its password"
    if place.get_backend_name() == "sqlite":
        remedy = (
            "see that this user may write the file and its folder, that the disk has room, and "
            "that no other process holds the database"
        )
    shown, why = place.render_as_string(hide_password=True), error.reason[:300].rstrip(".?")
    return f"{shown} does not answer: {why}. To mend it: {remedy}."


def _options(engine: Engine, write: bool, alone: bool) -> dict[str, Any]:
    """Of a transaction: whether it writes, and that its statements stand alone."""
    alone = alone or not write
    alone = alone and not (is_sqlite(engine) or LEVEL in engine.get_execution_options())
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


def insert_new(connection: Connection, table: Any, values: dict[str, Any]) -> bool:
    """Insert a row unless its key is there; whether it was inserted."""
    dialect = sqlite if connection.dialect.name == "sqlite" else postgresql
    statement = dialect.insert(table).values(values).on_conflict_do_nothing()
    return connection.execute(statement.returning(table.c.id)).first() is not None
