"""A claim is one statement on PostgreSQL; what others commit while it runs is not lost on it.

The others commit between the moment from which the statement sees the database and its lock: the
condition of the claim waits for them (`Meanwhile`).
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import pytest
from psycopg.pq import TransactionStatus
from sqlalchemy import Connection, Engine, and_, event, func, select, text, update

from service.errors import StoreAwayError
from service.fake import FakeScience
from service.handlers.models import register_builtins
from service.handlers.rotors import create_rotor
from service.ports import BladeRecord
from service.store import tables as t
from service.store.engine import now_s, open_engine, transaction
from service.store.unit_of_work import SqlStore
from service.worker import claiming
from service.worker.claiming import claim
from service.worker.lease import Lease, heartbeat
from tests.patience import behind_a_lock, until
from tests.postgres import Databases

c = t.cursor.c
TURN = 4711  # what the condition and the others wait for
NUMBER = text("SELECT pg_snapshot_xmax(pg_current_snapshot())::text")


@pytest.fixture
def engine(databases: Databases) -> Iterator[Engine]:
    """Two rotors wait for their first version, `old` for longer than `new`."""
    name = databases.take()
    store = SqlStore(open_engine(databases.url(name)))
    register_builtins(store, FakeScience())
    for rotor in ("old", "new"):
        create_rotor(store, rotor, "rotor-blade", [BladeRecord("B1")], 64, 7)
    yield store.engine
    store.close()
    databases.give(name)


def cursor(engine: Engine, rotor: str) -> Any:
    with transaction(engine, write=False) as connection:
        return connection.execute(select(t.cursor).where(c.rotor_id == rotor)).one()


def statements(engine: Engine, block: Callable[[], object]) -> list[TransactionStatus]:
    """Of each statement meanwhile whether it left a transaction open."""
    told: list[TransactionStatus] = []

    def note(_c: Any, cursor: Any, *_: Any) -> None:
        told.append(cursor.connection.info.transaction_status)

    event.listen(engine, "after_cursor_execute", note)
    block()
    event.remove(engine, "after_cursor_execute", note)
    return told


def test_a_claim_is_one_statement_that_commits_by_itself(engine: Engine) -> None:
    taken: list[Lease | None] = []
    told = statements(engine, lambda: taken.append(claim(engine, "w", 60.0, role="apply")))
    assert told == [TransactionStatus.IDLE]
    assert taken[0] == Lease("old", "w", 1, 0, 0, 1, sealing=False)
    with engine.connect() as other:
        assert other.execute(select(c.owner).where(c.rotor_id == "old")).scalar() == "w"


def test_who_finds_nothing_to_do_locks_no_row_and_takes_no_number(engine: Engine) -> None:
    for owner in ("a", "b"):
        assert claim(engine, owner, 60.0) is not None
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as other:
        before = other.execute(NUMBER).scalar()
        for _ in range(5):
            assert claim(engine, "idle", 60.0) is None
        assert other.execute(NUMBER).scalar() == before
    with transaction(engine, write=True) as connection:
        connection.execute(update(t.cursor).values(lease_until=None))
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as other:
        assert claim(engine, "busy", 60.0) is not None
        assert other.execute(NUMBER).scalar() != before, "the control"


def test_a_rotor_that_somebody_changes_just_now_is_passed_over(engine: Engine) -> None:
    with transaction(engine, write=True) as other:
        other.execute(update(t.cursor).where(c.rotor_id == "old").values(ess_ratio=0.5))
        lease = claim(engine, "w", 60.0)  # no wait: the row is free only after it
        assert lease is not None
        assert lease.rotor_id == "new"
        assert claim(engine, "w", 60.0) is None
    assert claim(engine, "w", 60.0) is not None


class Meanwhile:
    """A claim, and what others commit after its statement began and before it locks a row."""

    def __init__(self, engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
        self.engine = engine
        real = claiming.unheld
        turn = func.pg_advisory_xact_lock_shared(TURN).is_not(None)
        monkeypatch.setattr(claiming, "unheld", lambda lease_s: and_(turn, real(lease_s)))

    def claim(self, what: Callable[[Connection], object]) -> Lease | None:
        found: list[Lease | None] = []
        claims = threading.Thread(
            target=lambda: found.append(claim(self.engine, "w", 60.0, role="apply"))
        )
        with self.engine.connect().execution_options(isolation_level="AUTOCOMMIT") as other:
            other.execute(text(f"SELECT pg_advisory_lock({TURN})"))
            claims.start()
            until("the claim's turn to wait", lambda: behind_a_lock(self.engine))
            what(other)
            other.execute(text(f"SELECT pg_advisory_unlock({TURN})"))
        claims.join()
        return found[0]


@pytest.fixture
def meanwhile(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> Meanwhile:
    return Meanwhile(engine, monkeypatch)


def changed(**values: Any) -> Callable[[Connection], object]:
    own = update(t.cursor).where(c.rotor_id == "old")
    return lambda connection: connection.execute(own.values(**values))


HELD = {"owner": "other", "fence": 5, "lease_until": now_s() + 60.0}


@pytest.mark.parametrize(
    "values", [HELD, {"blocked": True}, {"dirty": False}, {"not_before": now_s() + 60.0}]
)
def test_one_that_is_no_longer_to_be_claimed_is_passed_over(
    meanwhile: Meanwhile, values: dict[str, Any]
) -> None:
    lease = meanwhile.claim(changed(**values))
    assert lease is not None
    assert lease.rotor_id == "new"
    row = cursor(meanwhile.engine, "old")
    assert (row.owner, row.fence) == (values.get("owner"), values.get("fence", 0))


@pytest.mark.usefixtures("long_there")
def test_what_is_claimed_is_the_rotor_as_it_was_committed_last(meanwhile: Meanwhile) -> None:
    """Claimed by another, who sealed it and whose lease ran out: all of it after the beginning."""
    lease = meanwhile.claim(
        changed(
            fence=8, attempts=2, takeovers=3, sealing=True, owner="dead", lease_until=now_s() - 1.0
        )
    )
    assert lease == Lease("old", "w", 9, 0, 0, 3, sealing=False, after_sealing=True)
    row = cursor(meanwhile.engine, "old")
    assert (row.fence, row.attempts, row.takeovers, row.sealing) == (9, 3, 4, False)
    assert heartbeat(meanwhile.engine, lease, 60.0)


def test_without_the_lock_a_held_rotor_is_claimed_and_it_is_noticed(
    meanwhile: Meanwhile, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(claiming, "locked", lambda first: first)
    lease = meanwhile.claim(changed(**HELD))
    assert lease is not None
    assert lease.rotor_id == "old", "mutant"
    assert lease.fence == 6


def claimed_at_once(engine: Engine, count: int) -> Sequence[Lease]:
    """What as many claims take that begin together."""
    start, won = threading.Barrier(count), list[Lease]()

    def attempt(name: str) -> None:
        start.wait()
        if (lease := claim(engine, name, 60.0)) is not None:
            won.append(lease)

    threads = [threading.Thread(target=attempt, args=(f"w{i}",)) for i in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return won


def test_of_many_who_claim_at_once_each_rotor_has_one(engine: Engine) -> None:
    for fence in range(1, 6):
        won = claimed_at_once(engine, 8)
        assert sorted((one.rotor_id, one.fence) for one in won) == [("new", fence), ("old", fence)]
        with transaction(engine, write=True) as connection:
            connection.execute(update(t.cursor).values(lease_until=None, owner=None))


def read_only(engine: Engine, switch: str) -> None:
    """For the connections that are opened from now on."""
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        name = connection.execute(text("SELECT current_database()")).scalar()
        connection.execute(text("SET default_transaction_read_only = off"))
        connection.execute(text(f"ALTER DATABASE {name} {switch}"))
    engine.dispose()


def test_a_database_that_may_only_be_read_is_away(engine: Engine) -> None:
    """What takes over may be read before it may be written: workers wait for that."""
    read_only(engine, "SET default_transaction_read_only = on")
    with pytest.raises(StoreAwayError, match="ReadOnlySqlTransaction"):
        claim(engine, "w", 60.0)
    with pytest.raises(StoreAwayError), transaction(engine, write=True) as connection:
        connection.execute(update(t.cursor).values(ess_ratio=0.5))
    read_only(engine, "RESET default_transaction_read_only")
    assert claim(engine, "w", 60.0) is not None
