"""What a read and an update ask of the database does not grow with their rotor's log.

The planner is asked on a log as it is in service. SQLite's virtual machine is counted besides: so
many instructions, the same on every machine. Left out is the list of blades, which counts the
readings of each. (The question for adoptions, asked of every read and
update, went through the whole log at first: 0.8 ms each at 600 readings.)
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from typing import Any

import httpx
import numpy as np
import pytest
from sqlalchemy import Select, bindparam, event, insert, select, text

from core.observation import Inspection
from service.adopted import KINDS
from service.handlers.inspections import Item, post_inspections
from service.handlers.rotors import create_rotor
from service.ports import BladeRecord
from service.store import log, seen, whole
from service.store import tables as t
from service.store.engine import is_sqlite, transaction
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker

FEW, MANY = 60, 1500
STEP = 1
ONE = {"quantity": "elongation", "times": "8000,24000"}
e = t.entry.c


def _filled(store: SqlStore, rotor: str, count: int) -> None:
    """A log as it is in service, known to the planner."""
    rows = [
        {
            "rotor_id": rotor,
            "seq": seq,
            "event_id": f"i{seq}",
            "kind": "inspection",
            "blade": f"B{seq % 50}",
            "time_h": 1.0,
            "body": 300 * " ",
            "digest": 32 * "0",
            "received_at": float(seq),
        }
        for seq in range(1, count + 1)
    ]
    with transaction(store.engine, write=True) as connection:
        connection.execute(insert(t.entry), rows)
        connection.execute(text("ANALYZE event"))


def _plan(store: SqlStore, query: Any, asked: dict[str, object]) -> str:
    """How the database says that it would go."""
    with store.engine.connect() as connection:
        explain = "EXPLAIN QUERY PLAN" if connection.dialect.name == "sqlite" else "EXPLAIN"
        compiled = query.compile(connection)
        given: Any = compiled.construct_params(asked)
        if compiled.positional:
            given = tuple(given[name] for name in compiled.positiontup)
        rows = connection.exec_driver_sql(f"{explain} {compiled}", given)
        return "\n".join(str(tuple(row)) for row in rows)


def _of_a_blade() -> Select[Any]:
    return (
        select(e.seq)
        .where(e.rotor_id == bindparam("rotor"), e.kind == "inspection", e.seq < 2900)
        .where(e.blade == "B7")
        .order_by(e.seq.desc())
        .limit(5)
    )


def _in_one_question() -> Select[Any]:
    """The entries that change the model, as they were asked for at first."""
    return (
        select(*log.COLUMNS)
        .where(e.rotor_id == bindparam("rotor"), e.kind.in_(KINDS), e.seq > bindparam("after"))
        .order_by(e.seq)
        .limit(bindparam("most"))
    )


def test_the_readings_of_one_blade_are_found_by_an_index(store: SqlStore, rotor: str) -> None:
    """Without it the database would walk the whole rotor."""
    _filled(store, rotor, 3000)
    plan = _plan(store, _of_a_blade(), {"rotor": rotor})
    assert "ix_event_rotor_id_blade_kind_seq" in plan
    assert "TEMP B-TREE" not in plan
    assert "Sort" not in plan, "in order as they come"


def test_changes_of_the_model_are_found_by_an_index(store: SqlStore, rotor: str) -> None:
    _filled(store, rotor, 3000)
    plan = _plan(store, log.CHANGES, {"rotor": rotor, "after": 0, "most": 200})
    assert plan.count("ix_event_rotor_id_kind_seq") == len(KINDS)
    assert "pk_event" not in plan
    assert "autoindex" not in plan


@pytest.mark.parametrize("kind", ["blade", "whole"])
def test_what_a_read_begins_with_is_found_by_indices(
    store: SqlStore, rotor: str, kind: str
) -> None:
    """It counts what moves blades and what changes the model, in two places of the log."""
    _filled(store, rotor, 3000)
    split = store.engine.dialect.name == "sqlite"
    query = seen._BLADE if kind == "blade" else seen._WHOLE[split]
    plan = _plan(store, query, {"rotor": rotor, "blade": "B1"})
    assert plan.count("ix_event_rotor_id_kind_seq") >= 2
    assert plan.count("pk_event") + plan.count("sqlite_autoindex_event_1") == (kind == "whole")


def test_what_an_update_rests_on_is_found_by_indexes(store: SqlStore, rotor: str) -> None:
    _filled(store, rotor, 3000)
    query = whole._WHOLE[is_sqlite(store.engine)]
    plan = _plan(store, query, {"rotor": rotor, "seq": 7, "version": 1})
    assert plan.count("ix_event_rotor_id_kind_seq") >= 2, "what moved a blade, what changes"
    assert "Seq Scan on event" not in plan
    assert "SCAN event" not in plan


class Counted:
    """Instructions of SQLite's virtual machine, in steps of `STEP`."""

    def __init__(self, store: SqlStore) -> None:
        self.steps = 0
        event.listen(store.engine, "checkout", self._watch)

    def _watch(self, connection: sqlite3.Connection, record: Any, proxy: Any) -> None:
        def step() -> int:
            self.steps += 1
            return 0

        connection.set_progress_handler(step, STEP)

    def of(self, work: Callable[[], object]) -> int:
        self.steps = 0
        work()
        return self.steps


