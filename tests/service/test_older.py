"""What a rotor's sealed version of an older algorithm becomes, where no reading comes."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import pytest
from sqlalchemy import select, update

from core.calibration.state import ALGORITHM, SUPERSEDED
from core.errors import ModelError
from core.observation import Inspection
from service.bootstrap import make_worker
from service.fake import FakeScience
from service.fake.conjugate import FakeState
from service.handlers.rotors import retry
from service.settings import Settings
from service.store import tables as t
from service.store.engine import is_sqlite, now_s, transaction
from service.store.unit_of_work import SqlStore
from service.worker import lease as leases
from service.worker import older
from service.worker.claiming import Role, claim
from service.worker.loop import Worker

Make = Callable[..., Inspection]
Post = Callable[..., int]
c = t.cursor.c


@dataclass(frozen=True, slots=True)
class Next(FakeScience):
    """The release after: its algorithm is another one."""

    superseded: tuple[str, ...] = ("fake-0", "fake-1")

    def update(self, *given: Any, **options: Any) -> FakeState:
        state = FakeScience.update(self, *given, **options)
        return replace(state, meta=state.meta | {"algorithm_version": "fake-2"})


@dataclass(frozen=True, slots=True)
class Unfit(Next):
    """A release without the rotor's model."""

    def update(self, *given: Any, **options: Any) -> FakeState:
        raise ModelError("model rotor-blade is registered, but is none of this release's")


@pytest.fixture
def aged(store: SqlStore, rotor: str, reading: Make, post: Post, worker: Worker) -> str:
    """A rotor with a reading, sealed by this release."""
    post(rotor, reading("a"))
    worker.drain()
    return rotor


def versions(store: SqlStore) -> list[tuple[int, int, str, bool]]:
    s = t.state.c
    query = select(s.version, s.through_seq, s.algorithm_version, s.sealed).order_by(s.version)
    with transaction(store.engine, write=False) as connection:
        return [tuple(row) for row in connection.execute(query)]


def waiting(store: SqlStore, science: FakeScience) -> int:
    """How many rotors are still to be computed anew, as metrics and operations tell it."""
    with store.read() as tx:
        told = tx.gauges(science.superseded).outdated
        assert tx.operations(5, science.superseded).gauges.outdated == told
    return told


def cursor(store: SqlStore) -> Any:
    with transaction(store.engine, write=False) as connection:
        return connection.execute(select(t.cursor)).one()


@pytest.mark.parametrize(("role", "renewed"), [("all", True), ("seal", True), ("apply", False)])
def test_who_seals_computes_it_anew_and_it_rests_on_the_same_entries(
    store: SqlStore,
    settings: Settings,
    aged: str,
    role: Role,
    renewed: bool,
) -> None:
    (before,) = versions(store)
    assert (waiting(store, FakeScience()), waiting(store, Next())) == (0, 1)
    make_worker(store, Next(), settings, "next release", role).drain()
    assert waiting(store, Next()) == (0 if renewed else 1)
    expected = [(before[0] + 1, before[1], "fake-2", True)] if renewed else []
    assert versions(store) == [before, *expected]
    row = cursor(store)
    assert (row.dirty, row.blocked, row.attempts, row.owner) == (False, False, 0, None)
    with store.read() as tx:
        first, last = (tx.states.get(aged, one[0]) for one in (before, versions(store)[-1]))
    assert first.events_digest == last.events_digest


def test_one_of_the_same_algorithm_or_of_a_newer_one_stays(
    store: SqlStore, science: FakeScience, settings: Settings, aged: str
) -> None:
    make_worker(store, science, settings, "the same release").drain()
    assert len(versions(store)) == 1
    make_worker(store, Next(), settings, "next release").drain()
    make_worker(store, science, settings, "a process of before").drain()
    assert [one[2] for one in versions(store)] == ["fake-1", "fake-2"]


def test_one_that_another_is_about_to_take_is_passed_over(
    store: SqlStore, settings: Settings, aged: str
) -> None:
    """Two sealers would compute the same one; on SQLite there is one writer at a time."""
    if is_sqlite(store.engine):
        return
    found = older.Older(Next(), "second", settings.lease_s, "seal")
    with transaction(store.engine, write=True) as connection:
        connection.execute(select(c.rotor_id).with_for_update())
        assert found.claim(store.engine) is None


def test_a_blocked_rotor_is_left_alone(store: SqlStore, settings: Settings, aged: str) -> None:
    with transaction(store.engine, write=True) as connection:
        connection.execute(update(t.cursor).values(blocked=True))
    make_worker(store, Next(), settings, "next release").drain()
    assert len(versions(store)) == 1


@pytest.mark.parametrize(
    "values", [{"lease_until": now_s() + 3.0}, {"not_before": now_s() + 60.0}, {"dirty": True}]
)
def test_one_that_is_held_pauses_or_waits_for_something_is_left_alone(
    store: SqlStore, settings: Settings, aged: str, values: dict[str, Any]
) -> None:
    found = older.Older(Next(), "next release", settings.lease_s, "seal")
    with transaction(store.engine, write=True) as connection:
        connection.execute(update(t.cursor).values(values))
    assert found.claim(store.engine) is None


