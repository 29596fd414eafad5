"""A release is changed under a service at work: a newer schema below older processes, and a
migration beside ingest."""

from __future__ import annotations

import random
import re
import shutil
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from alembic import command
from alembic.config import Config
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, Engine, event, text
from typer.testing import CliRunner

from core.observation import Inspection
from service.api import outdated
from service.bootstrap import make_deliverer, prepare
from service.cli import app
from service.errors import SchemaError, StoreAwayError
from service.handlers.rotors import view_rotor
from service.settings import Settings
from service.store import migrate as migrations
from service.store import postgres, standstill
from service.store.engine import is_sqlite, open_engine, transaction
from service.store.unit_of_work import SqlStore
from service.worker import deliver, loop
from service.worker.loop import Worker
from tests.patience import AGES_S, PATIENCE_S, until

Serving = Callable[..., AbstractContextManager[httpx.Client]]
NEXT = '''
"""Another release's."""
import sqlalchemy as sa
from alembic import op

revision, down_revision = "9999", "{before}"
branch_labels = depends_on = None
{says}

def upgrade():
    for table in ("event", "rotor", "cursor"):
        op.add_column(table, sa.Column("later", sa.Text(), nullable=True))
    op.create_index("ix_event_later", "event", ["rotor_id", "later"])
'''
MAY, MAY_NOT = "OLDER_MAY_RUN = True", "OLDER_MAY_RUN = False"


