"""The life of one worker process: wake, apply, run jobs, sleep.

A worker that `serve` started holds the read end of a pipe whose write end only its parent has;
when the parent dies, even by kill -9, the read returns and the worker ends at once. That is safe
at any point, for nothing is written outside a transaction.
"""

from __future__ import annotations

import logging
import math
import os
import signal
import threading
from collections.abc import Callable
from time import monotonic
from types import FrameType
from typing import Protocol

from core.errors import ModelError
from service.errors import StoreAwayError
from service.ports import ModelCard, Science
from service.settings import Settings
from service.store.unit_of_work import SqlStore
from service.worker.asking import Asking
from service.worker.claiming import Role
from service.worker.heartbeat import rest
from service.worker.jobs import Jobs
from service.worker.outdated import Outdated
from service.worker.overdue import ends_process
from service.worker.residuals import Residuals
from service.worker.update import Updater
from service.worker.wake import open_wake

log = logging.getLogger("bladetwin.worker")
IDLE_S = 0.5
# Every post wakes every worker. What a sealer does waits for a pause in the readings anyway
# (BLADETWIN_SEAL_AFTER_S, 0.3 s), so it looks again no sooner than after a rest; one that applies
# looks for jobs, which take seconds, no more often than this.
REST_S = 0.1
JOBS_S = 0.25
SCHEMA_S = 5.0  # how often a worker looks whether its release may still run on the database


def owner_name() -> str:
    """A name that no other worker has, now or later."""
    return f"{os.uname().nodename}-{os.getpid()}-{os.urandom(4).hex()}"


class Worker:
    """Applies what is pending until it is stopped.

    remedy   what is to be done before this release may run on the database; None: it may. While it
             may not, for a newer release migrated the database meanwhile, `run` claims nothing: it
             would take what it does not know for damage
    """

    def __init__(
        self,
        store: SqlStore,
        science: Science,
        settings: Settings,
        owner: str,
        role: Role = "all",
        remedy: Callable[[], str | None] = lambda: None,
    ) -> None:
        self.store = store
        self._outdated, self._runs = Outdated(remedy), False
        self.science = science
        self._stop = threading.Event()
        self.updater = Updater(store, science, settings, owner, role, self._stop.is_set)
        self.role = role
        self.settings = settings
        self.jobs = Jobs(store, science, settings, owner, role, self._stop.is_set)
        self.residuals = Residuals(store, science, settings, owner, self._stop.is_set)
        self.asking = Asking(store)

    def stop(self, signum: int | None = None, frame: FrameType | None = None) -> None:
        """Finish the step of a diagnosis, then end; fits `signal.signal`.

        A signal, whose handler this is in the main thread, ends the update at hand: a sealing may
        take longer than whoever stops the worker waits. Called otherwise it lets it finish.
        """
        self._stop.set()
        if signum is not None:
            self.updater.interrupt()

    def warm(self) -> None:
        """Load the models and compile what they need, so that the first update is as fast.

        A worker that only diagnoses loads them when it has something to do. Rotors of a model that
        is none of this release's (of users' runs, or registered by another release) wait for
        others; those of all others do not.

        ModelError: this release's own cannot be loaded, and nothing can be updated.
        """
        if self.role == "diagnose":
            return
        with self.store.read() as tx:
            cards = tx.records.models("", 100)
        for card in cards:
            try:
                self.science.warm(card)
            except ModelError as error:
                if self._comes_with_it(card):
                    raise
                log.error("model %s cannot be used: %s", card.id, error)

    def _comes_with_it(self, card: ModelCard) -> bool:
        """The model is this release's own. ModelError: that one is damaged."""
        known = "artefact" not in card.summary and card.id in self.science.builtins
        return known and self.science.builtin(card.id).version == card.version

    def drain(self, *, jobs: bool = True) -> None:
        """Apply everything that can be applied now."""
        while not (self._stop.is_set() or self.outdated()) and self.run_once(jobs=jobs):
            pass

    def outdated(self) -> bool:
        """The database is one that this release may not run on (any more)."""
        return self._runs and self._outdated.now(SCHEMA_S)

    def run_once(self, *, jobs: bool = True) -> bool:
        """One piece of work, of any kind that the role has; False: there was none.

        jobs   whether they are looked for, too
        """
        if self.updater.run_once() or (jobs and self.jobs.run_once()):
            return True
        if self.role == "diagnose":
            return self.asking.run_once() or self.residuals.run_once()
        return self.updater.renew()

    def run(self) -> None:
        """Work until stopped; a database that is away is waited for."""
        wake = open_wake(self.store.engine, "bladetwin_work", self.settings.poll_ms)
        cold, looked = True, -math.inf
        self._runs = True
        try:
            while not self._stop.is_set():
                jobs = self.role != "apply" or monotonic() >= looked + JOBS_S
                try:
                    if cold and not self.outdated():
                        self.warm()
                        cold = False
                    self.drain(jobs=jobs)
                except StoreAwayError as error:
                    log.error("%s The worker looks again in 1 s: %s", error, error.reason)
                    self._stop.wait(1.0)
                    continue
                if self.role == "seal":
                    self._stop.wait(REST_S)
                if jobs:
                    looked = monotonic()
                wake.wait(IDLE_S if jobs else max(0.0, looked + JOBS_S - monotonic()))
        finally:
            wake.close()
            rest()


def end_with_parent(stream: int = 0) -> None:
    """End this process as soon as the pipe on `stream` closes, i.e. when the parent is gone."""

    def watch() -> None:
        while os.read(stream, 1):
            pass
        os._exit(0)

    threading.Thread(target=watch, name="parent", daemon=True).start()


class Stoppable(Protocol):
    """What runs until it is stopped: a `Worker`, a `Deliverer`."""

    def stop(self, signum: int | None = None, frame: FrameType | None = None) -> None: ...
    def run(self) -> None: ...


def run_worker(worker: Stoppable) -> None:
    """Run in the main thread of a process of its own; SIGTERM and SIGINT stop it.

    An update, or a step of other work, that takes too long ends the process.
    """
    if isinstance(worker, Worker):
        for part in (worker.updater, worker.jobs, worker.residuals):
            part.bound = ends_process
    signal.signal(signal.SIGTERM, worker.stop)
    signal.signal(signal.SIGINT, worker.stop)
    worker.run()
