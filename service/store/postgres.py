"""An engine on PostgreSQL.

A transaction whose process says nothing for `SILENT_S` is ended by the server: a frozen process
does not hold its locks for ever. (Not so right after an `executemany`, which psycopg sends as a
pipeline: its last message ends the server's timer. Who waits for such locks is told so after
`LOCKED_S`.) A server that vanishes without a word (`LIMITS`) is noticed within half a minute, and
no thread waits longer for it.

A connection that rested for `RESTED_S` is asked whether it is alive before it is used, and where it
is not, no other one of before that is used either. Where the server went away within that time a
statement fails, as where it goes away during one.
"""

from __future__ import annotations

import time
from functools import partial
from typing import Any

from psycopg import Cursor
from sqlalchemy import URL, Dialect, Engine, create_engine, event
from sqlalchemy.exc import InvalidatePoolError

SILENT_S = 30.0
LOCKED_S = 60.0
RESTED_S = 1.0
# Of a connection whose server vanishes without a word: libpq's names, which an URL may set itself.
LIMITS = {
    "connect_timeout": "10",
    "keepalives_idle": "15",
    "keepalives_interval": "5",
    "keepalives_count": "3",
    "tcp_user_timeout": "30000",
}
SINCE = "bladetwin_rests_since"


class Light(Cursor[Any]):
    """psycopg's cursor, which tells columns by name and type alone.

    That is what SQLAlchemy asks for, of every result; psycopg's own description looks up the type
    of each column in its registry: a seventh of the time of a small statement.
    """

    @property
    def description(self) -> Any:
        result = self.pgresult
        if result is None or not result.nfields:
            return None
        names = ((result.fname(i) or b"").decode(self._encoding) for i in range(result.nfields))
        return [(name, result.ftype(i), *5 * (None,)) for i, name in enumerate(names)]


def open_postgres(url: URL) -> Engine:
    """An engine of psycopg at an URL, whose limits are its own where it names them."""
    given = {name: value for name, value in LIMITS.items() if name not in url.query}
    engine = create_engine(
        url.set(drivername="postgresql+psycopg").update_query_dict(given),
        connect_args={"cursor_factory": Light},
        pool_size=20,
        max_overflow=40,
        pool_use_lifo=True,
        hide_parameters=True,
    )
    event.listen(engine, "connect", _prepare)
    event.listen(engine, "checkin", _rest)
    event.listen(engine, "checkout", partial(_wake, engine.dialect))
    return engine


def _prepare(connection: Any, record: Any) -> None:
    for name, seconds in (
        ("idle_in_transaction_session_timeout", SILENT_S),
        ("lock_timeout", LOCKED_S),
    ):
        connection.execute(f"SET {name} = {round(1e3 * seconds)}").close()
    connection.commit()


def _rest(connection: Any, record: Any) -> None:
    record.info[SINCE] = time.monotonic()


def _wake(dialect: Dialect, connection: Any, record: Any, proxy: Any) -> None:
    """InvalidatePoolError, upon which the pool opens new connections: one that rested is dead."""
    since = record.info.get(SINCE)
    if since is None or time.monotonic() - since < RESTED_S:
        return
    try:
        dialect.do_ping(connection)
    except dialect.loaded_dbapi.Error as error:
        raise InvalidatePoolError(str(error)) from error