@pytest.fixture
def later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Inside, this process is one of a release that has one more migration."""
    own = migrations.script_folder()

    @contextmanager
    def release(says: str) -> Iterator[None]:
        folder = tmp_path / f"migrations-{len(list(tmp_path.iterdir()))}"
        shutil.copytree(own, folder, ignore=shutil.ignore_patterns("__pycache__"))
        more = NEXT.format(before=migrations.newest(), says=says)
        (folder / "versions" / "9999_next.py").write_text(more)
        with monkeypatch.context() as patch:
            patch.setattr(migrations, "script_folder", lambda: folder)
            yield

    return release


@pytest.fixture
def url(request: pytest.FixtureRequest) -> Iterator[str]:
    """A PostgreSQL without tables."""
    databases = request.getfixturevalue("databases")
    name = databases.bare()
    yield databases.url(name)
    databases.drop(name)


@pytest.fixture
def database_url(bare_url: str) -> str:
    """A migrated database of its own, whose schema the test may change."""
    engine = open_engine(bare_url)
    migrations.migrate(engine)
    engine.dispose()
    return bare_url


def one(name: str) -> dict[str, Any]:
    return {"id": name, "blade": "B1", "quantity": "elongation", "time_h": 8e3, "value": 0.11}


def test_an_older_process_goes_on_where_all_newer_migrations_say_that_it_may(
    serving: Serving, store: SqlStore, settings: Settings, worker: Worker, rotor: str,
    later: Callable[..., Any], caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    """It serves, writes and works; one that is started now starts, too, and says so."""
    needed = migrations.newest()
    with serving() as client:
        with later(MAY):
            assert migrations.migrate(store.engine) == "9999"
        answer = client.get("/readyz")
        assert (answer.status_code, answer.json()["schema"]) == (200, "9999")
        assert client.post(f"/v1/rotors/{rotor}/inspections", json=one("i1")).status_code == 202
        worker.drain()
        assert client.get(f"/v1/rotors/{rotor}").json()["posterior"]["sealed"] is True
    for when in ("never", "always"):
        caplog.clear()
        prepare(store, settings.model_copy(update={"migrate": when}))
        assert f"newer schema 9999; this release ({needed}) may run on it" in caplog.text
    done = CliRunner().invoke(
        app, ["migrate"], env={"BLADETWIN_DATABASE_URL": settings.database_url}
    )
    assert (done.exit_code, "9999, newer than" in done.output) == (0, True), done.output
    assert migrations.current(store.engine) == "9999"


@pytest.mark.parametrize("says", [MAY_NOT, ""])
def test_an_older_process_is_not_ready_where_one_says_that_it_may_not_or_nothing(
    says: str, serving: Serving, store: SqlStore, settings: Settings, later: Callable[..., Any]
) -> None:
    with serving() as client:
        with later(says):
            migrations.migrate(store.engine)
        answer = client.get("/readyz")
    assert answer.status_code == 503
    assert answer.json()["remedy"].startswith("upgrade this process")
    assert "the database needs 9999" in answer.json()["remedy"]
    for when in ("never", "always"):
        with pytest.raises(SchemaError, match=r"9999.*upgrade this process"):
            prepare(store, settings.model_copy(update={"migrate": when}))


def test_every_migration_from_the_first_that_is_looked_at_says_whether_older_processes_may_go_on(
    bare_url: str,
) -> None:
    line = list(ScriptDirectory.from_config(migrations._config()).walk_revisions())
    numbers = [script.revision for script in line]
    for script in line[: numbers.index("0012") + 1]:
        assert isinstance(script.module.OLDER_MAY_RUN, bool), f"{script.revision} does not say"
    engine = open_engine(bare_url)
    migrations.migrate(engine)
    with transaction(engine, write=False) as connection:
        assert migrations._since(connection) == migrations.oldest() >= "0012"
    engine.dispose()


# -- a migration beside ingest, on PostgreSQL ------------------------------------------------------

LOCK_ROTOR = "SELECT head_seq FROM rotor WHERE id = 'r1' FOR UPDATE"
ENTRY = (
    "INSERT INTO event (rotor_id, seq, event_id, kind, blade, time_h, body, digest, received_at) "
    "VALUES ('r1', :seq, :id, 'inspection', 'B1', 8000, '{}', 'd', 0)"
)


def posted(connection: Connection, name: str, between: Callable[[], None] = lambda: None) -> None:
    """What a post of the first release does."""
    seq = connection.execute(text(LOCK_ROTOR)).scalar_one() + 1
    between()
    connection.execute(text(ENTRY), {"seq": seq, "id": name})
    connection.execute(text("UPDATE rotor SET head_seq = :seq WHERE id = 'r1'"), {"seq": seq})
    connection.execute(text("UPDATE cursor SET dirty = true WHERE rotor_id = 'r1'"))


def at(engine: Engine, revision: str) -> None:
    """The schema of a revision, with a rotor."""
    with transaction(engine, write=True) as connection:
        command.upgrade(migrations._config(connection), revision)
        for statement in (
            "INSERT INTO model VALUES ('m', '1', 'd', '{}', '{}', 0)",
            "INSERT INTO rotor (id, model_id, model_version, particles, seed, head_seq, digest,"
            " created_at) VALUES ('r1', 'm', '1', 64, 7, 0, 'd', 0)",
            "INSERT INTO cursor (rotor_id, applied_seq, version, dirty, fence, sealing, attempts,"
            " blocked) VALUES ('r1', 0, 0, false, 0, false, 0, false)",
        ):
            connection.execute(text(statement))


def waiting_for_locks(engine: Engine) -> int:
    query = "SELECT count(*) FROM pg_locks WHERE NOT granted AND locktype = 'relation'"
    with transaction(engine, write=False) as connection:
        return int(connection.execute(text(query)).scalar_one())


@pytest.fixture
def bare(url: str) -> Iterator[Engine]:
    engine = open_engine(url)
    yield engine
    engine.dispose()


@pytest.fixture
def busy(bare: Engine) -> Engine:
    at(bare, "0003")
    return bare


def migrating(engine: Engine, **given: Any) -> tuple[threading.Thread, list[Any]]:
    """A migration in a thread, and what came of it."""
    told: list[Any] = []

    def run() -> None:
        try:
            told.append(migrations.migrate(engine, **given))
        except Exception as error:
            told.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    return thread, told


def test_a_post_that_has_its_rotor_and_a_migration_do_not_wait_for_each_other(
    busy: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """0004 changes `event` and 0006 `rotor`; a post takes them the other way round."""
    monkeypatch.setattr(migrations, "PAUSE_S", 0.05)
    with transaction(busy, write=True) as connection:
        began: list[tuple[threading.Thread, list[Any]]] = []

        def between() -> None:
            began.append(migrating(busy))
            until("its turn to wait", lambda: waiting_for_locks(busy) > 0)

        posted(connection, "i1", between)
    thread, told = began[0]
    thread.join(PATIENCE_S)
    assert told == [migrations.newest()]
    with transaction(busy, write=False) as connection:
        assert connection.execute(text("SELECT count(*) FROM event")).scalar() == 1


def test_table_by_table_one_of_the_two_is_ended(
    busy: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Negative control: what the migrations do by themselves."""
    monkeypatch.setattr(migrations, "lock_all", lambda *_: None)
    told: list[Any] = []
    try:
        with transaction(busy, write=True) as connection:
            began: list[tuple[threading.Thread, list[Any]]] = []

            def between() -> None:
                began.append(migrating(busy))
                until("its turn to wait", lambda: waiting_for_locks(busy) > 0)

            posted(connection, "i1", between)
    except StoreAwayError as error:
        told.append(error.cause)
    thread, of_migration = began[0]
    thread.join(PATIENCE_S)
    told += [one.cause for one in of_migration if isinstance(one, StoreAwayError)]
    assert told == ["DeadlockDetected"]


