"""How often a worker looks for what, where others commit without a pause."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import pytest

from core.observation import Inspection
from service.bootstrap import make_worker
from service.fake import FakeScience
from service.handlers.rotors import view_rotor
from service.settings import Settings
from service.store.unit_of_work import SqlStore
from service.worker import loop
from service.worker.claiming import Role
from service.worker.loop import JOBS_S, REST_S, Worker
from tests.patience import AGES_S, PATIENCE_S, until

Make = Callable[..., Inspection]
Post = Callable[..., int]


class Restless:
    """Somebody commits something that is no work, each millisecond."""

    def wait(self, timeout_s: float) -> bool:
        time.sleep(min(0.001, timeout_s))
        return timeout_s > 0.001

    def skip(self) -> None: ...

    def close(self) -> None: ...


@dataclass
class Looks:
    """How often a worker looked for rotors, and for jobs, and for how long it ran."""

    worker: Worker
    rotors: int = 0
    jobs: int = 0
    begun: float = 0.0
    ran_s: float = 0.0
    ended_s: float = 0.0

    def watch(self, part: Any, name: str) -> None:
        real = part.run_once

        def look() -> bool:
            setattr(self, name, getattr(self, name) + 1)
            return bool(real())

        part.run_once = look

    @contextmanager
    def running(self) -> Iterator[None]:
        thread = threading.Thread(target=self.worker.run)
        self.begun = time.monotonic()
        thread.start()
        try:
            yield
        finally:
            told = time.monotonic()
            self.worker.stop()
            thread.join()
        self.ended_s = time.monotonic() - told
        self.ran_s = time.monotonic() - self.begun

    def restless(self) -> bool:
        """Whether it has looked for rotors more often than one could that rests in between."""
        return self.rotors > (time.monotonic() - self.begun) / REST_S + 2


@pytest.fixture
def looks(
    store: SqlStore, science: FakeScience, settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> Callable[[Role], Looks]:
    def of(role: Role) -> Looks:
        monkeypatch.setattr(loop, "open_wake", lambda *given: Restless())
        worker = make_worker(store, science, settings, f"a-{role}", role)
        made = Looks(worker)
        made.watch(worker.updater, "rotors")
        made.watch(worker.jobs, "jobs")
        return made

    return of


def test_a_sealer_rests_between_two_looks(looks: Callable[[Role], Looks]) -> None:
    sealer = looks("seal")
    with sealer.running():
        time.sleep(6 * REST_S)
        until("a second look", lambda: sealer.rotors >= 2)
    assert sealer.rotors <= sealer.ran_s / REST_S + 2


def test_a_sealer_s_rest_ends_when_it_is_told_to_end(
    looks: Callable[[Role], Looks], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loop, "REST_S", AGES_S)
    sealer = looks("seal")
    with sealer.running():
        until("its first look", lambda: sealer.jobs)
    assert sealer.ended_s < PATIENCE_S


@pytest.mark.parametrize("role", ["apply", "all"])
def test_who_applies_does_not_rest(looks: Callable[[Role], Looks], role: Role) -> None:
    """And one that applies alone leaves the jobs aside for a moment; another looks at them, too."""
    worker = looks(role)
    with worker.running():
        time.sleep(6 * REST_S)
        until("looks without a rest", worker.restless)
    if role == "apply":
        assert 1 <= worker.jobs <= worker.ran_s / JOBS_S + 2
    else:
        assert worker.jobs == worker.rotors


def test_a_job_waits_for_a_moment_only_and_an_entry_not_at_all(
    looks: Callable[[Role], Looks],
    store: SqlStore,
    rotor: str,
    reading: Make,
    post: Post,
) -> None:
    worker = looks("apply")
    with worker.running():
        time.sleep(2 * REST_S)
        with store.write() as tx:
            tx.records.put_job("j1", "register-model", {"builtin": "rotor-blade"})
        post(rotor, reading("a"))

        def done() -> bool:
            with store.read() as tx:
                job = tx.records.job("j1")
            return job.status == "done" and view_rotor(store, rotor).has_applied(1)

        until("both", done)
    assert worker.jobs <= worker.ran_s / JOBS_S + 3, "the one that it did"
