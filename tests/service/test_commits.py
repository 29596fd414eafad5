"""A commit's statements: how many there are, and what others commit or ask for meanwhile."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from typing import Any

import pytest
from sqlalchemy import event, select, update

from core.observation import Inspection
from service.bootstrap import make_worker
from service.fake import FakeScience
from service.settings import Settings
from service.store import tables as t
from service.store.commits import lock_rotor
from service.store.engine import is_sqlite, transaction
from service.store.unit_of_work import SqlStore
from service.studies.chaos import traps
from service.worker import claiming
from service.worker import lease as leases
from service.worker.loop import Worker
from service.worker.wake import open_wake
from tests.patience import PATIENCE_S

Make = Callable[..., Inspection]
Post = Callable[..., int]


def test_an_update_asks_no_more_than_it_has_to(
    store: SqlStore, science: FakeScience, settings: Settings, rotor: str, reading: Make, post: Post
) -> None:
    """PostgreSQL takes a third of a millisecond of the worker for each statement."""
    worker = make_worker(store, science, settings, "w", "apply")
    post(rotor, reading("i1"))
    worker.drain()
    post(rotor, reading("i2"))
    told: list[str] = []

    def note(_c: Any, _cursor: Any, statement: str, *_: Any) -> None:
        told.append(statement)

    event.listen(store.engine, "before_cursor_execute", note)
    assert worker.updater.run_once()
    event.remove(store.engine, "before_cursor_execute", note)
    asked = [statement for statement in told if not statement.startswith("BEGIN")]
    claim, read, commit = (3 if is_sqlite(store.engine) else 1), 2, 4
    assert len(asked) == claim + read + commit, asked


@pytest.mark.parametrize("moved", [False, True])
def test_a_commit_waits_for_who_holds_the_rotor_and_knows_where_its_log_ends_then(
    store: SqlStore, rotor: str, reading: Make, post: Post, moved: bool
) -> None:
    post(rotor, reading("a"))
    engine = store.engine
    lease = claiming.claim(engine, "w", 60.0)
    assert lease is not None
    errors: list[BaseException] = []

    def commit() -> None:
        try:
            with transaction(engine, write=True) as connection:
                assert leases.advance(connection, lease, 1, sealed=True) == 1
        except BaseException as error:
            errors.append(error)

    committing = threading.Thread(target=commit)
    with transaction(engine, write=True) as other:
        lock_rotor(other, rotor)
        committing.start()
        committing.join(0.5)
        assert committing.is_alive()
        if moved:
            other.execute(update(t.rotor).values(head_seq=2))
            other.execute(update(t.cursor).values(dirty=True, dirty_since=1.0))
    committing.join()
    assert errors == []
    with transaction(engine, write=False) as connection:
        row = connection.execute(select(t.cursor)).one()
    assert (row.applied_seq, row.version, row.dirty) == (1, 1, moved)
    assert row.owner is None
    assert row.dirty_since is None if not moved else row.dirty_since > 1.0


@pytest.mark.parametrize(
    ("through", "sealed", "woken"), [(1, True, False), (1, False, True), (0, True, True)]
)
def test_workers_are_woken_where_something_is_left_to_be_done(
    store: SqlStore,
    rotor: str,
    reading: Make,
    post: Post,
    through: int,
    sealed: bool,
    woken: bool,
) -> None:
    """Readers are told of each version. (SQLite's watch the file.)"""
    if is_sqlite(store.engine):
        pytest.skip("PostgreSQL's")
    post(rotor, reading("a"))
    lease = claiming.claim(store.engine, "w", 60.0)
    assert lease is not None
    wakes = [open_wake(store.engine, f"bladetwin_{name}", 5.0) for name in ("applied", "work")]
    with transaction(store.engine, write=True) as connection:
        leases.advance(connection, lease, through, sealed=sealed)
        assert not wakes[0].wait(0.1), "not before it is committed"
    assert wakes[0].wait(PATIENCE_S)
    assert wakes[1].wait(PATIENCE_S if woken else 0.5) == woken
    for wake in wakes:
        wake.close()


def test_the_study_of_faults_finds_its_points(
    store: SqlStore, rotor: str, reading: Make, post: Post, worker: Worker
) -> None:
    """Each is a statement, or a part of one, that a post or an update says on this database."""
    said: list[str] = []

    def note(_c: object, _cursor: object, statement: str, *_: object) -> None:
        said.append(statement)

    event.listen(store.engine, "after_cursor_execute", note)
    post(rotor, reading("a"))
    worker.drain()
    event.remove(store.engine, "after_cursor_execute", note)
    points = {name: point.statement for name, point in (traps.WORKER | traps.API).items()}
    patterns = {name: one for name, one in points.items() if one is not None}
    assert len(patterns) >= 10
    for name, pattern in patterns.items():
        assert any(re.search(pattern, one, re.DOTALL) for one in said), name
