"""Bring a database to the schema of this release, with Alembic.

SQLite and PostgreSQL both take back schema changes with their transaction, which
SQLite does only where no one commits in between: the connection has no transactions of the
driver's own (`isolation_level=None`), and Alembic is told so in migrations/env.py.

Safe to run at the same time from several processes: SQLite's write lock or an advisory lock of
PostgreSQL lets one go first, and the others find nothing left to do. Safe to run beside a service
at work (`service.store.standstill`).

Each migration says whether processes of the releases before it may go on (``OLDER_MAY_RUN``), and
the database keeps the oldest revision whose processes may (`compatible_since`): so a process knows
of a schema that is newer than itself whether it may run on it.
"""

from __future__ import annotations

import random
import time
from collections.abc import Collection, Sequence
from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, Engine, delete, insert, inspect, select, text

import service
from service.errors import SchemaError
from service.store.engine import is_sqlite, transaction
from service.store.schema import compatible_since
from service.store.standstill import InUseError, first_order, in_the_way, lock_all

LOCK = 0x626C6164
UPGRADE = "upgrade this process to the release that migrated the database"
PATIENCE_S = 60.0
PAUSE_S = 0.5  # between two attempts to have the tables: the service goes on meanwhile


def script_folder() -> Path:
    """The folder of the migrations: inside an installed package, or beside it in a checkout."""
    package = Path(service.__file__).parent
    for folder in (package / "migrations", package.parent / "migrations"):
        if (folder / "env.py").exists():
            return folder
    raise FileNotFoundError(f"no migrations beside {package}: the installation is incomplete")


def _config(connection: Connection | None = None) -> Config:
    config = Config()
    config.set_main_option("script_location", str(script_folder()))
    config.attributes["connection"] = connection
    return config


def _script() -> ScriptDirectory:
    return ScriptDirectory.from_config(_config())


def migrate(engine: Engine, patience_s: float = PATIENCE_S) -> str:
    """Upgrade to the newest schema; the revision that the database has then.

    All steps are one transaction on either database, so that a process that dies in the middle
    leaves the schema as it was. One of a newer release, on which this one may run, stays as it is.

    patience_s   how long it is tried to have the tables of a PostgreSQL that is in use, s

    SchemaError: the database is of a newer release, or its tables were not to be had.
    """
    end = time.monotonic() + patience_s
    order, attempt = first_order(), 0
    while True:
        attempt += 1
        try:
            return _attempt(engine, order, attempt)
        except InUseError as error:
            order.remove(error.table)
            order.insert(0, error.table)
            if time.monotonic() >= end:
                break
        time.sleep(PAUSE_S * random.uniform(0.5, 1.0))
    raise SchemaError(
        f"the database is in use: in {attempt} attempts within {patience_s:g} s its tables were "
        f"not to be had all at once, {order[0]} for one; nothing was changed. "
        f"{in_the_way(engine)} To mend it: wait for what takes long (a backup, an export) or end "
        "it, and run `bladetwin migrate` again, with a longer --patience where need be."
    )


def _attempt(engine: Engine, order: Sequence[str], attempt: int) -> str:
    """One transaction; InUseError: somebody had a table, and nothing was changed."""
    with transaction(engine, write=True) as connection:
        if not is_sqlite(engine):
            # another one's migration may take its time: who comes second waits for it
            connection.execute(text("SET LOCAL lock_timeout = 0"))
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": LOCK})
        found = MigrationContext.configure(connection).get_current_revision()
        if found == (needed := newest()):
            return found
        if (do := remedy(found, needed, known := revisions(), _since(connection))) is None:
            return str(found)
        if found is not None and found not in known:
            raise SchemaError(
                f"the database has schema {found}, which this release does not know (its newest is "
                f"{needed}); nothing was changed. To mend it: {do}."
            )
        if not is_sqlite(engine):
            lock_all(connection, order, attempt)
        command.upgrade(_config(connection), "head")
        connection.execute(delete(compatible_since))
        connection.execute(insert(compatible_since).values(revision=oldest()))
    return needed


def newest() -> str:
    """The revision that this release needs."""
    return str(_script().get_current_head())


def revisions() -> frozenset[str]:
    """Every revision that this release knows."""
    return frozenset(str(one.revision) for one in _script().walk_revisions())


def oldest() -> str:
    """The oldest revision whose processes may run on the newest schema.

    It is that of the last migration that does not say of older ones that they may.
    """
    line = list(_script().walk_revisions())
    breaks = (one for one in line if not getattr(one.module, "OLDER_MAY_RUN", False))
    return str(next(breaks, line[-1]).revision)


def remedy(
    found: str | None, needed: str, known: Collection[str], since: str | None = None
) -> str | None:
    """What to do about a database with schema `found`; None: this release may run on it.

    known   every revision that the release has (`revisions`)
    since   the oldest revision whose processes may run on it, as the database says
    """
    if found == needed:
        return None
    if found is None or found in known:
        return f"run `bladetwin migrate`: revision {needed} is needed"
    if since in known:
        return None
    least = "" if since is None else f", the database needs {since}"
    return f"{UPGRADE} (revision {needed} is the newest that this one knows{least})"


def current(engine: Engine) -> str | None:
    """The revision that the database has; None: not migrated."""
    with transaction(engine, write=False) as connection:
        return MigrationContext.configure(connection).get_current_revision()


def standing(engine: Engine, needed: str, known: Collection[str]) -> tuple[str | None, str | None]:
    """The database's revision, and what to do about it (`remedy`)."""
    with transaction(engine, write=False) as connection:
        found = MigrationContext.configure(connection).get_current_revision()
        since = _since(connection) if found is not None and found not in known else None
        return found, remedy(found, needed, known, since)


def _since(connection: Connection) -> str | None:
    """What a database says of the releases that may run on it; None: nothing."""
    if not inspect(connection).has_table(compatible_since.name):
        return None
    return connection.execute(select(compatible_since.c.revision)).scalar()
