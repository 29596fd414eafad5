"""The studies' checker sees what each broken rule does to the tables."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import pytest
from sqlalchemy import text
from sqlalchemy.exc import DBAPIError

from core.observation import Inspection
from service.bootstrap import make_worker
from service.errors import LostLeaseError
from service.settings import Settings
from service.store.engine import transaction
from service.store.unit_of_work import SqlStore
from service.studies.chaos.check import Findings, check
from service.studies.chaos.twin import Descent
from service.worker import claiming, new_version
from service.worker import lease as leases
from service.worker.update import Updater
from tests.chaos import mutants

Make = Callable[..., Inspection]
Post = Callable[..., int]


class Crash(Exception):
    """The worker dies here."""


class Pair:
    """Two workers on one rotor, and what was acknowledged."""

    def __init__(self, store: SqlStore, settings: Settings, reading: Make, post: Post) -> None:
        self.store, self._reading, self._post = store, reading, post
        self.first, self.second = (
            make_worker(store, Descent(provisional=True), settings, name).updater
            for name in ("first", "second")
        )
        self.acknowledged: dict[tuple[str, str], int] = {}

    def post(self, name: str, **given: Any) -> None:
        self.acknowledged["r1", name] = self._post("r1", self._reading(name, **given))

    def expire(self) -> None:
        with transaction(self.store.engine, write=True) as connection:
            connection.execute(text("UPDATE cursor SET lease_until = 1.0"))

    def check(self) -> Findings:
        return check(self.store, self.acknowledged)


@pytest.fixture
def pair(store: SqlStore, settings: Settings, reading: Make, post: Post, rotor: str) -> Pair:
    return Pair(store, settings, reading, post)


def entry_during_update(pair: Pair) -> None:
    """An entry comes between the reading of the log and the commit."""
    pair.post("a")
    lease = claimed(pair, "first")
    task = pair.first.read(lease)
    pair.post("b", blade="B2")
    finish(pair.first, lease, task)


def turns(pair: Pair) -> None:
    """Two workers take turns, so that what the first one remembers is no longer the newest."""
    for name, updater in (("a", pair.first), ("b", pair.second), ("c", pair.first)):
        pair.post(name, time_h=4000.0)
        assert updater.run_once()


def stalled(pair: Pair) -> None:
    """The first worker stalls until the second one has applied the same entries and more."""
    pair.post("a")
    lease = claimed(pair, "first")
    task = pair.first.read(lease)
    pair.expire()
    pair.post("b", blade="B2")
    assert pair.second.run_once()
    with suppress(LostLeaseError):
        finish(pair.first, lease, task)


def dies_in_commit(pair: Pair) -> None:
    """The first worker dies between the state and the end of its commit; the second goes on."""
    pair.post("a")
    written = new_version.write_state

    def write(*given: Any) -> None:
        written(*given)
        raise Crash

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(new_version, "write_state", write)
        with pytest.raises(Crash):
            pair.first.run_once()
    pair.expire()
    with suppress(DBAPIError):
        pair.second.run_once()


def claimed(pair: Pair, owner: str) -> leases.Lease:
    lease = claiming.claim(pair.store.engine, owner, 60.0)
    assert lease is not None
    return lease


def finish(updater: Updater, lease: leases.Lease, task: Any) -> None:
    state = updater.compute(task, quick=True)
    updater.commit(lease, task, state, updater.change(task, state))


CASES = [
    ("cursor_to_the_head", entry_during_update),
    ("memory_not_compared", turns),
    ("no_fence", stalled),
    ("cursor_outside", dies_in_commit),
]


@pytest.mark.parametrize("scenario", [scenario for _, scenario in CASES])
def test_with_all_rules_the_tables_are_as_they_should_be(
    pair: Pair, scenario: Callable[[Pair], None]
) -> None:
    scenario(pair)
    while pair.second.run_once():
        pass
    found = pair.check()
    assert found.faults == {}
    assert found.counts["entries"] == len(pair.acknowledged)


@pytest.mark.parametrize(("mutant", "scenario"), CASES)
def test_a_broken_rule_is_seen_in_the_tables(
    pair: Pair, mutant: str, scenario: Callable[[Pair], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    mutants.BREAK[mutant](monkeypatch.setattr)
    scenario(pair)
    assert pair.check().faults.get("wrong_versions"), mutant


def test_an_acknowledged_reading_that_is_gone_is_lost(pair: Pair) -> None:
    pair.post("a")
    while pair.second.run_once():
        pass
    assert pair.check().faults == {}
    pair.acknowledged["r1", "never stored"] = 2
    pair.acknowledged["r1", "a"] = 7
    assert set(pair.check().faults) == {"lost", "misnumbered"}
    pair.acknowledged.clear()
    assert set(pair.check().faults) == {"strangers"}
