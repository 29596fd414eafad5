"""A read begins with one look at its rotor, and finds what it found part by part."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import httpx
import pytest
from sqlalchemy import event, text

from core.errors import BladetwinError
from core.log import effective
from core.observation import Inspection
from service.adopted import adopted_at
from service.concerned import untold
from service.digests import digest_of_blade, digest_of_json
from service.entries import BLADES, entries_of
from service.errors import NotFoundError, NotYetError
from service.fake import FakeScience
from service.handlers.blades import add_blade, retire_blade
from service.handlers.reads import Basis, basis, standing
from service.handlers.rotors import RotorView, create_rotor, view_rotor
from service.ports import BladeRecord, NewEvent, StateRecord, Transaction, Which
from service.store.engine import transaction
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker

Post = Callable[..., int]
Make = Callable[..., Inspection]
Change = Callable[[SqlStore, Worker], None]
Case = tuple[Change, Sequence[str]]
BLADE = "/v1/rotors/r1/blades/B1"
WEAR = {"name": "wear", "whom": "lot", "value": "L1", "clock": "blade", "shape": "linear"}


@contextmanager
def asked(store: SqlStore) -> Iterator[list[str]]:
    """The questions meanwhile."""
    found: list[str] = []

    def note(connection: Any, cursor: Any, statement: str, *rest: Any) -> None:
        if statement.startswith("SELECT"):
            found.append(statement)

    event.listen(store.engine, "before_cursor_execute", note)
    try:
        yield found
    finally:
        event.remove(store.engine, "before_cursor_execute", note)


def adopt(store: SqlStore) -> None:
    """An entry that adopts an effect and leaves the network as it was."""
    told = {"number": 1, "diagnosis": "d", "effects": [WEAR], "before": None, "after": None}
    body, digest = digest_of_json(told)
    with store.write() as tx:
        tx.log.append("r1", [NewEvent("adoption/1", "adoption", body, digest)])


@pytest.fixture
def told(rotor: str, worker: Worker, post: Post, reading: Make) -> str:
    """A rotor with a version."""
    post(rotor, reading("a"))
    worker.drain()
    return rotor


def test_a_read_asks_one_question_and_one_more_where_effects_were_adopted(
    api: httpx.Client, store: SqlStore, told: str, worker: Worker
) -> None:
    def count(path: str) -> int:
        with asked(store) as found:
            api.get(path).raise_for_status()
        return len(found)

    rotor, prediction = f"/v1/rotors/{told}", f"{BLADE}/prediction?quantity=elongation&times="
    count(rotor)
    count(f"{prediction}1000")  # its arrays are read, its rows compared
    assert (count(rotor), count(f"{prediction}1000")) == (1, 1), "kept"
    assert (count(f"{rotor}?wait_for=1"), count(f"{prediction}2000")) == (1, 1)
    assert count(f"{rotor}?version=1") == count(f"{prediction}3000&version=1") == 2
    assert count(f"{rotor}/inspections") == 3
    adopt(store)
    worker.drain()
    count(rotor)
    count(f"{prediction}1000")  # the arrays of the new version
    assert (count(f"{rotor}?wait_for=1"), count(rotor)) == (3, 1), "and what counts no longer"
    assert (count(f"{prediction}4000"), count(f"{prediction}4000")) == (2, 1)


def nothing(store: SqlStore, worker: Worker) -> None:
    pass


def joined(store: SqlStore, worker: Worker) -> None:
    add_blade(store, "r1", BladeRecord("B9", lot="L1"))


def left(store: SqlStore, worker: Worker) -> None:
    joined(store, worker)
    worker.drain()
    retire_blade(store, "r1", "B9")


def adopted(store: SqlStore, worker: Worker) -> None:
    """An effect of a lot, and a blade of it that came later."""
    adopt(store)
    worker.drain()
    with store.write() as tx:
        digest = digest_of_blade(BladeRecord("B9", lot="L1"))
        entry = NewEvent("blade/B9", "blade", "{}", digest, blade="B9")
        tx.log.append("r1", [entry])
    with transaction(store.engine, write=True) as connection:
        row = "('r1', 'B9', 'L1', (SELECT head_seq FROM rotor))"
        connection.execute(text(f"INSERT INTO blade (rotor_id, id, lot, added_seq) VALUES {row}"))


def an_effect(store: SqlStore, worker: Worker) -> None:
    """And a blade that has joined and left."""
    left(store, worker)
    adopt(store)
    worker.drain()


def after(*statements: str) -> Case:
    return an_effect, statements


LAST = "WHERE version = (SELECT version FROM cursor)"
CASES: dict[str, Case] = {
    "a version": (nothing, ()),
    "a blade that joined after it": (joined, ()),
    "one that left after it": (left, ()),
    "an effect": after(),
    "an effect and a blade that joined": (adopted, ()),
    "blocked": after("UPDATE cursor SET blocked = (1 = 1), last_error = 'x'"),
    "blocked and damaged": after(
        "UPDATE cursor SET blocked = (1 = 1), last_error = 'x'", "UPDATE rotor SET seed = seed + 1"
    ),
    "no version": after("UPDATE cursor SET version = 0", "DELETE FROM state"),
    "a version beyond none": after("UPDATE cursor SET version = 0"),
    "a version beyond": after("UPDATE cursor SET version = version - 1"),
    "a version that is missing": after(f"DELETE FROM state {LAST}"),
    "all versions missing": after("DELETE FROM state"),
    "another digest": after(f"UPDATE state SET digest = 'x' {LAST}"),
    "no description": after(f"UPDATE state SET meta = '{{' {LAST}"),
    "another end": after(f"UPDATE state SET through_seq = 1 {LAST}"),
    "a damaged cursor": after("UPDATE cursor SET applied_seq = 1"),
    "a damaged rotor": after("UPDATE rotor SET particles = particles + 1"),
    "no network": after("UPDATE rotor SET network = '{'"),
    "a head beyond": after("UPDATE rotor SET head_seq = head_seq + 1"),
    "a head before": after("UPDATE rotor SET head_seq = 1"),
    "a damaged blade": after("UPDATE blade SET lot = 'x' WHERE id = 'B1'"),
    "another damaged blade": after("UPDATE blade SET lot = 'x' WHERE id = 'B2'"),
    "a damaged blade that joined": after("UPDATE blade SET lot = 'x' WHERE id = 'B9'"),
    "a blade that is missing": after("DELETE FROM blade WHERE id = 'B1'"),
    "a blade that knows no JSON": after("UPDATE blade SET known = '{' WHERE id = 'B1'"),
    "a blade with an inexact hour": after("UPDATE blade SET time_h0 = 1e-300 WHERE id = 'B1'"),
    "a damaged adoption": after(
        "UPDATE event SET body = replace(body, 'wear', 'tear') WHERE kind = 'adoption'"
    ),
    "a kind that was another": after("UPDATE event SET kind = 'back-out' WHERE kind = 'adoption'"),
    "no cursor": after("DELETE FROM cursor"),
}


def apart(tx: Transaction, rotor_id: str) -> tuple[RotorView, Callable[[], None]]:
    """A rotor as it stands, each of its parts asked for by itself."""
    rotor = tx.records.rotor(rotor_id)
    blades = tuple(tx.records.blades(rotor_id))
    state = tx.states.get(rotor_id, rotor.version) if rotor.version else None
    through = 0 if state is None else state.through_seq
    found = adopted_at(tx, rotor, through)

    def counting(last: int) -> set[str]:
        log = entries_of(tx.log.entries(rotor_id, 0, 1000, 1000)) if last else []
        return {one.id for one in effective(entry for entry in log if entry.seq <= last)}

    lost = {s.diagnosis: sorted(counting(s.through) - counting(through)) for s in found.sheets}
    return RotorView(rotor, blades, state, found, lost), lambda: tx.check_rotor(rotor, blades)


def view_apart(store: SqlStore) -> RotorView:
    with store.read() as tx:
        view, check = apart(tx, "r1")
        if not view.rotor.blocked:
            check()
    return view


def basis_apart(
    store: SqlStore, name: str | None
) -> tuple[StateRecord, BladeRecord | None, tuple[str, ...]]:
    with store.read() as tx:
        rotor = tx.records.rotor("r1")
        found = None if name is None else tx.records.blade("r1", name)
        moved = sum(e.kind in BLADES for e in tx.log.entries("r1", 0, 1000, 1000))
        if not store.sound.knows(rotor, moved, name, found):
            tx.check_rotor(rotor, tx.records.blades("r1"))
        if name is not None and found is None:
            raise NotFoundError("blade", name, "GET /v1/rotors/r1 lists the blades")
        state = tx.states.get("r1")
        here = adopted_at(tx, rotor, state.through_seq)
        blades = tx.records.blades("r1") if found is None else [found]
    if found is not None and found.added_seq > state.through_seq:
        raise NotYetError(
            f"blade {name} in version {state.version} of rotor r1",
            f"wait for it with GET /v1/rotors/r1?wait_for={found.added_seq}&timeout=30",
        )
    there = [one for one in blades if one.added_seq <= state.through_seq]
    return state, found, tuple(sorted({e["name"] for e in here.effects if untold(e, there)}))


def outcome(do: Callable[[], object]) -> object:
    """What it gives, or what it refuses with."""
    try:
        found = do()
    except BladetwinError as error:
        return type(error), str(error)
    if isinstance(found, Basis):
        return found.state, found.blade, found.untold
    return found


@pytest.mark.parametrize("known", [False, True], ids=["met", "known"])
@pytest.mark.parametrize("case", CASES)
def test_what_is_found_is_what_was_found_part_by_part(
    store: SqlStore, science: FakeScience, told: str, worker: Worker, case: str, known: bool
) -> None:
    """By a process that meets the rotor, and by one that has compared it before."""
    names: Sequence[str | None] = (None, "B1", "B2", "B9", "nobody")
    one, other = SqlStore(store.engine), SqlStore(store.engine)
    change, damage = CASES[case]
    change(store, worker)
    if known:
        view_rotor(one, told)
        view_apart(other)
    with transaction(store.engine, write=True) as connection:
        for statement in damage:
            assert connection.execute(text(statement)).rowcount > 0
    for name in names:
        found = outcome(lambda: basis(one, science, told, Which(), name))  # noqa: B023
        assert found == outcome(lambda: basis_apart(other, name)), name  # noqa: B023
    assert outcome(lambda: view_rotor(one, told)) == outcome(lambda: view_apart(other))


def test_the_row_and_the_digest_of_the_newest_version_are_told_at_once(
    store: SqlStore, told: str, worker: Worker, post: Post, reading: Make
) -> None:
    post(told, reading("b", time_h=9000.0))
    worker.drain()
    create_rotor(store, "r2", "rotor-blade", [], 64, 7)
    view = view_rotor(store, told)
    assert view.state is not None
    with asked(store) as found:
        assert standing(store, told) == (view.rotor, view.state.digest)
        assert standing(store, "r2") == (view_rotor(store, "r2").rotor, None)
        assert standing(store, "nobody") is None
    assert len(found) == 4


def test_a_log_that_went_on_after_the_look_is_asked(store: SqlStore, told: str) -> None:
    """Its head was counted up to then."""
    with store.read() as tx:
        before = tx.seen(told)
    adopt(store)
    with store.read() as tx:
        rotor, head = before.rotor, before.rotor.head_seq
        assert before.changes == 0
        assert adopted_at(tx, rotor, head, before.changes).sheets == ()
        assert len(adopted_at(tx, rotor, head + 1, before.changes).sheets) == 1
        assert len(adopted_at(tx, rotor, None, before.changes).sheets) == 1
        ahead = replace(rotor, head_seq=head + 1)
        assert adopted_at(tx, ahead, head + 1, 0).sheets == (), "the control"
