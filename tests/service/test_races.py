"""Exactly once, under races and crashes; and mutants of the rules, each of which must be caught.

The check is the history of a rotor: versions without gap, each computed from the one before,
the cursor where the newest version ends, and one note in the outbox for each.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import pytest
from sqlalchemy import false, select, text, true, update
from sqlalchemy.exc import DBAPIError

from core.observation import Inspection
from service.bootstrap import make_worker
from service.errors import LostLeaseError
from service.fake import FakeScience, FakeState
from service.ports import ModelCard, RotorSpec
from service.settings import Settings
from service.store import log as store_log
from service.store import tables as t
from service.store.engine import transaction
from service.store.log import SqlLog
from service.store.outbox import post as post_note
from service.store.unit_of_work import SqlStore
from service.worker import claiming, new_version
from service.worker import lease as leases
from service.worker import update as updates
from tests.patience import PATIENCE_S

Make = Callable[..., Inspection]
Post = Callable[..., int]


class Lineage(FakeScience):
    """Notes in each state which one it was computed from."""

    def update(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        readings: Sequence[Inspection],
        previous: Any,
        *,
        quick: bool,
    ) -> FakeState:
        state = super().update(card, rotor, readings, previous, quick=quick)
        before = previous.digest if previous is not None else None
        return replace(state, meta={**state.meta, "parent": before})


def check_history(store: SqlStore, rotor: str) -> None:
    """AssertionError where an entry was lost, or applied twice or from an outdated state."""
    with store.read() as tx:
        record = tx.records.rotor(rotor)
        query = select(t.state).where(t.state.c.rotor_id == rotor).order_by(t.state.c.version)
        states = tx.connection.execute(query).all()
        notes = select(t.outbox.c.payload).where(
            t.outbox.c.rotor_id == rotor, t.outbox.c.kind == "applied"
        )
        told = sorted(json.loads(p)["version"] for p in tx.connection.execute(notes).scalars())
        seqs = [e.seq for e in tx.log.page(rotor, "inspection", 0, 10_000)]
    assert seqs == list(range(1, record.head_seq + 1)), "sequence numbers have a gap"
    assert [s.version for s in states] == list(range(1, record.version + 1)), "versions"
    assert told == [s.version for s in states], "outbox"
    through = [s.through_seq for s in states]
    assert through == sorted(through), "a version goes back"
    assert (through or [0])[-1] == record.applied_seq, "cursor"
    parents = [json.loads(s.meta)["parent"] for s in states]
    assert parents == ([None] + [s.digest for s in states])[: len(states)], "lineage"


@dataclass
class Race:
    """Two workers on one rotor; the first stalls between its read and its commit."""

    store: SqlStore
    settings: Settings
    provisional: bool = False

    def updater(self, owner: str) -> updates.Updater:
        science = Lineage(provisional=self.provisional)
        return make_worker(self.store, science, self.settings, owner).updater

    def expire(self) -> None:
        with transaction(self.store.engine, write=True) as connection:
            connection.execute(text("UPDATE cursor SET lease_until = 1.0"))

    def second_commits_while_first_computes(self) -> None:
        first, second = self.updater("first"), self.updater("second")
        lease = claiming.claim(self.store.engine, "first", 60.0)
        assert lease is not None
        task = first.read(lease)
        state = first.compute(task, quick=not lease.sealing)
        self.expire()
        assert second.run_once()
        with suppress(LostLeaseError):
            first.commit(lease, task, state, first.change(task, state))


@pytest.fixture
def race(store: SqlStore, settings: Settings) -> Race:
    return Race(store, settings)


def seal_race(race: Race, rotor: str, reading: Make, post: Post) -> None:
    """Both workers want to seal the same provisional state: the cursor does not move."""
    race.provisional = True
    post(rotor, reading("a"))
    assert race.updater("before").run_once()
    race.second_commits_while_first_computes()
    check_history(race.store, rotor)


def entry_race(race: Race, rotor: str, reading: Make, post: Post) -> None:
    """Both workers want to apply the same entries."""
    post(rotor, reading("a"), reading("b", blade="B2"))
    race.second_commits_while_first_computes()
    check_history(race.store, rotor)


@pytest.mark.parametrize("scenario", [seal_race, entry_race])
def test_a_worker_believed_dead_changes_nothing(
    race: Race,
    rotor: str,
    reading: Make,
    post: Post,
    scenario: Callable[..., None],
) -> None:
    scenario(race, rotor, reading, post)
    with race.store.read() as tx:
        assert tx.records.rotor(rotor).version == (2 if scenario is seal_race else 1)


def test_without_the_fence_the_race_is_lost_and_noticed(
    race: Race, rotor: str, reading: Make, post: Post, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(leases, "holds", lambda lease: true())
    with pytest.raises(AssertionError, match="lineage"):
        seal_race(race, rotor, reading, post)


def test_without_fence_and_cursor_entries_are_applied_twice_and_it_is_noticed(
    race: Race, rotor: str, reading: Make, post: Post, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(leases, "holds", lambda lease: true())
    monkeypatch.setattr(leases, "moves_on", lambda lease: true())
    with pytest.raises(AssertionError, match="lineage"):
        entry_race(race, rotor, reading, post)


class Crash(Exception):
    """The worker dies here."""


def crash_and_recover(race: Race, rotor: str) -> None:
    """A worker dies in its commit; another one takes over; the history must be whole."""
    with pytest.raises(Crash):
        race.updater("first").run_once()
    check_history(race.store, rotor)
    race.expire()
    with suppress(DBAPIError):
        race.updater("second").run_once()
    check_history(race.store, rotor)
    with race.store.read() as tx:
        assert tx.records.rotor(rotor).applied_seq == 1


@pytest.mark.parametrize("point", ["write_state", "advance"])
def test_a_crash_anywhere_in_the_commit_leaves_nothing_half_done(
    race: Race,
    rotor: str,
    reading: Make,
    post: Post,
    point: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    post(rotor, reading("a"))
    module: Any = new_version if point == "write_state" else leases
    real = getattr(module, point)
    calls: list[int] = []

    def crashing(*args: Any, **kw: Any) -> Any:
        answer = real(*args, **kw)
        calls.append(1)
        if len(calls) == 1:
            raise Crash
        return answer

    monkeypatch.setattr(module, point, crashing)
    crash_and_recover(race, rotor)
    assert len(calls) == 2


def test_a_cursor_outside_the_transaction_is_noticed_after_a_crash(
    race: Race, rotor: str, reading: Make, post: Post, monkeypatch: pytest.MonkeyPatch
) -> None:
    post(rotor, reading("a"))
    real_write, real_advance = new_version.write_state, leases.advance
    crashed: list[int] = []

    def write_by_itself(connection: Any, record: Any, changed: Mapping[str, Any]) -> None:
        """Write the state in a transaction of its own, then die before the cursor moves."""
        connection.rollback()
        with transaction(race.store.engine, write=True) as own:
            real_write(own, record, changed)
        if not crashed:
            crashed.append(1)
            raise Crash

    monkeypatch.setattr(new_version, "write_state", write_by_itself)
    monkeypatch.setattr(leases, "advance", real_advance)
    with pytest.raises(AssertionError, match="versions"):
        crash_and_recover(race, rotor)


def two_claims_of_one(race: Race) -> None:
    """A worker believed dead must not prolong what another one holds."""
    engine = race.store.engine
    first = claiming.claim(engine, "first", 60.0)
    assert first is not None
    race.expire()
    second = claiming.claim(engine, "second", 60.0)
    assert second is not None
    race.expire()
    assert not leases.heartbeat(engine, first, 3600.0), "the dead one beats"
    assert claiming.claim(engine, "third", 60.0) is not None, "nobody can claim"


def released_claim(race: Race) -> None:
    """A worker whose lease was given back must not take it again by its heartbeat."""
    engine = race.store.engine
    first = claiming.claim(engine, "first", 60.0)
    assert first is not None
    assert leases.release(engine, "first") == 1
    assert not leases.heartbeat(engine, first, 3600.0), "the released one beats"
    assert claiming.claim(engine, "second", 60.0) is not None, "nobody can claim"


@pytest.mark.parametrize("scenario", [two_claims_of_one, released_claim])
@pytest.mark.usefixtures("rotor")
def test_only_the_holder_prolongs_a_lease(race: Race, scenario: Callable[[Race], None]) -> None:
    scenario(race)


@pytest.mark.usefixtures("rotor")
def test_a_heartbeat_without_owner_is_noticed(race: Race, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(leases, "owned", lambda lease: true())
    with pytest.raises(AssertionError, match="the released one beats"):
        released_claim(race)


@pytest.mark.usefixtures("rotor")
def test_a_heartbeat_without_fence_and_owner_is_noticed(
    race: Race, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(leases, "owned", lambda lease: true())
    monkeypatch.setattr(leases, "holds", lambda lease: true())
    with pytest.raises(AssertionError, match="the dead one beats"):
        two_claims_of_one(race)


@pytest.mark.usefixtures("rotor")
def test_a_rotor_is_claimed_by_one_of_many(race: Race) -> None:
    start = threading.Barrier(8)
    won: list[leases.Lease] = []

    def attempt(name: str) -> None:
        start.wait()
        lease = claiming.claim(race.store.engine, name, 60.0)
        if lease is not None:
            won.append(lease)

    threads = [threading.Thread(target=attempt, args=(f"w{i}",)) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [lease.fence for lease in won] == [1]


def two_writers(
    store: SqlStore,
    rotor: str,
    reading: Make,
    post: Post,
    monkeypatch: pytest.MonkeyPatch,
    patience_s: float = 0.5,
) -> None:
    """Two writers meet between the reading of head_seq and the insert, if anything lets them.

    Each waits so long for the other; where nothing keeps them apart they have all the time.
    Of two readings each: one alone is a single statement on PostgreSQL (`test_postgres_posts`).
    """
    meet = threading.Barrier(2)
    real = SqlLog._known
    errors: list[BaseException] = []

    def known(self: SqlLog, rotor_id: str, ids: list[str]) -> Any:
        with suppress(threading.BrokenBarrierError):
            meet.wait(patience_s)
        return real(self, rotor_id, ids)

    monkeypatch.setattr(SqlLog, "_known", known)

    def write(name: str) -> None:
        try:
            post(rotor, reading(name), reading(f"{name}, too"))
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=write, args=(name,)) for name in ("a", "b")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not errors, f"a writer failed: {type(errors[0]).__name__}"
    with store.read() as tx:
        assert [e.seq for e in tx.log.page(rotor, "inspection", 0, 10)] == [1, 2, 3, 4]


def test_two_writers_get_their_own_numbers(
    store: SqlStore, rotor: str, reading: Make, post: Post, monkeypatch: pytest.MonkeyPatch
) -> None:
    two_writers(store, rotor, reading, post, monkeypatch)


def test_two_writers_that_do_not_lock_head_seq_are_noticed(
    store: SqlStore, rotor: str, reading: Make, post: Post, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unlocked(connection: Any, rotor_id: str) -> Any:
        query = select(t.rotor.c.head_seq).where(t.rotor.c.id == rotor_id)
        return connection.execute(query).scalar()

    monkeypatch.setattr(store_log, "lock_rotor", unlocked)
    # SQLite's lock is that of BEGIN IMMEDIATE.
    monkeypatch.setattr(SqlStore, "write", SqlStore.read)
    with pytest.raises(AssertionError, match="a writer failed"):
        two_writers(store, rotor, reading, post, monkeypatch, PATIENCE_S)


def test_an_entry_that_comes_during_an_update_is_not_lost(
    race: Race, rotor: str, reading: Make, post: Post
) -> None:
    updater = race.updater("w")
    post(rotor, reading("a"))
    lease = claiming.claim(race.store.engine, "w", 60.0)
    assert lease is not None
    task = updater.read(lease)
    post(rotor, reading("b"))
    state = updater.compute(task, quick=True)
    updater.commit(lease, task, state, updater.change(task, state))
    assert updater.run_once()
    check_history(race.store, rotor)
    with race.store.read() as tx:
        assert tx.records.rotor(rotor).applied_seq == 2


def sealing(
    race: Race, rotor: str, reading: Make, post: Post
) -> tuple[updates.Updater, leases.Lease]:
    """A worker that has claimed a provisional state to seal it."""
    race.provisional = True
    post(rotor, reading("a"))
    assert race.updater("before").run_once()
    lease = claiming.claim(race.store.engine, "sealer", 60.0, role="seal", overdue_s=0.0)
    assert lease is not None
    assert lease.sealing
    return race.updater("sealer"), lease


def test_an_entry_is_not_kept_waiting_by_a_sealing(
    race: Race, rotor: str, reading: Make, post: Post
) -> None:
    sealer, lease = sealing(race, rotor, reading, post)
    assert claiming.claim(race.store.engine, "second", 60.0) is None, "nothing is pending"
    task = sealer.read(lease)
    state = sealer.compute(task, quick=False)
    post(rotor, reading("b", blade="B2"))
    assert claiming.claim(race.store.engine, "other", 60.0, role="seal") is None
    applier = race.updater("applier")
    applier.role = "apply"
    assert applier.run_once()
    with pytest.raises(LostLeaseError):
        sealer.commit(lease, task, state, sealer.change(task, state))
    check_history(race.store, rotor)
    assert not applier.run_once(), "sealing is not its work"
    assert sealer.run_once()
    check_history(race.store, rotor)
    with race.store.read() as tx:
        assert tx.states.get(rotor).sealed
        assert tx.records.rotor(rotor).applied_seq == 2


def test_a_busy_rotor_is_not_sealed_before_it_is_quiet(
    race: Race, rotor: str, reading: Make, post: Post
) -> None:
    race.provisional = True
    post(rotor, reading("a"))
    assert race.updater("before").run_once()
    engine = race.store.engine
    assert claiming.claim(engine, "sealer", 60.0, role="seal", quiet_s=3600.0) is None
    assert claiming.claim(engine, "sealer", 60.0, role="seal", quiet_s=0.0) is not None


def endless_stream(race: Race, rotor: str, reading: Make, post: Post) -> list[bool]:
    """Which versions are sealed, where an entry is always pending and patience is over at once."""
    race.provisional = True
    settings = race.settings.model_copy(update={"seal_within_s": 0.0, "seal_after_s": 3600.0})
    race.settings = settings
    applier, sealer = race.updater("applier"), race.updater("sealer")
    applier.role, sealer.role = "apply", "seal"
    post(rotor, reading("first"))
    for n in range(4):
        assert applier.run_once()
        post(rotor, reading(f"next{n}", blade="B2"))
        sealer.run_once()
    check_history(race.store, rotor)
    with race.store.read() as tx:
        return [
            tx.states.get(rotor, v).sealed for v in range(1, tx.records.rotor(rotor).version + 1)
        ]


def test_a_stream_without_a_pause_is_sealed_all_the_same(
    race: Race, rotor: str, reading: Make, post: Post
) -> None:
    assert endless_stream(race, rotor, reading, post) == [False, True] * 4


def test_without_the_limit_a_stream_is_never_sealed(
    race: Race, rotor: str, reading: Make, post: Post, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(claiming, "overdue", lambda overdue_s: false())
    assert endless_stream(race, rotor, reading, post) == [False] * 4, "mutant"


def test_entries_wait_for_a_sealing_that_is_overdue(
    race: Race, rotor: str, reading: Make, post: Post
) -> None:
    sealer, lease = sealing(race, rotor, reading, post)
    engine = race.store.engine
    task = sealer.read(lease)
    post(rotor, reading("b", blade="B2"))
    assert claiming.claim(engine, "applier", 60.0, role="apply", overdue_s=0.0) is None
    state = sealer.compute(task, quick=False)
    sealer.commit(lease, task, state, sealer.change(task, state))
    assert race.updater("applier").run_once()
    check_history(race.store, rotor)
    with race.store.read() as tx:
        assert [tx.states.get(rotor, v).sealed for v in (1, 2, 3)] == [False, True, False]
        assert tx.records.rotor(rotor).applied_seq == 2


def test_entries_do_not_wait_for_a_sealer_where_none_lives(
    race: Race, rotor: str, reading: Make, post: Post
) -> None:
    race.provisional = True
    race.settings = race.settings.model_copy(update={"seal_within_s": 0.0})
    applier = race.updater("applier")
    applier.role = "apply"
    for number, name in enumerate("abc", 1):
        post(rotor, reading(name))
        assert applier.run_once()
        with race.store.read() as tx:
            assert tx.records.rotor(rotor).applied_seq == number
            assert not tx.states.get(rotor).sealed


def test_a_blocking_waits_for_its_turn_at_the_rotor(
    race: Race, rotor: str, reading: Make, post: Post
) -> None:
    """It comes while somebody has the rotor's row and goes on to its cursor: as an update does,
    and as a post does, so that neither waits for the other and notes are numbered in order."""
    post(rotor, reading("a"))
    engine = race.store.engine
    lease = claiming.claim(engine, "failing", 60.0)
    assert lease is not None
    errors: list[BaseException] = []

    def block() -> None:
        try:
            leases.fail(engine, lease, "no use", None, 0.0, block=True)
        except BaseException as error:
            errors.append(error)

    blocking = threading.Thread(target=block)
    with transaction(engine, write=True) as connection:
        store_log.lock_rotor(connection, rotor)
        blocking.start()
        blocking.join(0.5)
        assert blocking.is_alive()
        post_note(connection, rotor, "diagnosed", {})
        connection.execute(update(t.cursor).values(dirty=True, dirty_since=1.0))
    blocking.join()
    assert errors == []
    with race.store.read() as tx:
        assert tx.records.rotor(rotor).blocked
        assert [note.kind for note in tx.outbox.after(rotor, 0, 10)] == ["diagnosed", "blocked"]
