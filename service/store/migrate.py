"""Bring a database to the schema of this release, with Alembic.

Safe to run at the same time from several processes: SQLite's write lock or an advisory lock of
PostgreSQL lets one go first, and the others find nothing left to do.
"""

from __future__ import annotations

from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, Engine, text

import service
from service.store.engine import is_sqlite, transaction

LOCK = 0x626C6164


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
    """Upgrade to the newest schema; its revision."""
    with transaction(engine, write=True) as connection:
        if not is_sqlite(engine):
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": LOCK})
        command.upgrade(_config(connection), "head")
    return newest()


def newest() -> str:
    """The revision that this release needs."""
    return str(ScriptDirectory.from_config(_config()).get_current_head())


def current(engine: Engine) -> str | None:
    """The revision that the database has; None: not migrated."""
    with transaction(engine, write=False) as connection:
        return MigrationContext.configure(connection).get_current_revision()