def _steps(store: SqlStore, worker: Worker, api: httpx.Client) -> dict[str, list[int]]:
    """Steps of each kind of work on a rotor with few readings and on one with many."""
    counted = Counted(store)
    found: dict[str, list[int]] = {}
    for name, count in (("few", FEW), ("many", MANY)):
        create_rotor(store, name, "rotor-blade", [BladeRecord("B1"), BladeRecord("B2")], 64, 7)

        def post(first: int, end: int, name: str = name) -> None:
            items = [
                Item("", Inspection(f"i{k}", "B1", "elongation", 100.0 + k, np.array([0.1])))
                for k in range(first, end)
            ]
            post_inspections(store, name, items)

        def read(path: str, name: str = name, **asked: str) -> None:
            assert api.get(f"/v1/rotors/{name}{path}", params=asked).status_code == 200

        for first in range(0, count, 500):
            post(first, min(first + 500, count))
        worker.drain()
        work: dict[str, Callable[[], object]] = {
            "post": lambda: post(count, count + 1),  # noqa: B023
            "update": worker.drain,
            "rotor": lambda: read(""),
            "prediction": lambda: read("/blades/B1/prediction", **ONE),
            "page": lambda: read("/inspections", limit="5"),
            "posterior": lambda: read("/posterior"),
            "versions": lambda: read("/versions"),
            "life": lambda: read("/blades/B1/life", limit="0.2"),
            "lives": lambda: read("/life", limit="0.2"),
            "adoptions": lambda: read("/adoptions"),
            "kept": lambda: read("/blades/B1/prediction", **ONE),
            "newest": lambda: read("/inspections", limit="5", newest="true"),
            "one": lambda: read(f"/inspections/i{count - 1}"),  # noqa: B023
        }
        for kind, one in work.items():
            found.setdefault(kind, []).append(counted.of(one))
    return found


def _is_lite(store: SqlStore) -> None:
    if store.engine.dialect.name != "sqlite":
        pytest.skip("only SQLite counts its instructions")


def test_no_question_of_a_read_or_an_update_grows_with_the_log(
    store: SqlStore, worker: Worker, api: httpx.Client
) -> None:
    _is_lite(store)
    for kind, (few, many) in _steps(store, worker, api).items():
        assert few >= 3, kind
        assert many <= 1.15 * few, f"{kind}: {STEP * few} instructions, then {STEP * many}"


def test_a_question_that_goes_through_the_log_is_noticed(
    store: SqlStore, worker: Worker, api: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The control. (An update asks only where it found by their number that there are some.)"""
    _is_lite(store)
    monkeypatch.setattr(log, "CHANGES", _in_one_question())
    grown = {kind for kind, (few, many) in _steps(store, worker, api).items() if many > 2 * few}
    assert "adoptions" in grown
    assert not {"update", "rotor", "prediction"} & grown, "which do not ask where there are none"
