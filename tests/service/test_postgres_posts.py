"""A new reading is one statement on PostgreSQL; what others commit while it waits is not lost.

It waits for the rotor's row, so that its view of the database is from before the other's commit.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from sqlalchemy import (
    Connection,
    Engine,
    delete,
    event,
    false,
    insert,
    literal,
    or_,
    select,
    update,
)

from core.observation import Inspection
from service.errors import ConflictError, FaultsError, NotFoundError
from service.fake import FakeScience
from service.handlers.inspections import Item, post_inspections
from service.handlers.models import register_builtins
from service.handlers.rotors import create_rotor
from service.ports import Appended, BladeRecord, NewEvent
from service.store import log, single
from service.store import tables as t
from service.store.engine import open_engine, transaction
from service.store.log import SqlLog
from service.store.unit_of_work import SqlStore
from service.worker.claiming import claim
from service.worker.lease import advance
from service.worker.wake import open_wake
from tests.patience import PATIENCE_S, behind_a_lock, until
from tests.postgres import Databases


@pytest.fixture
def store(databases: Databases) -> Iterator[SqlStore]:
    """One rotor of one blade, whose prior is to be applied."""
    name = databases.take()
    store = SqlStore(open_engine(databases.url(name)))
    register_builtins(store, FakeScience())
    create_rotor(store, "r", "rotor-blade", [BladeRecord("B1")], 64, 7)
    yield store
    store.close()
    databases.give(name)


@pytest.fixture
def engine(store: SqlStore) -> Engine:
    return store.engine


def reading(name: str, digest: str = "d") -> NewEvent:
    return NewEvent(name, "inspection", "{}", digest, blade="B1", time_h=1.0)


def posted(engine: Engine, *events: NewEvent, rotor: str = "r") -> list[Appended]:
    with transaction(engine, write=True) as connection:
        return SqlLog(connection).append(rotor, events)


def statements(engine: Engine, block: Callable[[], object]) -> list[str]:
    told: list[str] = []

    def note(_c: object, _cursor: object, statement: str, *_: object) -> None:
        told.append(statement)

    event.listen(engine, "before_cursor_execute", note)
    try:
        block()
    finally:
        event.remove(engine, "before_cursor_execute", note)
    return told


def meanwhile(engine: Engine, theirs: Callable[[Connection], None], *own: NewEvent) -> object:
    """What `own` are answered, posted while another transaction that has the rotor does `theirs`,
    which it commits once they wait."""
    told: list[object] = []

    def post() -> None:
        try:
            told.append(posted(engine, *own))
        except ConflictError as error:
            told.append(error)

    with transaction(engine, write=True) as connection:
        theirs(connection)
        thread = threading.Thread(target=post)
        thread.start()
        until("that they wait", lambda: behind_a_lock(engine))
        assert not told
    thread.join(PATIENCE_S)
    (answer,) = told
    return answer


def numbers(engine: Engine) -> tuple[int, list[tuple[int, str]]]:
    """The rotor's head, and its log."""
    with transaction(engine, write=False) as connection:
        head = connection.execute(select(t.rotor.c.head_seq)).scalar_one()
        rows = connection.execute(select(t.entry.c.seq, t.entry.c.event_id).order_by("seq"))
        return head, [(seq, name) for seq, name in rows]


def dirty(engine: Engine) -> bool:
    with transaction(engine, write=False) as connection:
        return bool(connection.execute(select(t.cursor.c.dirty)).scalar_one())


def applied(engine: Engine, connection: Connection) -> None:
    """A worker's commit of all that is there: nothing is left to be done."""
    lease = claim(engine, "w", 30.0, quiet_s=0.0)
    assert lease is not None
    head = connection.execute(select(t.rotor.c.head_seq)).scalar_one()
    advance(connection, lease, head, sealed=True)


def test_a_new_reading_is_two_statements_and_a_known_one_is_looked_up(engine: Engine) -> None:
    assert len(statements(engine, lambda: posted(engine, reading("a")))) == 2
    again = statements(engine, lambda: posted(engine, reading("a")))
    assert len(again) == 3
    assert posted(engine, reading("a")) == [Appended("a", 1, False)]
    with pytest.raises(ConflictError, match="a"):
        posted(engine, reading("a", "other"))
    assert numbers(engine) == (1, [(1, "a")])


def test_a_rotor_that_is_not_there_is_told(engine: Engine) -> None:
    with pytest.raises(NotFoundError, match="nobody"):
        posted(engine, reading("a"), rotor="nobody")


def test_who_waits_for_another_post_gets_the_number_after_it(engine: Engine) -> None:
    def theirs(connection: Connection) -> None:
        SqlLog(connection).append("r", [reading("a"), reading("b")])

    assert meanwhile(engine, theirs, reading("c")) == [Appended("c", 3, True)]
    assert numbers(engine) == (3, [(1, "a"), (2, "b"), (3, "c")])


