"""The migrated schema is the declared one."""

from __future__ import annotations

import json
import threading
import time
from hashlib import sha256

import httpx
import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from sqlalchemy import text

from core.observation import Inspection
from service.bootstrap import make_worker
from service.fake import FakeScience
from service.handlers import reads
from service.handlers.blades import add_blade
from service.handlers.questions import question
from service.handlers.rotors import create_rotor, view_rotor
from service.ports import BladeRecord, ModelCard, Which
from service.settings import Settings
from service.store import migrate as migrations
from service.store import postgres
from service.store.engine import is_sqlite, open_engine, transaction
from service.store.schema import metadata
from service.store.unit_of_work import SqlStore
from tests.patience import PATIENCE_S, behind_a_lock, until


def test_a_migrated_database_differs_in_nothing_from_the_declared_tables(bare_url: str) -> None:
    engine = open_engine(bare_url)
    assert migrations.current(engine) is None
    migrations.migrate(engine)
    assert migrations.current(engine) == migrations.newest()
    with transaction(engine, write=False) as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, metadata) == []
    engine.dispose()


def test_the_comparison_would_notice_a_column_that_no_migration_makes(bare_url: str) -> None:
    engine = open_engine(bare_url)
    migrations.migrate(engine)
    with transaction(engine, write=True) as connection:
        connection.execute(text("ALTER TABLE rotor ADD COLUMN stray INTEGER"))
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert [one[0] for one in compare_metadata(context, metadata)] == ["remove_column"]
    engine.dispose()


def test_array_bytes_are_stored_uncompressed_whichever_way_the_table_was_made(
    bare_url: str,
) -> None:
    engine = open_engine(bare_url)
    query = text(
        "SELECT attstorage FROM pg_attribute "
        "WHERE attrelid = 'state_array'::regclass AND attname = 'data'"
    )
    if is_sqlite(engine):
        query = text("SELECT 'e'")
    migrations.migrate(engine)
    with transaction(engine, write=True) as connection:
        assert connection.execute(query).scalar() == "e"
        metadata.drop_all(connection)
        metadata.create_all(connection)
        assert connection.execute(query).scalar() == "e"
    engine.dispose()


def test_a_second_migration_finds_nothing_to_do_and_a_downgrade_leaves_no_table(
    bare_url: str,
) -> None:
    engine = open_engine(bare_url)
    assert migrations.migrate(engine) == migrations.migrate(engine)
    with transaction(engine, write=True) as connection:
        command.downgrade(migrations._config(connection), "base")
        found = set(metadata.tables) & set(engine.dialect.get_table_names(connection))
        assert found == set()
    engine.dispose()


BLADE = {"slot": None, "lot": None, "coating_lot": None, "installed_at": None, "time_h0": None}
READING = {"id": "i1", "blade": "B1", "quantity": "elongation", "time_h": 8e3, "values": [0.11]}


def _rows_of_the_first_release(card: ModelCard) -> list[tuple[str, dict[str, object]]]:
    """A rotor with a blade and a pending reading, as release 0.1.0 wrote them."""
    blade = BLADE | {"id": "B1", "added_seq": 0, "retired_seq": None}
    body = ["r1", card.id, [blade], 64, 7]
    text = json.dumps(body, sort_keys=True, separators=(",", ":"))
    model = {"id": card.id, "version": card.version, "digest": card.digest, "source": "{}"}
    reading = Inspection.from_json(READING)
    rotor = {"id": "r1", "model_id": card.id, "model_version": card.version, "particles": 64}
    rotor |= {"seed": 7, "head_seq": 1, "digest": sha256(text.encode()).hexdigest()}
    event = {"event_id": "i1", "seq": 1, "kind": "inspection", "blade": "B1", "time_h": 8e3}
    event |= {"body": json.dumps(reading.to_json()), "digest": reading.digest()}
    cursor = {"applied_seq": 0, "version": 0, "dirty": True, "fence": 0, "attempts": 0}
    cursor |= {"sealing": False, "blocked": False}
    of_rotor = {"rotor_id": "r1"}
    return [
        ("model", model | {"card": json.dumps(card.to_json()), "created_at": 0.0}),
        ("rotor", rotor | {"created_at": 0.0}),
        ("blade", of_rotor | blade),
        ("event", of_rotor | event | {"received_at": 0.0}),
        ("cursor", of_rotor | cursor),
    ]


def test_a_rotor_of_the_first_release_goes_on_after_the_migration(bare_url: str) -> None:
    science = FakeScience()
    store = SqlStore(open_engine(bare_url))
    with transaction(store.engine, write=True) as connection:
        command.upgrade(migrations._config(connection), "0001")
        for table, row in _rows_of_the_first_release(science.builtin("rotor-blade")):
            names = ", ".join(f":{name}" for name in row)
            connection.execute(
                text(f"INSERT INTO {table} ({', '.join(row)}) VALUES ({names})"), row
            )
    migrations.migrate(store.engine)
    settings = Settings(database_url=bare_url, science="fake", seal_after_s=0.0)
    make_worker(store, science, settings).drain()
    view = view_rotor(store, "r1")
    assert (view.rotor.applied_seq, view.rotor.network, view.blades[0].known) == (1, None, None)
    again = create_rotor(store, "r1", "rotor-blade", [BladeRecord("B1")], 64, 7)
    assert again[2] is False, "the same body still gets the same answer"
    assert add_blade(store, "r1", BladeRecord("B1")).new is False
    found = reads.basis(store, science, "r1", Which(), "B1")
    asked = question(found.card, "elongation", [25_000.0], None, 0.95)
    assert reads.predict(store, science, found, asked)["mean"][0] > 0
    store.close()


def test_who_comes_second_waits_for_a_long_migration(
    bare_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Longer than any other lock is waited for."""
    if not bare_url.startswith("postgresql"):
        pytest.skip("SQLite has one writer, who is waited for 30 s")
    monkeypatch.setattr(postgres, "LOCKED_S", 0.4)
    first, second = open_engine(bare_url), open_engine(bare_url)
    done: list[str] = []
    with transaction(first, write=True) as connection:
        connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": migrations.LOCK})
        waiting = threading.Thread(target=lambda: done.append(migrations.migrate(second)))
        waiting.start()
        until("its turn to wait", lambda: behind_a_lock(second))
        time.sleep(0.8)
        assert waiting.is_alive()
    waiting.join(PATIENCE_S)
    assert done == [migrations.newest()]
    for engine in (first, second):
        engine.dispose()


@pytest.mark.parametrize(
    ("statement", "remedy", "found"),
    [
        ("UPDATE alembic_version SET version_num = '9999'", "upgrade this process", "9999"),
        ("UPDATE alembic_version SET version_num = '0001'", "run `bladetwin migrate`", "0001"),
        ("DELETE FROM alembic_version", "run `bladetwin migrate`", None),
    ],
)
def test_another_schema_is_not_ready_and_says_whether_to_migrate_or_to_upgrade(
    api: httpx.Client, store: SqlStore, statement: str, remedy: str, found: str | None
) -> None:
    with store.write() as tx:
        tx.connection.execute(text(statement))
        tx.connection.execute(text("DELETE FROM compatible_since"))
    answer = api.get("/readyz")
    assert (answer.status_code, answer.json()["schema"]) == (503, found)
    assert answer.json()["remedy"].startswith(remedy)
