"""Bring a database to the schema of this release, with Alembic.

SQLite and PostgreSQL both take back schema changes with their transaction, which
SQLite does only where no one commits in between: the connection has no transactions of the
driver's own (`isolation_level=None`), and Alembic is told so in migrations/env.py.

Safe to run at the same time from several processes: SQLite's write lock or an advisory lock of
PostgreSQL lets one go first, and the others find nothing left to do.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, Engine, text

import service
from service.errors import SchemaError
from service.store.engine import is_sqlite, transaction

LOCK = 0x626C6164
UPGRADE = "upgrade this process to the release that migrated the database"


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


def migrate(engine: Engine) -> str:
    """Upgrade to the newest schema; its revision.

    All steps are one transaction on either database, so that a process that dies in the middle
    leaves the schema as it was. SchemaError: the database is of a newer release.
    """
    with transaction(engine, write=True) as connection:
        if not is_sqlite(engine):
            # another one's migration may take its time: who comes second waits for it
            connection.execute(text("SET LOCAL lock_timeout = 0"))
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": LOCK})
        found = MigrationContext.configure(connection).get_current_revision()
        if found is not None and found not in revisions():
            raise SchemaError(
                f"the database has schema {found}, which this release does not know (its newest is "
                f"{newest()}); nothing was changed. To mend it: {UPGRADE}."
            )
        command.upgrade(_config(connection), "head")
    return newest()


def newest() -> str:
    """The revision that this release needs."""
    return str(ScriptDirectory.from_config(_config()).get_current_head())


def revisions() -> frozenset[str]:
    """Every revision that this release knows."""
    walked = ScriptDirectory.from_config(_config()).walk_revisions()
    return frozenset(str(one.revision) for one in walked)


def remedy(found: str | None, needed: str, known: Collection[str]) -> str | None:
    """What to do about a database with schema `found`; None: it is the one that is needed.

    known   every revision that the release has (`revisions`)
    """
    if found == needed:
        return None
    if found is None or found in known:
        return f"run `bladetwin migrate`: revision {needed} is needed"
    return f"{UPGRADE} (revision {needed} is the newest that this one knows)"


def current(engine: Engine) -> str | None:
    """The revision that the database has; None: not migrated."""
    with transaction(engine, write=False) as connection:
        return MigrationContext.configure(connection).get_current_revision()