@pytest.mark.parametrize("digest", ["d", "other"])
def test_what_another_posted_meanwhile_is_known(engine: Engine, digest: str) -> None:
    def theirs(connection: Connection) -> None:
        SqlLog(connection).append("r", [reading("a")])

    answer = meanwhile(engine, theirs, reading("a", digest))
    if digest == "d":
        assert answer == [Appended("a", 1, False)]
    else:
        assert isinstance(answer, ConflictError)
    assert numbers(engine) == (1, [(1, "a")])


def work_is_left(engine: Engine) -> bool:
    """Whether a reading that waited for a worker's commit leaves work."""
    posted(engine, reading("a"))
    assert meanwhile(engine, lambda c: applied(engine, c), reading("b")) == [Appended("b", 2, True)]
    return dirty(engine)


def test_a_reading_that_waited_for_a_workers_commit_leaves_work(engine: Engine) -> None:
    assert work_is_left(engine)


def test_the_cursor_looked_at_in_the_same_statement_would_lose_it(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The statement sees the cursor as it stood before the wait: at work, so with nothing to do."""
    c = t.cursor.c
    flip = update(t.cursor).where(or_(c.dirty == false(), c.applied_seq == 1)).values(dirty=True)
    monkeypatch.setattr(single, "ONE", single.statement(checked=False).add_cte(flip.cte("flip")))
    monkeypatch.setattr(log, "_FLIP", select(1))
    assert not work_is_left(engine)


def test_a_reading_wakes_workers_where_none_was_pending(engine: Engine) -> None:
    with transaction(engine, write=True) as connection:
        applied(engine, connection)
    wake = open_wake(engine, "bladetwin_work", 5.0)
    posted(engine, reading("a"))
    assert wake.wait(PATIENCE_S)
    posted(engine, reading("b"))
    assert not wake.wait(0.5)
    wake.close()


def item(name: str, value: float = 0.1, blade: str = "B1") -> list[Item]:
    values = np.array([value])
    read = Inspection(id=name, blade=blade, quantity="elongation", time_h=1e3, values=values)
    return [Item("", read)]


def test_a_reading_of_a_blade_that_was_met_is_checked_without_a_question(store: SqlStore) -> None:
    def asked(name: str) -> int:
        return len(statements(store.engine, lambda: post_inspections(store, "r", item(name))))

    assert (asked("a"), asked("b"), asked("c")) == (3, 2, 2)
    other = SqlStore(store.engine)
    told = statements(store.engine, lambda: post_inspections(other, "r", item("d")))
    assert len(told) == 4, "what one store has met, of blades and of models, another has not"
    assert post_inspections(store, "r", item("b")) == [Appended("b", 2, False)]
    with pytest.raises(ConflictError):
        post_inspections(store, "r", item("b", 0.2))
    assert [name for _, name in numbers(store.engine)[1]] == ["a", "b", "c", "d"]


def refused(store: SqlStore, items: list[Item]) -> str:
    with pytest.raises(FaultsError) as told:
        post_inspections(store, "r", items)
    return str(told.value)


def test_what_is_wrong_with_a_reading_is_told_alike_whether_its_blade_was_met(
    store: SqlStore,
) -> None:
    wrong = [item("a", np.nan), item("a", blade="B2")]
    before = [refused(store, items) for items in wrong]
    post_inspections(store, "r", item("b"))
    assert [refused(store, items) for items in wrong] == before


def lost(store: SqlStore) -> None:
    """The database is another one than that which the process has met: its rotor has no blade."""
    post_inspections(store, "r", item("a"))
    with transaction(store.engine, write=True) as connection:
        connection.execute(delete(t.blade))


def test_what_the_process_knows_is_held_against_the_database(store: SqlStore) -> None:
    lost(store)
    assert "is no blade of rotor r" in refused(store, item("b"))
    assert numbers(store.engine) == (1, [(1, "a")])


def test_a_rotor_of_another_model_is_asked_for_its_own(store: SqlStore) -> None:
    """The version that it has there cannot be read at all, which nobody would have noticed."""
    post_inspections(store, "r", item("a"))
    row = select(t.model.c.id, literal("later"), literal("d"), t.model.c.source, literal("{}"), 0.0)
    columns = ["id", "version", "digest", "source", "card", "created_at"]
    with transaction(store.engine, write=True) as connection:
        connection.execute(
            insert(t.model).from_select(columns, row.where(t.model.c.id == "rotor-blade"))
        )
        connection.execute(update(t.rotor).values(model_version="later"))
    with pytest.raises(KeyError):
        post_inspections(store, "r", item("b"))


def test_unchecked_it_would_be_taken(store: SqlStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(single, "CHECKED", single.ONE)
    lost(store)
    assert post_inspections(store, "r", item("b")) == [Appended("b", 2, True)]
