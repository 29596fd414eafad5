"""How a sleeping worker, or a reader that waits for a version, learns of a commit.

PostgreSQL tells by LISTEN/NOTIFY. SQLite keeps `PRAGMA data_version`, a counter in the shared
memory of the file that changes with every commit of another connection; reading it costs some
microseconds, so it is looked at every few milliseconds. Both are hints: whoever wakes looks for
work in the tables, and looks there now and then without a hint.
"""

from __future__ import annotations

import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Protocol

from sqlalchemy import Engine

from service.store.engine import is_sqlite

if TYPE_CHECKING:
    import psycopg

SKIP_S = 0.02  # of reading what nobody waits for


class Wake(Protocol):
    """Sleeps until something was committed."""

    def wait(self, timeout_s: float) -> bool:
        """True as soon as something was committed since the last call, False at the timeout."""
        ...

    def skip(self) -> None:
        """Forget what was committed so far: nobody waits."""
        ...

    def close(self) -> None: ...


class SqliteWake:
    """Watches `data_version` of one connection that never writes."""

    def __init__(self, engine: Engine, poll_ms: float) -> None:
        self._connection: Any = engine.raw_connection()
        self._cursor = self._connection.cursor()
        self._poll_s = poll_ms / 1000.0
        self._seen = self._version()

    def _version(self) -> int:
        return int(self._cursor.execute("PRAGMA data_version").fetchone()[0])

    def wait(self, timeout_s: float) -> bool:
        end = time.monotonic() + timeout_s
        while (version := self._version()) == self._seen:
            left = end - time.monotonic()
            if left <= 0:
                return False
            time.sleep(min(self._poll_s, left))
        self._seen = version
        return True

    def skip(self) -> None:
        self._seen = self._version()

    def close(self) -> None:
        self._cursor.close()
        self._connection.close()


class PostgresWake:
    """Listens on one channel with a connection of its own, opened again if it was lost.

    A database that is away when this begins is as good as one that went away: nothing is raised,
    `wait` tries again. So is a standby, which has no notifications. What was committed while nobody
    listened gave no hint, so each opening counts as one.

    PostgreSQL keeps what a listener does not read: first in the connection, then, for all databases
    of the server, in a queue from which nothing goes before its slowest listener has it, and when
    that is full no commit that notifies succeeds. Who does not wait has to `skip` now and then.
    """

    def __init__(self, engine: Engine, channel: str) -> None:
        driver: Any = engine.dialect.dbapi
        self._connect, self._away = driver.connect, driver.Error
        self._parameters = engine.dialect.create_connect_args(engine.url)
        self._channel = channel
        self._connection: psycopg.Connection[Any] | None = None
        with suppress(self._away):
            self._open()

    def _open(self) -> None:
        arguments, options = self._parameters
        connection = self._connect(*arguments, **options, autocommit=True)
        try:
            connection.execute(f"LISTEN {self._channel}")
        except self._away:
            connection.close()
            raise
        self._connection = connection

    def wait(self, timeout_s: float) -> bool:
        try:
            if self._connection is None:
                self._open()
                return True
            return any(True for _ in self._connection.notifies(timeout=timeout_s, stop_after=1))
        except self._away:
            self.close()
            time.sleep(min(1.0, timeout_s))
            return True

    def skip(self) -> None:
        try:
            if self._connection is not None:
                for _ in self._connection.notifies(timeout=SKIP_S):
                    pass
        except self._away:
            self.close()

    def close(self) -> None:
        if self._connection is not None:
            self._connection.close()
        self._connection = None


def open_wake(engine: Engine, channel: str, poll_ms: float) -> Wake:
    """The wake of the engine's database; `channel` matters to PostgreSQL only."""
    return SqliteWake(engine, poll_ms) if is_sqlite(engine) else PostgresWake(engine, channel)
