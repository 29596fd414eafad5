"""No two blades of a rotor run at once in one slot."""

from __future__ import annotations

import threading
from contextlib import suppress
from typing import Any

import httpx
import pytest

from service.errors import FaultsError
from service.handlers import blades, rotors
from service.ports import BladeRecord
from service.store.commits import lock_rotor
from service.store.log import SqlLog
from service.store.records import SqlRecords
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker
from tests.patience import PATIENCE_S

ROTOR: dict[str, Any] = {
    "id": "r1",
    "model": "rotor-blade",
    "particles": 64,
    "blades": [{"id": "B1", "slot": "1", "time_h0": 0}, {"id": "B2", "slot": "2"}, {"id": "B3"}],
}


@pytest.fixture
def created(api: httpx.Client) -> httpx.Client:
    assert api.post("/v1/rotors", json=ROTOR).status_code == 201
    return api


def refused(answer: httpx.Response) -> list[dict[str, Any]]:
    assert answer.status_code == 422, answer.text
    faults: list[dict[str, Any]] = answer.json()["faults"]
    return faults


def test_a_creation_with_two_blades_in_one_slot_names_both(api: httpx.Client) -> None:
    more = [{"id": "B4", "slot": "01", "time_h0": 12.5}, {"id": "B5"}, {"id": "B6", "slot": "2"}]
    given = ROTOR | {"blades": ROTOR["blades"] + more}
    first, second = refused(api.post("/v1/rotors", json=given))
    assert (first["field"], first["value"]) == ("blades[3].slot", "01")
    assert first["problem"] == (
        "is where blade B1 (slot 1; time_h0 = 0 h) runs; "
        "blade B4 (slot 01; time_h0 = 12.5 h) cannot run there, too"
    )
    assert "a slot of its own" in first["remedy"]
    assert second["field"] == "blades[5].slot"
    assert "blade B2 (slot 2) runs; blade B6" in second["problem"]
    assert api.get("/v1/rotors/r1").status_code == 404, "nothing was created"
    named = ROTOR | {"blades": [{"id": "B1", "slot": "01A"}, {"id": "B2", "slot": "1A"}]}
    assert api.post("/v1/rotors", json=named).status_code == 201, "only numbers have leading zeros"


def test_a_blade_joins_a_slot_once_the_other_left(created: httpx.Client, worker: Worker) -> None:
    new = {"id": "B4", "slot": "1", "time_h0": 100}
    blades = "/v1/rotors/r1/blades"
    (fault,) = refused(created.post(blades, json=new))
    assert (fault["field"], fault["value"]) == ("slot", "1")
    assert "blade B1 (slot 1; time_h0 = 0 h) runs" in fault["problem"]
    assert "blade B4 (slot 1; time_h0 = 100 h)" in fault["problem"]
    assert "POST /v1/rotors/r1/blades/B1/retirement first" in fault["remedy"]
    assert created.get("/v1/rotors/r1").json()["head_seq"] == 0, "nothing was appended"
    assert created.post(f"{blades}/B1/retirement").status_code == 202
    assert created.post(blades, json=new).status_code == 202
    assert created.post(blades, json=new).status_code == 202, "the same again is no other blade"
    (fault,) = refused(created.post(blades, json={"id": "B5", "slot": "1"}))
    assert "blade B4 (slot 1" in fault["problem"]
    assert created.post(blades, json={"id": "B6"}).status_code == 202, "no slot is told of it"
    worker.drain()
    told = created.get("/v1/rotors/r1").json()["blades"]
    assert [b["id"] for b in told if not b["retired"]] == ["B2", "B3", "B4", "B6"]


def test_a_rotor_that_has_two_in_one_slot_already_is_created_again_as_it_was(
    store: SqlStore, api: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Releases before this one took it."""
    given = ROTOR | {"blades": [{"id": "B1", "slot": "1"}, {"id": "B2", "slot": "1"}]}
    with monkeypatch.context() as before:
        before.setattr(rotors, "faults_together", lambda given: [])
        assert api.post("/v1/rotors", json=given).status_code == 201
    again = api.post("/v1/rotors", json=given)
    assert (again.status_code, again.headers["idempotent-replayed"]) == (201, "true")


class Both:
    """Two blades that join one slot at once; each waits so long for the other after its look at
    the rotor."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, patience_s: float) -> None:
        looked = threading.Barrier(2)
        asked = SqlRecords.blades

        def slowly(own: SqlRecords, rotor_id: str) -> list[BladeRecord]:
            found = asked(own, rotor_id)
            with suppress(threading.BrokenBarrierError):  # the other one waits for a commit
                looked.wait(patience_s)
            return found

        monkeypatch.setattr(SqlRecords, "blades", slowly)
        self.joined: list[str] = []
        self.refused: list[FaultsError] = []

    def join(self, store: SqlStore, rotor: str) -> None:
        def one(name: str) -> None:
            try:
                blades.add_blade(store, rotor, BladeRecord(name, slot="7"))
                self.joined.append(name)
            except FaultsError as error:
                self.refused.append(error)

        threads = [threading.Thread(target=one, args=(name,)) for name in ("X", "Y")]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()


def test_of_two_that_join_one_slot_at_once_one_is_refused(
    store: SqlStore, rotor: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    both = Both(monkeypatch, 0.5)
    both.join(store, rotor)
    assert len(both.joined) == len(both.refused) == 1
    assert f"blade {both.joined[0]} (slot 7)" in str(both.refused[0])


def test_without_the_rotor_s_lock_both_would_join(
    store: SqlStore, rotor: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The control: the look at the slots outside of the lock. (SQLite has one writer at a time.)"""
    if store.engine.dialect.name == "sqlite":
        pytest.skip("SQLite has one writer at a time, whatever is locked")
    append = SqlLog.append

    def locking(own: SqlLog, rotor_id: str, events: Any) -> Any:
        lock_rotor(own._connection, rotor_id)
        return append(own, rotor_id, events)

    def head(own: SqlLog, rotor_id: str) -> int:
        return SqlRecords(own._connection).rotor(rotor_id).head_seq

    monkeypatch.setattr(SqlLog, "lock", head)
    monkeypatch.setattr(SqlLog, "append", locking)
    both = Both(monkeypatch, PATIENCE_S)
    both.join(store, rotor)
    assert sorted(both.joined) == ["X", "Y"]
