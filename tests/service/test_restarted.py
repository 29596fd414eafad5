"""A lease that ran out while the database was restarted is not a death over its rotor."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from sqlalchemy import false, select, update

from core.observation import Inspection
from service.bootstrap import make_worker
from service.fake import FakeScience
from service.handlers.diagnoses import request_diagnosis
from service.settings import Settings
from service.store import tables as t
from service.store.engine import begun_s, is_sqlite, now_s, transaction
from service.store.unit_of_work import SqlStore
from service.worker import clock
from service.worker.claiming import claim
from service.worker.job_lease import claim_job
from service.worker.residuals import claim_residuals

LEASE_S = 0.2
Make = Callable[..., Inspection]
Post = Callable[..., int]


def attempts(store: SqlStore, last_beat: Any) -> int:
    """Counted after a second claim, where the first one's holder last prolonged its lease then."""
    assert claim(store.engine, "first", LEASE_S) is not None
    with transaction(store.engine, write=True) as connection:
        beaten = update(t.cursor).values(lease_until=last_beat + LEASE_S)
        connection.execute(beaten)
    taken = claim(store.engine, "second", LEASE_S)
    assert taken is not None
    with transaction(store.engine, write=False) as connection:
        row = connection.execute(select(t.cursor.c.attempts, t.cursor.c.takeovers)).one()
    assert row.takeovers == 1
    assert row.attempts == taken.attempts
    return int(row.attempts)


def test_the_claim_after_a_restart_is_not_counted(
    store: SqlStore, rotor: str, reading: Make, post: Post
) -> None:
    """SQLite has no server, and its leases are never outlived."""
    post(rotor, reading("a"))
    if is_sqlite(store.engine):
        assert attempts(store, now_s() - 1e6) == 2
    else:
        assert attempts(store, begun_s() - 1.0) == 1


def test_one_of_a_worker_that_fell_silent_while_the_database_was_there_is(
    store: SqlStore, rotor: str, reading: Make, post: Post
) -> None:
    post(rotor, reading("a"))
    assert attempts(store, now_s() - 2 * LEASE_S) == 2


@pytest.mark.parametrize("what", ["diagnosis", "residuals"])
@pytest.mark.parametrize("restarted", [True, False])
def test_other_work_is_counted_alike(
    store: SqlStore, rotor: str, reading: Make, post: Post, settings: Settings, what: str,
    restarted: bool,
) -> None:  # fmt: skip
    post(rotor, reading("a"))
    make_worker(store, FakeScience(), settings).drain()
    if what == "diagnosis":
        request_diagnosis(store, FakeScience(), rotor, (), compare=True, horizon_h=None)
    table = t.job if what == "diagnosis" else t.residual

    def taken(owner: str) -> int:
        found = (
            claim_job(store.engine, owner, LEASE_S, "diagnose")
            if what == "diagnosis"
            else claim_residuals(store.engine, owner, LEASE_S)
        )
        assert found is not None
        return found.attempts

    assert taken("first") == 1
    last = (now_s() - 1e6 if is_sqlite(store.engine) else begun_s() - 1.0) if restarted else None
    with transaction(store.engine, write=True) as connection:
        until = (now_s() - 2 * LEASE_S if last is None else last) + LEASE_S
        connection.execute(update(table).values(lease_until=until))
    assert taken("second") == (1 if restarted and not is_sqlite(store.engine) else 2)


def test_were_it_not_looked_at_a_restart_would_count(
    store: SqlStore, rotor: str, reading: Make, post: Post, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clock, "outlived", lambda until, lease_s: false())
    post(rotor, reading("a"))
    assert attempts(store, begun_s() - 1.0) == 2
