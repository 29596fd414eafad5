"""What was damaged is found by its digest, named, never used, and made again from the log."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import httpx
import pytest
from sqlalchemy import Connection, select, text
from typer.testing import CliRunner

from core.observation import Inspection
from service import entries
from service.bootstrap import make_worker
from service.cli import app as commands
from service.digests import digest_of_json
from service.errors import (
    DamagedError,
    DamagedRotorError,
    GoneError,
    HeldError,
    LostLeaseError,
)
from service.fake import FakeScience
from service.handlers.blades import add_blade, retire_blade
from service.handlers.rotors import create_rotor, retry, view_rotor
from service.ports import BladeRecord, NewEvent
from service.settings import Settings
from service.store import creation, intact, records
from service.store import tables as t
from service.store.audit import Finding, audit
from service.store.cache import Compared
from service.store.engine import snapshot, transaction
from service.store.unit_of_work import SqlStore
from service.worker import claiming, rebuild
from service.worker import lease as leases
from service.worker.loop import Worker
from service.worker.replay import from_log, replay
from service.worker.task import anew
from service.worker.update import Updater
from tests.service.smooth import formula_science

Make = Callable[..., Inspection]
Post = Callable[..., int]


def damage(store: SqlStore, statement: str, **values: Any) -> None:
    """Change a row behind everybody's back; it has to be there."""
    with transaction(store.engine, write=True) as connection:
        assert connection.execute(text(statement), values).rowcount >= 1


def findings(store: SqlStore, rotor: str) -> list[Finding]:
    with snapshot(store.engine) as connection:
        return audit(connection, rotor)


def sound(connection: Connection, rotor: str) -> list[BladeRecord]:
    return creation.sound_blades(connection, records.SqlRecords(connection).rotor(rotor))


def content(store: SqlStore, version: int) -> tuple[Any, ...]:
    """All of a version that a reader can see, read by a process that has nothing cached."""
    fresh = SqlStore(store.engine)
    with fresh.read() as tx:
        record = tx.states.get("r1", version)
        names = sorted(record.meta["blades"])
        get = tx.states.reader(record)
        arrays = [get(f"column/{n}").tobytes() for n in names] + [get("shared/moments").tobytes()]
    return (record.digest, record.events_digest, json.dumps(record.meta, sort_keys=True), arrays)


@pytest.fixture
def worn(worker: Worker, rotor: str, reading: Make, post: Post) -> str:
    """A rotor with four versions, the last three with a reading each."""
    worker.drain()
    for i, blade in enumerate(("B1", "B2", "B3")):
        post(rotor, reading(f"i{i}", blade=blade, value=0.11 + 0.01 * i))
        worker.drain()
    return rotor


