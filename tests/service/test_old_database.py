"""A database of the first release goes on with this one; a migration that dies is no migration."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import httpx
import pytest
from alembic import command
from sqlalchemy import text
from typer.testing import CliRunner

from core.digest import state_digest
from core.log import effective
from core.observation import Inspection
from service.bootstrap import make_worker, prepare
from service.cli import app
from service.entries import entries_of
from service.errors import SchemaError
from service.fake import FakeScience
from service.ports import RotorSpec
from service.settings import Settings
from service.store import migrate as migrations
from service.store.encoding import encode
from service.store.engine import open_engine, transaction
from service.store.entries import read_entries
from service.store.unit_of_work import SqlStore
from tests.service.conftest import RunningServer, served

ROOT = Path(__file__).parents[2]
SCIENCE = FakeScience()
CARD = SCIENCE.builtin("rotor-blade")
T0 = 1_760_000_000.0
Row = dict[str, Any]
FACTS = {"slot": None, "lot": None, "coating_lot": None, "installed_at": None, "time_h0": None}


def digest(value: object) -> tuple[str, str]:
    told = json.dumps(value, sort_keys=True, separators=(",", ":"))
    return told, sha256(told.encode()).hexdigest()


def reading(name: str, **given: Any) -> Inspection:
    plain = {"id": name, "blade": "B1", "quantity": "elongation", "time_h": 8e3, "values": [0.11]}
    return Inspection.from_json(plain | given)


@dataclass(slots=True)
class Old:
    """Rows as release 0.1.0 wrote them, in the order in which they have to be inserted."""

    rows: list[tuple[str, Row]]

    def event(self, rotor: str, seq: int, event_id: str, kind: str, **given: Any) -> None:
        told, own = digest(given.pop("told", {}))
        row = {"rotor_id": rotor, "seq": seq, "event_id": event_id, "kind": kind, "body": told}
        row |= {"digest": own, "received_at": T0 + seq, "replaces": None, "blade": None}
        self.rows.append(("event", row | {"time_h": None} | given))

    def inspection(self, rotor: str, seq: int, one: Inspection) -> None:
        given = {"body": json.dumps(one.to_json()), "digest": one.digest(), "blade": one.blade}
        given |= {"replaces": one.replaces, "time_h": one.time_h}
        self.event(rotor, seq, one.id, "inspection", **given)


def rows() -> list[tuple[str, Row]]:
    """Two rotors: one with a posterior, entries of every kind and two pending; one blocked."""
    old = Old([])
    model = {"id": CARD.id, "version": CARD.version, "digest": CARD.digest, "source": "{}"}
    old.rows.append(("model", model | {"card": json.dumps(CARD.to_json()), "created_at": T0}))
    job = {"id": "5f0e", "kind": "register-model", "status": "done", "attempts": 1, "fence": 1}
    job |= {"request": '{"builtin": "rotor-blade"}', "result": '{"model": "rotor-blade"}'}
    old.rows.append(("job", job | {"created_at": T0, "finished_at": T0 + 1}))
    for name, head in (("old", 6), ("stuck", 1)):
        blades = [FACTS | {"id": b, "added_seq": 0, "retired_seq": None} for b in ("B1", "B2")]
        _, own = digest([name, CARD.id, blades, 64, 7])
        rotor = {"id": name, "model_id": CARD.id, "model_version": CARD.version, "particles": 64}
        rotor |= {"seed": 7, "head_seq": head, "digest": own, "created_at": T0}
        old.rows.append(("rotor", rotor))
        old.rows += [("blade", {"rotor_id": name} | one) for one in blades]
    third = FACTS | {"id": "B3", "lot": "L7", "added_seq": 3, "retired_seq": None}
    old.rows.append(("blade", {"rotor_id": "old"} | third))
    old.inspection("old", 1, reading("i1"))
    old.inspection("old", 2, reading("i2", blade="B2", time_h=16e3, values=[0.2]))
    told = FACTS | {"id": "B3", "lot": "L7", "added_seq": 0, "retired_seq": None}
    old.event("old", 3, "blade/B3", "blade", blade="B3", told=told)
    old.event("old", 4, "retraction/i2", "retraction", replaces="i2")
    old.inspection("old", 5, reading("i1b", values=[0.12], replaces="i1"))
    old.inspection("old", 6, reading("i3", blade="B3", time_h=24e3, values=[0.3]))
    old.inspection("stuck", 1, reading("s1"))
    applied = [reading("i1")]
    spec = RotorSpec("old", ("B1", "B2", "B3"), 64, 7)
    made = SCIENCE.update(CARD, spec, applied, None, quick=False)
    short = {k: made.meta["health"][k] for k in ("ess", "ess_ratio")}  # that release said no more
    meta = {**made.meta, "health": short}
    encoded = {name: encode(array) for name, array in made.arrays.items()}
    own = state_digest(meta, {name: one.sha256 for name, one in encoded.items()})
    state = {"rotor_id": "old", "version": 1, "through_seq": 4, "model_id": CARD.id}
    state |= {"model_version": CARD.version, "algorithm_version": meta["algorithm_version"]}
    state |= {"sealed": True, "digest": own, "events_digest": meta["events_digest"]}
    old.rows.append(("state", state | {"meta": json.dumps(meta), "created_at": T0 + 10}))
    for name, one in encoded.items():
        array = {"rotor_id": "old", "name": name, "version": 1, "encoding": one.encoding}
        array |= {"dtype": one.dtype, "shape": one.shape, "sha256": one.sha256, "data": one.data}
        old.rows.append(("state_array", array))
    cursor = {"dirty": True, "fence": 3, "attempts": 0, "sealing": False, "blocked": False}
    cursor |= {"dirty_since": T0 + 5, "last_error": None, "last_error_event": None}
    old.rows.append(("cursor", {"rotor_id": "old", "applied_seq": 4, "version": 1} | cursor))
    stuck = {"blocked": True, "attempts": 5, "last_error": "X: y", "last_error_event": "s1"}
    old.rows.append(
        ("cursor", {"rotor_id": "stuck", "applied_seq": 0, "version": 0} | cursor | stuck)
    )
    note = {"rotor_id": "old", "kind": "applied", "at": T0 + 10}
    told_note = '{"version": 1, "through_seq": 4, "sealed": true}'
    old.rows.append(("outbox", note | {"payload": told_note}))
    return old.rows


def make_old(url: str) -> None:
    """A database at revision 0001 with the rows, by plain SQL."""
    engine = open_engine(url)
    with transaction(engine, write=True) as connection:
        command.upgrade(migrations._config(connection), "0001")
        for table, row in rows():
            names = ", ".join(f":{name}" for name in row)
            sql = f"INSERT INTO {table} ({', '.join(row)}) VALUES ({names})"
            connection.execute(text(sql), row)
    assert migrations.current(engine) == "0001"
    engine.dispose()


def stored(url: str) -> dict[str, list[Row]]:
    """Every old row, by the columns of its time."""
    columns: dict[str, Row] = {}
    for table, row in rows():
        columns[table] = columns.get(table, {}) | row
    engine = open_engine(url)
    with transaction(engine, write=False) as connection:
        found = {
            table: sorted(
                (dict(row) for row in connection.execute(
                    text(f"SELECT {', '.join(names)} FROM {table}")).mappings()),
                key=repr,
            )
            for table, names in columns.items()
        }  # fmt: skip
    engine.dispose()
    return found


def test_no_row_of_the_first_release_is_lost_or_changed_by_the_migration(bare_url: str) -> None:
    make_old(bare_url)
    before = stored(bare_url)
    assert {table: len(found) for table, found in before.items()} == {
        "model": 1, "job": 1, "rotor": 2, "blade": 5, "event": 7, "state": 1, "state_array": 4,
        "cursor": 2, "outbox": 1,
    }  # fmt: skip
    engine = open_engine(bare_url)
    migrations.migrate(engine)
    engine.dispose()
    assert stored(bare_url) == before


def test_the_service_serves_and_goes_on_with_a_database_of_the_first_release(
    bare_url: str, server: RunningServer
) -> None:
    make_old(bare_url)
    store = SqlStore(open_engine(bare_url))
    migrations.migrate(store.engine)
    settings = Settings(database_url=bare_url, science="fake", seal_after_s=0.0)
    with served(store, SCIENCE, settings, server) as client:
        check_as_it_was(client)
        worker = make_worker(store, SCIENCE, settings)
        worker.drain()
        check_going_on(client, store)
        worker.drain()
        assert client.get("/v1/rotors/stuck").json()["status"] == "current"
    store.close()
    environ = {"BLADETWIN_DATABASE_URL": bare_url, "BLADETWIN_SCIENCE": "fake"}
    done = CliRunner().invoke(app, ["verify", "--json"], env=environ)
    assert (done.exit_code, json.loads(done.stdout)["findings"]) == (0, [])
    done = CliRunner().invoke(app, ["replay", "old", "--json"], env=environ)
    assert json.loads(done.stdout)["same"] is True


def got(client: httpx.Client, path: str) -> Any:
    answer = client.get(path)
    assert answer.status_code == 200, answer.text
    return answer.json()


def check_as_it_was(client: httpx.Client) -> None:
    rotor = got(client, "/v1/rotors/old")
    assert (rotor["head_seq"], rotor["applied_seq"], rotor["version"]) == (6, 4, 1)
    assert [blade["id"] for blade in rotor["blades"]] == ["B1", "B2", "B3"]
    assert rotor["posterior"]["sealed"] is True
    assert got(client, "/v1/rotors/old/posterior")["health"]["status"] == "unknown"
    assert got(client, "/v1/rotors/old/blades/B1/prediction?times=25000")["mean"][0] > 0
    listed = got(client, "/v1/rotors/old/inspections")["items"]
    status = {one["id"]: one["status"] for one in listed}
    assert status == {"i1": "replaced", "i2": "retracted", "i1b": "counts", "i3": "counts"}
    stuck = got(client, "/v1/rotors/stuck")
    assert (stuck["status"], stuck["last_error"]["event"]) == ("blocked", "s1")
    assert got(client, "/v1/jobs/5f0e")["status"] == "done"


def check_going_on(client: httpx.Client, store: SqlStore) -> None:
    again = {"id": "i1", "blade": "B1", "quantity": "elongation", "time_h": 8000.0, "value": 0.11}
    answer = client.post("/v1/rotors/old/inspections", json=again)
    assert (answer.status_code, answer.json()["items"][0]["seq"]) == (202, 1), "the first answer"
    rotor = got(client, "/v1/rotors/old")
    assert (rotor["status"], rotor["applied_seq"]) == ("current", 6)
    with store.read() as tx:
        entries = entries_of(read_entries(tx.connection, "old", 0, 6))
        state = tx.states.get("old")
    assert sorted(one.id for one in effective(entries)) == ["i1b", "i3"]
    spec = RotorSpec("old", ("B1", "B2", "B3"), 64, 7)
    assert state.digest == SCIENCE.update(CARD, spec, effective(entries), None, quick=False).digest
    assert got(client, "/v1/rotors/old/posterior?version=1")["health"]["status"] == "unknown"
    assert client.post("/v1/rotors/stuck/retry").status_code == 202


def killed(url: str, how: str) -> Any:
    done = subprocess.run(
        [sys.executable, str(Path(__file__).with_name("killed_migration.py")), url, how],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout)


def test_a_migration_killed_at_any_statement_leaves_the_old_schema_and_the_next_completes_it(
    bare_url: str,
) -> None:
    make_old(bare_url)
    before = stored(bare_url)
    told = killed(bare_url, "whole")
    assert told["torn"] == []
    assert told["statements"] > 20, "it was killed at each of them"
    assert told["code"] == 0, "the last attempt went through"
    assert told["end"][0] == migrations.newest()
    assert stored(bare_url) == before


def test_a_migration_that_commits_in_between_would_be_seen_torn(bare_url: str) -> None:
    """Negative control: what Alembic does on SQLite by itself."""
    make_old(bare_url)
    assert killed(bare_url, "halves")["torn"] != []


def test_a_database_of_a_newer_release_is_refused_and_left_alone(bare_url: str) -> None:
    """One that does not say that older releases may run on it (`test_rolling`)."""
    engine = open_engine(bare_url)
    migrations.migrate(engine)
    with transaction(engine, write=True) as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = '9999'"))
        connection.execute(text("DELETE FROM compatible_since"))
    with pytest.raises(SchemaError, match="9999"):
        migrations.migrate(engine)
    for when in ("never", "always"):
        settings = Settings(database_url=bare_url, migrate=when, science="fake")
        with pytest.raises(SchemaError, match=r"9999.*To mend it: upgrade this process"):
            prepare(SqlStore(engine), settings)
    assert migrations.current(engine) == "9999"
    engine.dispose()