@pytest.mark.parametrize("revision", ["0001", "0003", "0005"])
def test_ingest_goes_on_while_a_database_is_migrated(
    bare: Engine, revision: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Posts, claims and reads of the first release: none is refused, none is lost."""
    monkeypatch.setattr(migrations, "PAUSE_S", 0.1)
    engine = bare
    at(engine, revision)
    stop, faults, done = threading.Event(), list[BaseException](), list[str]()

    def keep(work: Callable[[Connection, str], None], name: str) -> None:
        number = 0
        while not stop.wait(random.uniform(0.0, 0.02)):
            number += 1
            try:
                with transaction(engine, write=True) as connection:
                    work(connection, f"{name}-{number}")
            except BaseException as error:
                faults.append(error)
            else:
                done.append(f"{name}-{number}")

    def claim(connection: Connection, name: str) -> None:
        """A worker: cursor before log, and the rotor last."""
        own = "SELECT fence FROM cursor WHERE rotor_id = 'r1' FOR UPDATE"
        connection.execute(text(own))
        connection.execute(text("SELECT count(*) FROM event"))
        connection.execute(text("SELECT count(*) FROM state_array"))

    def read(connection: Connection, name: str) -> None:
        for table in ("state", "event", "rotor", "job"):
            connection.execute(text(f"SELECT count(*) FROM {table}"))

    works = [("p", posted), ("q", posted), ("r", posted), ("c", claim), ("s", read)]
    threads = [threading.Thread(target=keep, args=(work, name)) for name, work in works]
    for thread in threads:
        thread.start()
    until("some", lambda: len(done) > 20)
    try:
        assert migrations.migrate(engine, AGES_S) == migrations.newest()
        so_far = len(done)
        until("more", lambda: len(done) > so_far + 20)
    finally:
        stop.set()
        for thread in threads:
            thread.join(PATIENCE_S)
    assert faults == []
    with transaction(engine, write=False) as connection:
        kept = {row[0] for row in connection.execute(text("SELECT event_id FROM event"))}
    assert kept == {name for name in done if name[0] in "pqr"}


def test_who_holds_a_table_for_too_long_is_named_and_nothing_is_changed(
    busy: Engine, url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A backup, say; meanwhile posts go through, and the next attempt after it does as well.

    Were tables held all the while, the first post would wait for the end, and be the only one.
    """
    with transaction(busy, write=True) as connection:
        connection.execute(text("SET LOCAL application_name = 'nightly backup'"))
        connection.execute(text("LOCK TABLE blade IN ACCESS SHARE MODE"))
        pid = connection.execute(text("SELECT pg_backend_pid()")).scalar()
        names: list[str] = []
        attempts: list[int] = []
        real = migrations.lock_all

        def lock_all(connection: Connection, order: Sequence[str], attempt: int) -> None:
            attempts.append(attempt)
            real(connection, order, attempt)

        def clock() -> float:
            over = len(attempts) >= 4 and len(names) >= 4
            return time.monotonic() + (AGES_S if over else 0.0)

        monkeypatch.setattr(migrations, "lock_all", lock_all)
        monkeypatch.setattr(migrations, "time", SimpleNamespace(monotonic=clock, sleep=time.sleep))
        thread, told = migrating(busy, patience_s=PATIENCE_S)
        while thread.is_alive():
            names.append(f"i{len(names)}")
            with transaction(busy, write=True) as other:
                posted(other, names[-1])
            time.sleep(0.01)
            connection.execute(text("SELECT 1"))
        assert isinstance(told[0], SchemaError), told
        assert f"process {pid} (nightly backup) for" in str(told[0])
        assert "nothing was changed" in str(told[0])
        done = CliRunner().invoke(
            app, ["migrate", "--patience", "0"], env={"BLADETWIN_DATABASE_URL": url}
        )
        assert "in 1 attempts within 0 s" in str(done.exception)
    assert migrations.current(busy) == "0003"
    assert migrations.migrate(busy) == migrations.newest()
    with transaction(busy, write=False) as connection:
        assert connection.execute(text("SELECT count(*) FROM event")).scalar() == len(names) > 2


def test_an_attempt_that_holds_a_table_ends_before_deadlocks_are_looked_for(busy: Engine) -> None:
    """And the table that it could not have is waited for, by who holds nothing, next time."""
    order = standstill.first_order()
    limits: list[int] = []

    def note(_c: object, _cursor: object, statement: str, *_: object) -> None:
        if found := re.fullmatch(r"SET LOCAL lock_timeout = (\d+)", statement):
            limits.append(int(found[1]))

    event.listen(busy, "before_cursor_execute", note)
    with transaction(busy, write=False) as connection:
        assert connection.execute(text("SHOW deadlock_timeout")).scalar() == "1s"
    with transaction(busy, write=True) as other:
        other.execute(text("LOCK TABLE state IN ACCESS SHARE MODE"))
        times, asked_for = [], []
        for attempt, asked in [(1, order), (1, ["state"]), (5, ["state"])]:
            limits.clear()
            begun = time.monotonic()
            with pytest.raises(standstill.InUseError) as told, transaction(busy, write=True) as own:
                standstill.lock_all(own, asked, attempt)
            assert told.value.table == "state"
            times.append(time.monotonic() - begun)
            asked_for.append([*limits])
    assert max(asked_for[0][1:]) <= 50, "of one that holds a table; it is half a second in all"
    assert len(asked_for[0]) > 5
    assert asked_for[1:] == [[500], [2000]]
    assert times[1] >= 0.5
    assert times[2] >= 2.0, "for an autovacuum to be ended"


def test_a_post_that_waits_too_long_for_a_migration_is_told_to_come_again(
    serving: Serving, store: SqlStore, settings: Settings, rotor: str,
    later: Callable[..., Any], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """And one that does not simply takes its time."""
    if is_sqlite(store.engine):
        pytest.skip("SQLite has one writer, who is waited for 30 s")
    monkeypatch.setattr(postgres, "LOCKED_S", 1.0)
    store.engine.dispose()
    upgrade, answered = command.upgrade, threading.Event()

    def slowly(config: Config, revision: str) -> None:
        upgrade(config, revision)
        assert answered.wait(PATIENCE_S)

    monkeypatch.setattr(command, "upgrade", slowly)
    with serving() as client, later(MAY):
        engine = open_engine(settings.database_url)
        thread, told = migrating(engine)
        until("the migration", lambda: locked(engine))
        answer = client.post(f"/v1/rotors/{rotor}/inspections", json=one("i1"))
        answered.set()
        assert (answer.status_code, answer.headers["retry-after"]) == (503, "1")
        thread.join(PATIENCE_S)
        assert told == ["9999"]
        answer = client.post(f"/v1/rotors/{rotor}/inspections", json=one("i1"))
        assert answer.status_code == 202
        engine.dispose()


def locked(engine: Engine) -> bool:
    query = (
        "SELECT count(*) FROM pg_locks WHERE granted AND mode = 'AccessExclusiveLock'"
        " AND relation = 'event'::regclass"
    )
    with transaction(engine, write=False) as connection:
        return bool(connection.execute(text(query)).scalar_one())


def test_a_worker_rests_while_a_newer_release_says_that_its_own_may_not_run(
    store: SqlStore,
    worker: Worker,
    rotor: str,
    post: Callable[..., int],
    reading: Callable[..., Inspection],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A rotor with fields that it does not know it would block, and call damaged."""
    monkeypatch.setattr(loop, "SCHEMA_S", 0.05)
    monkeypatch.setattr(loop, "IDLE_S", 0.02)
    running = threading.Thread(target=worker.run)
    running.start()
    try:
        until("its first version", lambda: view_rotor(store, rotor).rotor.version > 0)
        say(store.engine, "9999", "9999")
        until("it noticed", worker.outdated)
        post(rotor, reading("a"))
        time.sleep(0.5)
        assert view_rotor(store, rotor).rotor.applied_seq == 0
        say(store.engine, "9999", migrations.newest())
        until("it went on", lambda: view_rotor(store, rotor).rotor.applied_seq == 1)
    finally:
        worker.stop()
        running.join(PATIENCE_S)
    (told,) = [one.getMessage() for one in caplog.records if "rests" in one.getMessage()]
    assert "To mend it: upgrade this process" in told


def test_a_worker_that_may_not_run_loads_no_model_before_it_may(
    store: SqlStore, worker: Worker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The newer release's models it would take for damaged ones, and end."""
    monkeypatch.setattr(loop, "SCHEMA_S", 0.05)
    monkeypatch.setattr(loop, "IDLE_S", 0.02)
    warmed: list[bool] = []
    monkeypatch.setattr(worker, "warm", lambda: warmed.append(True))
    say(store.engine, "9999", "9999")
    running = threading.Thread(target=worker.run)
    running.start()
    try:
        time.sleep(0.3)
        assert not warmed
        say(store.engine, "9999", migrations.newest())
        until("it is warm", lambda: bool(warmed))
    finally:
        worker.stop()
        running.join(PATIENCE_S)


def test_posts_are_refused_while_a_newer_release_says_that_this_one_may_not_run(
    serving: Serving, store: SqlStore, rotor: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They were answered with 202, in a form that the newer release may not read."""
    monkeypatch.setattr(outdated, "LOOK_S", 0.0)
    path = f"/v1/rotors/{rotor}/inspections"
    with serving() as client:
        assert client.post(path, json=one("i1")).status_code == 202
        say(store.engine, "9999", "9999")
        for asked in (client.post(path, json=one("i2")), client.delete("/v1/webhooks/w1")):
            assert (asked.status_code, asked.headers["retry-after"]) == (503, "5")
            assert asked.json()["type"] == "urn:bladetwin:problem:outdated"
            assert "schema 9999 is not one that this release may write to" in asked.json()["detail"]
            assert "To mend it: upgrade this process" in asked.json()["detail"]
        assert client.get(f"/v1/rotors/{rotor}").json()["head_seq"] == 1
        assert len(client.get("/v1/audit").json()["items"]) == 1
        say(store.engine, "9999", migrations.newest())
        assert client.post(path, json=one("i2")).status_code == 202


def test_nothing_is_sent_to_webhooks_while_a_newer_release_says_so(
    store: SqlStore, settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(deliver, "SCHEMA_S", 0.0)
    monkeypatch.setattr(deliver, "IDLE_S", 0.02)
    say(store.engine, "9999", "9999")
    sender = make_deliverer(store, settings, "sender")
    drained: list[bool] = []
    monkeypatch.setattr(sender, "drain", lambda: drained.append(True))
    running = threading.Thread(target=sender.run)
    running.start()
    try:
        time.sleep(0.3)
        assert not drained
        say(store.engine, "9999", migrations.newest())
        until("it went on", lambda: bool(drained))
    finally:
        sender.stop()
        running.join(PATIENCE_S)


def say(engine: Engine, revision: str, since: str) -> None:
    """What a newer release writes, with the oldest revision whose processes may go on."""
    with transaction(engine, write=True) as connection:
        connection.execute(text(f"UPDATE alembic_version SET version_num = '{revision}'"))
        connection.execute(text(f"UPDATE compatible_since SET revision = '{since}'"))