META = """UPDATE state SET meta = replace(meta, '"readings": 3', '"readings": 4')"""
ROW = "UPDATE state_array SET {} WHERE name = 'column/B{}' AND version = {}"
# what is done, the part that is named, and whether the log mends it
DAMAGE: list[tuple[str, str, str, bool]] = [
    (META, "state", "4", True),
    ("UPDATE state SET meta = '{' WHERE version = 4", "state", "4", True),
    ("UPDATE state SET digest = 'x' WHERE version = 2", "state", "2", True),
    ("UPDATE state SET sealed = (1 = 0) WHERE version = 4", "state", "4", True),
    ("UPDATE state SET through_seq = 2 WHERE version = 4", "state", "4", True),
    ("UPDATE state SET through_seq = 2 WHERE version = 2", "state", "2", True),
    ("UPDATE state SET events_digest = 'x' WHERE version = 3", "state", "3", True),
    ("DELETE FROM state WHERE version = 4", "state", "4", True),
    (ROW.format("sha256 = 'x'", 2, 3), "array", "column/B2", True),
    (ROW.format("shape = '1'", 1, 2), "array", "column/B1", True),
    ("DELETE FROM state_array WHERE name = 'column/B3' AND version = 4", "state", "4", True),
    ("UPDATE event SET body = replace(body, '0.12', '0.13') WHERE seq = 2", "log", "i1", False),
    ("UPDATE event SET blade = 'B3' WHERE seq = 2", "log", "i1", False),
    ("UPDATE event SET digest = 'x' WHERE seq = 1", "log", "i0", False),
    ("DELETE FROM event WHERE seq = 2", "log", "2", False),
    ("UPDATE rotor SET head_seq = 4", "log", "4", False),
    ("UPDATE rotor SET seed = 8", "rotor", "r1", False),
    ("UPDATE rotor SET particles = 65", "rotor", "r1", False),
    ("UPDATE rotor SET adopt = 'effect'", "rotor", "r1", False),
    ("UPDATE rotor SET adopt_now = 'effect'", "rotor", "r1", False),
    ("UPDATE rotor SET policy_at = 0", "rotor", "r1", False),
    ("UPDATE rotor SET network = '{}'", "rotor", "r1", False),
    ("UPDATE rotor SET network = '{'", "rotor", "r1", False),
    ("UPDATE rotor SET digest = 'x'", "rotor", "r1", False),
    ("UPDATE blade SET lot = 'L9' WHERE id = 'B1'", "rotor", "r1", False),
    ("UPDATE blade SET known = '{\"load\": 1.5}' WHERE id = 'B2'", "rotor", "r1", False),
    ("UPDATE blade SET known = '{' WHERE id = 'B2'", "rotor", "r1", False),
    ("DELETE FROM blade WHERE id = 'B3'", "rotor", "r1", False),
    ("INSERT INTO blade (rotor_id, id, added_seq) VALUES ('r1', 'B9', 0)", "rotor", "r1", False),
    ("INSERT INTO blade (rotor_id, id, added_seq) VALUES ('r1', 'B9', 2)", "blade", "B9", False),
    ("UPDATE blade SET added_seq = 2 WHERE id = 'B1'", "blade", "B1", False),
    ("UPDATE blade SET retired_seq = 2 WHERE id = 'B1'", "blade", "B1", False),
]  # fmt: skip


def test_a_sound_rotor_has_no_finding(store: SqlStore, worn: str) -> None:
    assert findings(store, worn) == []


@pytest.mark.parametrize(("statement", "part", "name", "mendable"), DAMAGE)
def test_each_damaged_part_is_named_and_mended_from_the_log_where_the_log_has_it(
    store: SqlStore,
    worker: Worker,
    worn: str,
    statement: str,
    part: str,
    name: str,
    mendable: bool,
) -> None:
    before = [content(store, version) for version in (1, 2, 3, 4)]
    damage(store, statement)
    found = findings(store, worn)
    assert (part, name) in [(one.part, one.name) for one in found], found
    assert all(one.from_log == mendable for one in found)
    if not mendable:
        with pytest.raises(DamagedRotorError, match="import the rotor"):
            rebuild.repair(worker.updater, worn, found, renew=True)
        with transaction(store.engine, write=False) as connection:
            query = text("SELECT version FROM cursor")
            assert connection.execute(query).scalar() == 4, "nothing was made"
        return
    done = rebuild.repair(worker.updater, worn, found)
    assert findings(store, worn) == []
    if "through_seq = 2 WHERE version = 2" in statement:
        assert (done.restored, done.dropped) == ((), (2,)), "nothing else says where it ended"
        return
    assert done.dropped == ()
    if "DELETE FROM state WHERE" in statement:
        assert (done.restored, done.version) == ((), 5)
        assert content(store, 5) == before[3]
    else:
        assert done.version is None
        assert [content(store, version) for version in (1, 2, 3, 4)] == before


OF_BLADES = [
    ("UPDATE blade SET known = '{\"load\": 1.5}' WHERE id = 'B4'", "B4"),
    ("UPDATE blade SET lot = 'L9' WHERE id = 'B4'", "B4"),
    ("UPDATE blade SET time_h0 = 100.75 WHERE id = 'B4'", "B4"),
    ("UPDATE blade SET added_seq = 3 WHERE id = 'B4'", "B4"),
    ("DELETE FROM blade WHERE id = 'B4'", "B4"),
    ("UPDATE blade SET retired_seq = NULL WHERE id = 'B1'", "B1"),
    ("UPDATE blade SET retired_seq = 4 WHERE id = 'B1'", "B1"),
]