def test_an_entry_that_comes_meanwhile_is_applied_over_it(
    store: SqlStore,
    settings: Settings,
    aged: str,
    reading: Make,
    post: Post,
) -> None:
    found = older.Older(Next(), "next release", settings.lease_s, "seal").claim(store.engine)
    assert found is not None
    assert claim(store.engine, "other", settings.lease_s, role="seal") is None
    post(aged, reading("b"))
    taken = claim(store.engine, "other", settings.lease_s, role="apply")
    assert taken is not None
    assert taken.fence > found.fence


def test_what_a_process_of_before_writes_meanwhile_is_found_after_a_while(
    store: SqlStore,
    worker: Worker,
    settings: Settings,
    aged: str,
    reading: Make,
    post: Post,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    new = make_worker(store, Next(), settings, "next release")
    new.drain()
    post(aged, reading("b"))
    worker.drain()
    new.drain()
    assert [one[2] for one in versions(store)] == ["fake-1", "fake-2", "fake-1"]
    later = older.monotonic() + older.LOOK_S
    monkeypatch.setattr(older, "monotonic", lambda: later)
    new.drain()
    assert [one[2] for one in versions(store)] == ["fake-1", "fake-2", "fake-1", "fake-2"]


def test_where_that_cannot_be_it_stays_and_the_rotor_is_not_blocked(
    store: SqlStore, settings: Settings, aged: str, caplog: pytest.LogCaptureFixture
) -> None:
    before = versions(store)
    with caplog.at_level(logging.ERROR, logger="bladetwin.worker"):
        make_worker(store, Unfit(), settings, "next release").drain()
    assert versions(store) == before
    row = cursor(store)
    assert (row.dirty, row.blocked, row.attempts, row.owner) == (False, False, 0, None)
    (told,) = [one.getMessage() for one in caplog.records]
    assert "r1: version 1 is of an older algorithm" in told
    assert "none of this release's" in told


def died(store: SqlStore, settings: Settings, times: int) -> None:
    """So many workers took the rotor to compute it anew, and died."""
    for number in range(times):
        lease = older.Older(Next(), f"dies {number}", settings.lease_s, "seal").claim(store.engine)
        assert lease is not None
        leases.release(store.engine, lease.owner)


def test_one_over_which_workers_die_is_given_up_says_so_and_is_not_blocked(
    store: SqlStore, settings: Settings, aged: str, reading: Make, post: Post
) -> None:
    """It would kill every sealer in turn, and be blocked in the end, or its next reading would."""
    (before,) = versions(store)
    died(store, settings, older.DEATHS)
    make_worker(store, Next(), settings, "next release").drain()
    row = cursor(store)
    assert (row.dirty, row.blocked, row.attempts, row.owner) == (False, False, 0, None)
    assert "version 1 is of an older algorithm and stays: 2 workers died" in row.last_error
    make_worker(store, Next(), settings, "another").drain()
    assert versions(store) == [before]
    post(aged, reading("b"))
    make_worker(store, Next(), settings, "another").drain()
    assert versions(store)[-1][:3] == (2, 2, "fake-2")
    assert cursor(store).last_error is None


def test_a_reading_is_not_blocked_for_what_died_before_it(
    store: SqlStore, settings: Settings, aged: str, reading: Make, post: Post
) -> None:
    died(store, settings, older.DEATHS)
    post(aged, reading("b"))
    make_worker(store, Next(), settings, "next release").drain()
    assert versions(store)[-1][:3] == (2, 2, "fake-2")


def test_retry_has_one_that_was_given_up_tried_again(
    store: SqlStore, settings: Settings, aged: str
) -> None:
    died(store, settings, older.DEATHS)
    make_worker(store, Next(), settings, "next release").drain()
    assert retry(store, aged).last_error is None
    make_worker(store, Next(), settings, "another").drain()
    assert versions(store)[-1][2] == "fake-2"


def test_jobs_go_first(store: SqlStore, settings: Settings, aged: str) -> None:
    """Hours of versions of an older algorithm do not keep a model from being registered."""
    worker, done = make_worker(store, Next(), settings, "next release"), []
    worker.jobs.run_once = lambda: not done and not done.append(len(versions(store)))  # type: ignore[method-assign, func-returns-value]
    worker.drain()
    assert done == [1]
    assert len(versions(store)) == 2


def test_the_calibration_names_every_algorithm_before_its_own() -> None:
    family, number = ALGORITHM.rsplit("-", 1)
    assert SUPERSEDED[0] == f"{family}-1"
    assert SUPERSEDED[-1] == f"{family}-{int(number) - 1}"
    assert ALGORITHM not in SUPERSEDED
