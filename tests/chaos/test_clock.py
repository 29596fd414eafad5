"""The database's clock may be set forward or back: no rotor stands still, none is taken twice."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from sqlalchemy import true, update

from core.observation import Inspection
from service.bootstrap import make_worker
from service.errors import LostLeaseError
from service.handlers.webhooks import create_webhook
from service.settings import Settings
from service.store import tables as t
from service.store.engine import now_s, transaction
from service.store.hook_tables import delivery
from service.store.outbox import post as note
from service.store.unit_of_work import SqlStore
from service.studies.chaos.check import check
from service.studies.chaos.clock import Clock
from service.studies.chaos.twin import Descent
from service.worker import claiming
from service.worker import clock as database_clock
from service.worker import lease as leases
from service.worker.hook_lease import claim_webhook
from service.worker.job_lease import claim_job
from service.worker.loop import Worker
from service.worker.residuals import claim_residuals

Make = Callable[..., Inspection]
Post = Callable[..., int]
LEASE_S, HOUR = 30.0, 3600.0


@pytest.fixture
def twin(store: SqlStore, settings: Settings) -> Worker:
    return make_worker(store, Descent(provisional=True), settings, "twin")


def test_a_dead_workers_rotor_is_taken_over_though_the_clock_was_set_back(
    store: SqlStore, rotor: str, reading: Make, post: Post
) -> None:
    clock, engine = Clock(store.engine), store.engine
    post(rotor, reading("a"))
    assert claiming.claim(engine, "dead", LEASE_S) is not None
    assert claiming.claim(engine, "other", LEASE_S) is None
    clock.ahead = -HOUR
    lease = claiming.claim(engine, "other", LEASE_S)
    assert lease is not None
    assert lease.fence == 2
    assert claiming.claim(engine, "third", LEASE_S) is None, "the new lease holds"
    assert clock.asked > 0


def test_a_dead_workers_job_is_taken_over_though_the_clock_was_set_back(store: SqlStore) -> None:
    clock = Clock(store.engine)
    with store.write() as tx:
        tx.records.put_job("j1", "diagnose", {})
    assert claim_job(store.engine, "dead", LEASE_S, "diagnose") is not None
    assert claim_job(store.engine, "other", LEASE_S, "diagnose") is None
    clock.ahead = -HOUR
    assert claim_job(store.engine, "other", LEASE_S, "diagnose") is not None


def test_a_dead_workers_webhook_is_taken_over_though_the_clock_was_set_back(
    store: SqlStore, rotor: str, tmp_path: Path
) -> None:
    clock, engine = Clock(store.engine), store.engine
    key = tmp_path / "key"
    key.write_text("7d" * 32)
    url = "http://127.0.0.1:9/"
    create_webhook(store, str(key), "127.0.0.0/8", "ops", url=url, events=None, rotors=None)
    with transaction(engine, write=True) as connection:
        note(connection, rotor, "blocked", {"error": "e", "event": None})
    assert claim_webhook(engine, "dead", LEASE_S) is not None
    assert claim_webhook(engine, "other", LEASE_S) is None
    clock.ahead = -HOUR
    assert claim_webhook(engine, "other", LEASE_S) is not None


@pytest.mark.parametrize(("ahead_s", "sent"), [(100.0, False), (12 * HOUR, True)])
def test_a_pause_from_a_clock_that_was_ahead_does_not_keep_a_message(
    store: SqlStore, rotor: str, tmp_path: Path, ahead_s: float, sent: bool
) -> None:
    """No pause that is given now is so long; a shorter one holds."""
    key = tmp_path / "key"
    key.write_text("7d" * 32)
    url = "http://127.0.0.1:9/"
    create_webhook(store, str(key), "127.0.0.0/8", "ops", url=url, events=None, rotors=None)
    with transaction(store.engine, write=True) as connection:
        note(connection, rotor, "blocked", {"error": "e", "event": None})
        connection.execute(update(delivery).values(not_before=now_s() + ahead_s))
    assert (claim_webhook(store.engine, "any", LEASE_S) is not None) is sent


@pytest.mark.parametrize(("ahead_s", "taken"), [(100.0, False), (12 * HOUR, True)])
def test_a_pause_from_a_clock_that_was_ahead_does_not_keep_a_job_or_residuals(
    store: SqlStore, twin: Worker, rotor: str, reading: Make, post: Post, ahead_s: float,
    taken: bool,
) -> None:  # fmt: skip
    with store.write() as tx:
        tx.records.put_job("j1", "diagnose", {})
        tx.connection.execute(update(t.job).values(not_before=now_s() + ahead_s))
    assert (claim_job(store.engine, "any", LEASE_S, "diagnose", 60.0) is not None) is taken
    post(rotor, reading("a"))
    twin.drain()
    claim = claim_residuals(store.engine, "first", LEASE_S)
    assert claim is not None
    with transaction(store.engine, write=True) as connection:
        values = {"not_before": now_s() + ahead_s, "lease_until": None, "owner": None}
        connection.execute(update(t.residual).values(**values))
    assert (claim_residuals(store.engine, "any", LEASE_S, 60.0) is not None) is taken


def test_a_dead_workers_residuals_are_taken_over_though_the_clock_was_set_back(
    store: SqlStore, twin: Worker, rotor: str, reading: Make, post: Post
) -> None:
    clock, engine = Clock(store.engine), store.engine
    post(rotor, reading("a"))
    twin.drain()
    assert claim_residuals(engine, "dead", LEASE_S) is not None
    assert claim_residuals(engine, "other", LEASE_S) is None
    clock.ahead = -HOUR
    assert claim_residuals(engine, "other", LEASE_S) is not None


def test_without_the_bound_a_rotor_waits_until_the_clock_has_caught_up(
    store: SqlStore, rotor: str, reading: Make, post: Post, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(database_clock, "AHEAD", 1e9)
    clock, engine = Clock(store.engine), store.engine
    post(rotor, reading("a"))
    assert claiming.claim(engine, "dead", LEASE_S) is not None
    clock.ahead = -HOUR
    assert claiming.claim(engine, "other", LEASE_S) is None, "mutant"
    clock.ahead = HOUR
    assert claiming.claim(engine, "other", LEASE_S) is not None


def test_a_rotor_is_sealed_though_the_clock_was_set_back(
    store: SqlStore, settings: Settings, rotor: str, reading: Make, post: Post
) -> None:
    slow = settings.model_copy(update={"seal_after_s": 60.0, "seal_within_s": 600.0})
    worker = make_worker(store, Descent(provisional=True), slow, "twin")
    clock = Clock(store.engine)
    post(rotor, reading("a"))
    worker.drain()
    with store.read() as tx:
        assert not tx.states.get(rotor).sealed, "it is not quiet yet"
    clock.ahead = -HOUR
    worker.drain()
    with store.read() as tx:
        assert tx.states.get(rotor).sealed


@pytest.mark.parametrize("ahead", [-HOUR, -5.0, 5.0, HOUR])
def test_a_clock_that_jumps_during_an_update_applies_nothing_twice(
    store: SqlStore, twin: Worker, rotor: str, reading: Make, post: Post, ahead: float
) -> None:
    clock = Clock(store.engine)
    told = {(rotor, "a"): post(rotor, reading("a"))}
    first = make_worker(store, Descent(provisional=True), twin.settings, "first").updater
    lease = claiming.claim(store.engine, "first", LEASE_S)
    assert lease is not None
    task = first.read(lease)
    state = first.compute(task, quick=True)
    clock.ahead = ahead
    taken = twin.updater.run_once()
    assert taken == (abs(ahead) == HOUR)
    change = first.change(task, state)
    if taken:
        with pytest.raises(LostLeaseError):
            first.commit(lease, task, state, change)
    else:
        first.commit(lease, task, state, change)
    twin.drain()
    assert check(store, told).faults == {}


def test_without_the_fence_a_jump_is_seen_in_the_tables(
    store: SqlStore,
    twin: Worker,
    rotor: str,
    reading: Make,
    post: Post,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(leases, "holds", lambda lease: true())
    monkeypatch.setattr(leases, "moves_on", lambda lease: true())
    clock = Clock(store.engine)
    told = {(rotor, "a"): post(rotor, reading("a"))}
    first = make_worker(store, Descent(provisional=True), twin.settings, "first").updater
    lease = claiming.claim(store.engine, "first", LEASE_S)
    assert lease is not None
    task = first.read(lease)
    state = first.compute(task, quick=True)
    clock.ahead = HOUR
    assert twin.updater.run_once()
    first.commit(lease, task, state, first.change(task, state))
    assert check(store, told).faults