@pytest.mark.parametrize(("statement", "blade"), OF_BLADES)
def test_a_blade_that_joined_or_left_is_held_against_its_entries(
    store: SqlStore, worker: Worker, worn: str, statement: str, blade: str
) -> None:
    add_blade(store, worn, BladeRecord("B4", lot="Ω-7", time_h0=100.5))
    retire_blade(store, worn, "B1")
    worker.drain()
    assert findings(store, worn) == []
    damage(store, statement)
    found = findings(store, worn)
    assert [(one.part, one.name, one.from_log) for one in found] == [("blade", blade, False)]
    with pytest.raises(DamagedRotorError, match=f"blade {blade}: "):
        rebuild.repair(worker.updater, worn, [], renew=True)


HEAD = ("UPDATE rotor SET head_seq = 7", "rotor", "r1", False)
OF_ROTORS = [row[:3] for row in [*DAMAGE, HEAD] if row[1] in ("rotor", "blade")]
OF_ROTORS += [(statement, "blade", blade) for statement, blade in OF_BLADES]


@pytest.fixture
def moved(store: SqlStore, worker: Worker, worn: str) -> str:
    """The worn rotor after a blade joined and another left."""
    add_blade(store, worn, BladeRecord("B4", lot="Ω-7", time_h0=100.5))
    retire_blade(store, worn, "B1")
    worker.drain()
    return worn


def test_every_damage_of_a_row_is_noticed_before_anything_is_computed(
    store: SqlStore, moved: str
) -> None:
    for statement, part, name in OF_ROTORS:
        with store.engine.connect() as connection, connection.begin() as begun:
            connection.execute(text(statement))
            with pytest.raises(DamagedRotorError, match="import the rotor") as told:
                sound(connection, moved)
            begun.rollback()
        network, knows = "network = '{'" in statement, "known = '{'" in statement
        where = "its row's network" if network else "blade B2" if knows else f"{part} {name}"
        assert f"rotor {moved}: {where}" in "\n".join(told.value.problems), statement


@pytest.mark.parametrize("knows", [True, False], ids=["knows", "new"])
@pytest.mark.parametrize(
    ("statement", "whose"),
    [("UPDATE rotor SET seed = 8", "rotor r1"), (OF_BLADES[1][0], "blade B4"), (HEAD[0], "head")],
)
def test_a_damaged_row_blocks_its_rotor_and_is_named(
    store: SqlStore,
    worker: Worker,
    settings: Settings,
    moved: str,
    statement: str,
    whose: str,
    knows: bool,
) -> None:
    """Whether or not the worker knows the rotor from before."""
    damage(store, statement)
    damage(store, "UPDATE cursor SET dirty = true, dirty_since = 0")
    (worker if knows else make_worker(store, FakeScience(), settings)).drain()
    view = view_rotor(store, moved).rotor
    assert (view.blocked, view.version, view.attempts) == (True, 5, 5), "nothing was made"
    assert f"rotor {moved}: " in str(view.last_error)
    assert whose in str(view.last_error)
    assert "restore the database, or import the rotor" in str(view.last_error)


def test_rows_that_read_as_they_did_are_not_digested_again(
    store: SqlStore, worker: Worker, worn: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[object] = []
    real = creation.digest_of_rotor
    monkeypatch.setattr(
        creation, "digest_of_rotor", lambda *given: (made.append(given), real(*given))[1]
    )

    def look() -> int:
        made.clear()
        with store.read() as tx:
            tx.sound_blades(tx.records.rotor(worn))
        return len(made)

    add_blade(store, worn, BladeRecord("B9"))
    assert [look(), look(), look()] == [1, 0, 0]
    retire_blade(store, worn, "B9")
    assert [look(), look()] == [1, 0]
    for changed, back in (
        ("UPDATE rotor SET seed = 8", "UPDATE rotor SET seed = 7"),
        ("UPDATE blade SET lot = 'x' WHERE id = 'B9'",
         "UPDATE blade SET lot = NULL WHERE id = 'B9'"),
        ("UPDATE event SET blade = 'B1' WHERE kind = 'retirement'",
         "UPDATE event SET blade = 'B9' WHERE kind = 'retirement'"),
    ):  # fmt: skip
        damage(store, changed)
        for _ in range(2):
            with pytest.raises(DamagedRotorError):
                look()
        damage(store, back)
        assert look() in (0, 1)
        assert look() == 0


def test_what_is_equal_and_has_another_digest_is_not_taken_for_the_same(
    store: SqlStore, worn: str
) -> None:
    with store.read() as tx:
        rotor = replace(tx.records.rotor(worn), network={"a": 1.0})
    blades, known = [BladeRecord("B1", known={"a": 1.0})], Compared()
    assert not known.knows(rotor, (), blades)
    known.put(rotor, (), blades)
    assert known.knows(rotor, (), blades)
    assert not known.knows(replace(rotor, network={"a": 1}), (), blades)
    assert not known.knows(rotor, (), [BladeRecord("B1", known={"a": 1})])
    assert not known.knows(rotor, ("moved",), blades)
    assert not known.knows(rotor, (), blades * 2)


def test_a_rotor_whose_row_is_as_it_was_again_goes_on(
    store: SqlStore, worker: Worker, worn: str, reading: Make, post: Post
) -> None:
    damage(store, "UPDATE rotor SET seed = 8")
    post(worn, reading("later", value=0.2, time_h=20_000.0))
    worker.drain()
    assert view_rotor(store, worn).rotor.blocked
    damage(store, "UPDATE rotor SET seed = 7")
    retry(store, worn)
    worker.drain()
    view = view_rotor(store, worn).rotor
    assert (view.blocked, view.applied_seq) == (False, 4)


def test_a_blade_that_joins_or_leaves_while_a_worker_reads_is_no_damage(
    store: SqlStore, rotor: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each question of PostgreSQL sees what was committed before it; of SQLite, before the first.

    A blade may come before the blades are asked for, or after them.
    """
    asked = records.SqlRecords.blades

    def meanwhile(own: Any, rotor_id: str) -> Any:
        monkeypatch.undo()
        add_blade(store, rotor, BladeRecord("B4"))
        found = asked(own, rotor_id)
        add_blade(store, rotor, BladeRecord("B5"))
        retire_blade(store, rotor, "B4")
        return found

    with store.read() as tx:
        record = tx.records.rotor(rotor)
        monkeypatch.setattr(records.SqlRecords, "blades", meanwhile)
        found = {blade.id for blade in creation.sound_blades(tx.connection, record)}
    lite = store.engine.dialect.name == "sqlite"
    assert found == {"B1", "B2", "B3"} | (set() if lite else {"B4"})


@pytest.mark.parametrize(
    "statement", ["UPDATE rotor SET network = '{'", "UPDATE blade SET known = '{' WHERE id = 'B2'"]
)
def test_a_read_of_a_row_that_is_no_json_is_a_problem_that_says_what_to_do(
    store: SqlStore, worn: str, api: httpx.Client, statement: str
) -> None:
    damage(store, statement)
    answer = api.get(f"/v1/rotors/{worn}")
    assert answer.status_code == 503
    told = answer.json()
    assert told["type"] == "urn:bladetwin:problem:damaged"
    assert "no JSON" in told["faults"][0]["problem"]
    assert "import the rotor" in told["faults"][0]["remedy"]


def test_a_blade_s_hour_of_minus_zero_is_no_damage(store: SqlStore, rotor: str) -> None:
    add_blade(store, rotor, BladeRecord("B4", time_h0=-0.0))
    create_rotor(store, "r2", "rotor-blade", [BladeRecord("B1", time_h0=-0.0)], 64, 7)
    assert findings(store, rotor) == findings(store, "r2") == []


def test_bytes_of_an_array_that_changed_are_named_and_written_again(
    store: SqlStore, worker: Worker, worn: str
) -> None:
    before = content(store, 4)
    row = select(t.state_array.c.data).where(t.state_array.c.name == "column/B1")
    with transaction(store.engine, write=True) as connection:
        data = connection.execute(row.where(t.state_array.c.version == 2)).scalar_one()
        flipped = data[:-1] + bytes([data[-1] ^ 1])
        values = t.state_array.update().where(t.state_array.c.name == "column/B1")
        connection.execute(values.where(t.state_array.c.version == 2).values(data=flipped))
    found = findings(store, worn)
    assert [(one.part, one.name, one.version) for one in found] == [("array", "column/B1", 2)]
    with pytest.raises(DamagedError, match="column/B1"):
        content(store, 4)
    done = rebuild.repair(worker.updater, worn, found)
    assert done.restored == (2, 3, 4), "every version that has this row"
    assert content(store, 4) == before


def test_rows_exchanged_with_their_digests_are_found_by_the_version_s_digest(
    store: SqlStore, worker: Worker, worn: str
) -> None:
    """Each row fits its own sha256; only the version's digest knows which belongs where."""
    before = content(store, 4)
    exchange = "UPDATE state_array SET name = :new WHERE name = :old"
    for old, new in (("column/B1", "x"), ("column/B2", "column/B1"), ("x", "column/B2")):
        damage(store, exchange, old=old, new=new)
    found = findings(store, worn)
    assert {one.part for one in found} == {"state"}
    rebuild.repair(worker.updater, worn, found)
    assert findings(store, worn) == []
    assert content(store, 4) == before


def read_damaged(store: SqlStore, worn: str) -> None:
    damage(store, META)
    view_rotor(store, worn)


def test_a_damaged_state_row_is_refused_when_it_is_read(store: SqlStore, worn: str) -> None:
    with pytest.raises(DamagedError, match=f"version 4 of rotor {worn} is damaged: state"):
        read_damaged(store, worn)


def test_without_the_comparison_a_damaged_state_is_read_as_if_it_were_sound(
    store: SqlStore, worn: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(intact, "check", lambda row, names: None)
    with pytest.raises(pytest.fail.Exception, match="DID NOT RAISE"), pytest.raises(DamagedError):
        read_damaged(store, worn)


def test_a_row_damaged_after_it_was_read_once_is_refused_the_next_time(
    store: SqlStore, worn: str
) -> None:
    assert view_rotor(store, worn).state is not None
    with pytest.raises(DamagedError):
        read_damaged(store, worn)


def test_a_read_of_a_damaged_version_is_a_problem_that_says_what_to_do(
    api: httpx.Client, store: SqlStore, worn: str
) -> None:
    damage(store, META)
    for path in ("", "/posterior", "/blades/B1/posterior", "/blades/B1/prediction"):
        answer = api.get(f"/v1/rotors/{worn}{path}")
        assert answer.status_code == 503, path
        body = answer.json()
        assert body["type"] == "urn:bladetwin:problem:damaged"
        assert body["faults"][0]["field"] == "state"
        assert "bladetwin verify r1 --repair" in body["faults"][0]["remedy"]
    assert api.get(f"/v1/rotors/{worn}/posterior?version=3").status_code == 200
    assert api.get("/v1/rotors").status_code == 200


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE state SET digest = 'x' WHERE version = 4",
        "DELETE FROM state WHERE version = 4",
        "UPDATE state_array SET sha256 = 'x' WHERE name = 'column/B1'",
    ],
)
def test_a_worker_that_loads_a_damaged_state_rebuilds_it_from_the_log(
    store: SqlStore,
    settings: Settings,
    worn: str,
    reading: Make,
    post: Post,
    statement: str,
) -> None:
    damage(store, statement)
    post(worn, reading("later", value=0.2, time_h=20_000.0))
    fresh = SqlStore(store.engine)
    make_worker(fresh, FakeScience(), settings, "another").drain()
    view = view_rotor(fresh, worn)
    assert (view.rotor.version, view.rotor.applied_seq, view.rotor.last_error) == (5, 4, None)
    assert replay(fresh, FakeScience(), worn)["same"] is True
    left = {one.version for one in findings(fresh, worn)}
    assert 5 not in left, "the new version has all arrays of its own"
    with fresh.read() as tx:
        get = tx.states.reader(tx.states.get(worn))
        assert all(get(f"column/{blade}")[0] > 0 for blade in ("B1", "B2", "B3"))


def test_a_damaged_entry_of_the_log_blocks_its_rotor_and_is_named(
    store: SqlStore, settings: Settings, rotor: str, reading: Make, post: Post
) -> None:
    post(rotor, reading("a"), reading("b", value=0.12))
    damage(store, "UPDATE event SET body = replace(body, '0.12', '0.13') WHERE seq = 2")
    make_worker(store, FakeScience(), settings).drain()
    view = view_rotor(store, rotor).rotor
    assert (view.blocked, view.last_error_event, view.version) == (True, "b", 0)


def test_an_entry_of_a_newer_release_blocks_its_rotor_until_the_worker_is_upgraded(
    store: SqlStore,
    worker: Worker,
    worn: str,
    reading: Make,
    post: Post,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with store.write() as tx:
        tx.log.append(worn, [NewEvent("spell/1", "spell", *digest_of_json({}))])
    post(worn, reading("later", value=0.2, time_h=20_000.0))
    worker.drain()
    view = view_rotor(store, worn).rotor
    assert (view.blocked, view.last_error_event) == (True, "spell/1")
    assert (view.version, view.applied_seq) == (4, 3), "nothing is passed over"
    assert "'spell', is none that this release knows" in str(view.last_error)
    assert "upgrade this worker" in str(view.last_error)
    monkeypatch.setattr(entries, "KNOWN", entries.KNOWN | {"spell"})
    retry(store, worn)
    worker.drain()
    assert view_rotor(store, worn).rotor.applied_seq == 5


def test_a_damaged_version_that_was_provisional_is_dropped(
    store: SqlStore, settings: Settings, rotor: str, reading: Make, post: Post
) -> None:
    worker = make_worker(store, FakeScience(provisional=True), settings, "w")
    post(rotor, reading("a"))
    worker.drain()
    with store.read() as tx:
        assert [tx.states.get(rotor, v).sealed for v in (1, 2)] == [False, True]
    damage(store, "UPDATE state SET digest = 'x' WHERE version = 1")
    done = rebuild.repair(worker.updater, rotor, findings(store, rotor))
    assert (done.restored, done.dropped, done.version) == ((), (1,), None)
    assert findings(store, rotor) == []
    with store.read() as tx, pytest.raises(GoneError):
        tx.states.get(rotor, 1)


def test_a_replay_differs_where_a_state_was_changed_together_with_its_digests(
    store: SqlStore, worker: Worker, worn: str
) -> None:
    """Nothing but the log tells: every digest was made to fit."""
    science = FakeScience()
    assert replay(store, science, worn)["same"] is True
    lease = claiming.claim_rotor(store.engine, worn, "forger", 60.0)
    assert lease is not None
    task = anew(store, worker.updater.science, lease)
    state = science.update(task.card, task.spec, [], None, quick=False)
    meta = {**state.meta, "events_digest": findings_digest(store, worn)}
    forged = replace(state, meta=meta)
    worker.updater.commit(lease, task, forged, worker.updater.change(task, forged))
    assert findings(store, worn) == [], "the digests agree with each other"
    told = replay(store, science, worn)
    assert told["same"] is False
    changed = {one["array"] for one in told["differ"]}
    assert changed == {"column/B1", "column/B2", "column/B3", "shared/moments"}
    assert all(one["largest_difference"] > 0 for one in told["differ"])
    done = rebuild.repair(worker.updater, worn, [], renew=True)
    assert done.version == 6
    assert replay(store, science, worn)["same"] is True


def findings_digest(store: SqlStore, rotor: str) -> str:
    state = view_rotor(store, rotor).state
    assert state is not None
    return state.events_digest


def test_a_rotor_is_not_repaired_beside_a_worker_at_work(
    store: SqlStore, settings: Settings, worn: str, reading: Make, post: Post
) -> None:
    updater = make_worker(store, FakeScience(), settings, "at-work").updater
    post(worn, reading("later"))
    lease = claiming.claim(store.engine, "at-work", 60.0)
    assert lease is not None
    damage(store, "UPDATE state SET digest = 'x' WHERE version = 4")
    other = make_worker(store, FakeScience(), settings, "other").updater
    with pytest.raises(HeldError, match="at-work"):
        rebuild.repair(other, worn, findings(store, worn))
    task = updater.read(lease)
    state = updater.compute(task, quick=True)
    assert updater.commit(lease, task, state, updater.change(task, state)) == 5


def lose_the_rotor_while_repairing(
    store: SqlStore, updater: Updater, worn: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between a repair's computing and its writing another worker claims the rotor."""
    damage(store, "UPDATE state SET digest = 'x' WHERE version = 4")
    real = from_log

    def slow(*args: Any) -> Any:
        made = real(*args)
        damage(store, "UPDATE cursor SET fence = fence + 1, owner = 'thief'")
        return made

    monkeypatch.setattr(rebuild, "from_log", slow)
    with pytest.raises(LostLeaseError):
        rebuild.repair(updater, worn, findings(store, worn))
    with store.read() as tx:
        row = tx.connection.execute(text("SELECT owner FROM cursor")).scalar()
        kept = tx.connection.execute(text("SELECT digest FROM state WHERE version = 4")).scalar()
    assert (row, kept) == ("thief", "x"), "nothing was changed around the thief"


def test_a_repair_that_lost_its_rotor_writes_nothing(
    store: SqlStore, worker: Worker, worn: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    lose_the_rotor_while_repairing(store, worker.updater, worn, monkeypatch)


def test_a_repair_without_the_fence_is_noticed(
    store: SqlStore, worker: Worker, worn: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(leases, "keep", lambda connection, lease: None)
    with pytest.raises(pytest.fail.Exception, match="DID NOT RAISE"):
        lose_the_rotor_while_repairing(store, worker.updater, worn, monkeypatch)


def test_a_blade_that_joined_and_a_blocked_rotor_are_rebuilt_as_they_were(
    store: SqlStore, worker: Worker, worn: str
) -> None:
    add_blade(store, worn, BladeRecord("B4"))
    worker.drain()
    damage(store, "UPDATE cursor SET blocked = (1 = 1), attempts = 5, last_error = 'why'")
    done = rebuild.repair(worker.updater, worn, [], renew=True)
    assert done.version == 6
    assert replay(store, FakeScience(), worn)["same"] is True
    view = view_rotor(store, worn).rotor
    assert (view.blocked, view.attempts, view.last_error) == (True, 5, "why")


def test_the_real_calibration_gives_its_sealed_posterior_again_from_the_log(
    store: SqlStore, settings: Settings, reading: Make, post: Post
) -> None:
    from service.handlers.models import register_builtins

    science = formula_science()
    with store.write() as tx:
        tx.connection.execute(t.model.delete())
    register_builtins(store, science)
    create_rotor(store, "r1", "rotor-blade", [BladeRecord("B1"), BladeRecord("B2")], 512, 5)
    worker = make_worker(store, science, settings)
    for i, (blade, value) in enumerate((("B1", 0.11), ("B2", 0.12), ("B1", 0.19))):
        post("r1", reading(f"i{i}", blade=blade, value=value, time_h=8e3 * (i + 1), sigma=0.003))
        worker.drain()
    again = formula_science()
    told = replay(SqlStore(store.engine), again, "r1")
    assert told["same"] is True
    assert len(told["replayed"]["arrays"]) == 6 + 2 * 3
    damage(store, "UPDATE state_array SET sha256 = 'x' WHERE name = 'shared/log_w'")
    fresh = make_worker(SqlStore(store.engine), again, settings, "fresh")
    found = findings(store, "r1")
    assert {one.name for one in found if one.part == "array"} == {"shared/log_w"}
    done = rebuild.repair(fresh.updater, "r1", found)
    assert told["version"] in done.restored
    assert findings(store, "r1") == []
    assert replay(SqlStore(store.engine), again, "r1")["same"] is True


@pytest.fixture
def run(settings: Settings, monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[int, Any]]:
    """A command on the test's database: exit status and its JSON, or its error."""
    chosen = {"BLADETWIN_DATABASE_URL": settings.database_url, "BLADETWIN_SCIENCE": "fake"}
    for name, value in chosen.items():
        monkeypatch.setenv(name, value)

    def call(*words: str) -> tuple[int, Any]:
        result = CliRunner().invoke(commands, [*words, "--json"])
        if result.exit_code == 1:
            return 1, result.exception
        return result.exit_code, json.loads(result.stdout)

    return call


def test_the_exit_status_tells_sound_from_damaged_from_lost(
    store: SqlStore, worn: str, run: Callable[..., tuple[int, Any]]
) -> None:
    assert run("verify") == (0, {"rotors": 1, "findings": [], "repairs": [], "sound": True})
    code, told = run("replay", worn)
    assert (code, told["same"], told["version"]) == (0, True, 4)
    damage(store, "UPDATE state SET digest = 'x' WHERE version = 4")
    code, told = run("verify", worn)
    assert (code, told["sound"], told["findings"][0]["part"]) == (3, False, "state")
    code, told = run("replay", worn)
    assert (code, told["same"]) == (3, False)
    code, told = run("verify", "--repair")
    assert (code, told["sound"], told["repairs"][0]["restored"]) == (0, True, [4])
    damage(store, "UPDATE event SET digest = 'x' WHERE seq = 1")
    code, told = run("verify", worn, "--repair")
    assert (code, told["repairs"]) == (4, []), "nothing is computed from a damaged log"
    code, error = run("replay", worn, "--repair")
    assert (code, "is damaged" in str(error)) == (1, True)
    code, error = run("verify", "nobody")
    assert code == 1
    assert "'nobody' does not exist" in str(error)


def test_a_rotor_s_damaged_model_is_told_with_it(
    store: SqlStore, worn: str, run: Callable[..., tuple[int, Any]]
) -> None:
    damage(store, "UPDATE model SET digest = 'x'")
    code, told = run("verify", worn)
    assert (code, [one["part"] for one in told["findings"]]) == (4, ["model"])


def test_a_damaged_rotor_is_named_and_nothing_is_computed_from_it(
    store: SqlStore, worn: str, run: Callable[..., tuple[int, Any]]
) -> None:
    damage(store, "UPDATE rotor SET seed = 8")
    code, told = run("verify", "--repair")
    assert (code, told["repairs"]) == (4, [])
    (one,) = told["findings"]
    assert (one["part"], one["name"], one["mendable"]) == ("rotor", worn, False)
    damage(store, "UPDATE state SET digest = 'x' WHERE version = 4")
    code, error = run("replay", worn, "--repair")
    assert (code, type(error)) == (1, DamagedRotorError)
    assert "restore the database, or import the rotor" in str(error)
    with store.read() as tx:
        assert tx.records.rotor(worn).version == 4


def test_a_repair_that_mends_nothing_is_not_called_mended(
    store: SqlStore,
    worn: str,
    run: Callable[..., tuple[int, Any]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    damage(store, "UPDATE state SET digest = 'x' WHERE version = 4")
    nothing = rebuild.Repair(worn, (), (), None)
    monkeypatch.setattr(rebuild, "repair", lambda *args, **given: nothing)
    code, told = run("verify", worn, "--repair")
    assert (code, told["sound"]) == (3, False)


def test_a_registered_model_that_is_not_the_release_s_is_named(
    store: SqlStore, worn: str, run: Callable[..., tuple[int, Any]]
) -> None:
    damage(store, "UPDATE model SET card = replace(card, '50000', '60000')")
    code, told = run("verify")
    assert code == 4
    assert [one["part"] for one in told["findings"]] == ["model"]


def test_without_a_sealed_version_a_replay_compares_nothing(
    store: SqlStore, rotor: str, run: Callable[..., tuple[int, Any]]
) -> None:
    code, told = run("replay", rotor)
    assert (code, told["same"], told["stored"], told["version"]) == (0, None, None, None)
