"""One rotor's pending entries become one new version of its posterior.

Read the entries since the cursor, compute outside any transaction while a heartbeat prolongs the
lease, commit state and cursor together. A state that the science calls provisional is committed
as such and the rotor stays dirty: the next pass finds nothing pending and seals it. A worker that
is told to end gives what it computes back unused (`service.worker.interrupt`). One whose update or
sealing takes longer than BLADETWIN_UPDATE_MAX_S prolongs its lease no more, and where it has its
process to itself this ends (`service.worker.overdue`).

An array of the state before that turns out damaged is dealt with as a damaged state is
(`service.worker.task`): the version is computed from the log, and every array is written anew.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from time import perf_counter

from sqlalchemy import Engine

from core.errors import CalibrationError
from service.errors import DamagedError, LostLeaseError, StoreAwayError
from service.kernels import CompiledError
from service.ports import RotorState, Science
from service.settings import Settings
from service.store.outbox import trim
from service.store.unit_of_work import SqlStore
from service.store.versions import thin
from service.tracing import span
from service.worker import claiming, culprit, new_version
from service.worker import lease as leases
from service.worker import task as tasks
from service.worker.heartbeat import Deadline, heartbeats
from service.worker.interrupt import Interrupt, Interrupted
from service.worker.lease import Lease
from service.worker.memory import Memories
from service.worker.new_version import Change
from service.worker.older import Older
from service.worker.overdue import Bound, endless
from service.worker.task import Task
from service.worker.traced import Told, told

log = logging.getLogger("bladetwin.worker")
THIN_EVERY = 16
MOST_TEXT = 3000  # characters of an error, before what is said of its entry


class Updater:
    """Applies pending entries, one rotor at a time. `stopping` says that the worker is to end."""

    def __init__(
        self,
        store: SqlStore,
        science: Science,
        settings: Settings,
        owner: str,
        role: claiming.Role = "all",
        stopping: Callable[[], bool] = lambda: False,
    ) -> None:
        self.store = store
        self.science = science
        self.settings = settings
        self.owner = owner
        self.role = role
        self.interrupt = Interrupt(stopping)
        self.bound: Bound = endless
        self._memory = Memories(settings.rotors_in_memory, settings.states_mb, settings.readings_mb)
        self._older = Older(science, owner, settings.lease_s, role)
        self._thinned: dict[str, int] = {}

    @property
    def engine(self) -> Engine:
        return self.store.engine

    def run_once(self) -> bool:
        """Claim a rotor and bring it up to date; False: there was nothing to claim."""
        lease = claiming.claim(
            self.engine,
            self.owner,
            self.settings.lease_s,
            role=self.role,
            quiet_s=self.settings.seal_after_s,
            overdue_s=self.settings.seal_within_s,
        )
        return self._done(lease)

    def renew(self) -> bool:
        """Compute a version of an older algorithm anew; False: there is none to be."""
        return self._done(self._older.claim(self.engine))

    def _done(self, lease: Lease | None) -> bool:
        if lease is None:
            return False
        if not lease.renews and lease.attempts > self.settings.max_attempts:
            found = culprit.of_deaths(self.store, lease)
            self._fail(lease, found.note, found.event, 0.0, block=True)
            return True
        with told(self.store, lease) as trace:
            sealed = None
            try:
                sealed = self._update(lease, trace)
            except LostLeaseError as error:
                trace.failed(error)
                self._memory.forget(lease.rotor_id)
                log.warning("%s", error)
            except (CompiledError, StoreAwayError) as error:
                trace.failed(error)
                self.return_unused(lease)
                raise
            except Interrupted:
                trace.span.event("given back")
                self.return_unused(lease)
            if sealed is not None:
                self.thin(lease.rotor_id, sealed)
        return True

    def _update(self, lease: Lease, trace: Told) -> int | None:
        """Read, compute, commit; what fails is given back. The new version, if it is sealed."""
        most_s = self.settings.update_max_s
        with self.bound(most_s), self.heartbeats(lease, Deadline(most_s)):
            task: Task | None = None
            try:
                begun = perf_counter()
                task = self.read(lease)
                read = perf_counter()
                trace.begin(task.memory.through, task.through)
                with span("compute"), self.interrupt.allowed():
                    state = self.compute(task, quick=not lease.sealing)
                    change = self.change(task, state)
                computed = perf_counter()
            except (CompiledError, StoreAwayError):
                raise
            except Exception as error:
                trace.failed(error)
                self.give_back(lease, task, error)
                return None
        with span("commit"):
            version = self.commit(lease, task, state, change)
        trace.committed(version, sealed=bool(state.meta["sealed"]))
        log.debug(
            "rotor %s: through %d, %d new, sealed %s; read %.1f, update %.1f, commit %.1f ms",
            lease.rotor_id,
            task.through,
            task.pending,
            state.meta["sealed"],
            1e3 * (read - begun),
            1e3 * (computed - read),
            1e3 * (perf_counter() - computed),
        )
        return version if state.meta["sealed"] else None

    def read(self, lease: Lease) -> Task:
        """The rotor, its entries up to the head, and the state before them."""
        return tasks.read(self.store, self.science, lease, self._memory.get(lease.rotor_id))

    def compute(self, task: Task, *, quick: bool) -> RotorState:
        """The new posterior: quick when entries were pending, else sealed."""
        readings, memory = task.log.effective(), task.memory
        try:
            quick = quick and not memory.anew
            return self.science.update(task.card, task.spec, readings, memory.state, quick=quick)
        except DamagedError as error:
            log.error("%s The worker rebuilds it from the log now.", error)
        memory.state, memory.anew = None, True
        return self.science.update(task.card, task.spec, readings, None, quick=False)

    def change(self, task: Task, state: RotorState) -> Change:
        """The arrays that the new version has to write, and the digest of each that it has."""
        return new_version.change(task, state)

    def thin(self, rotor_id: str, version: int) -> None:
        """Drop what no kept version needs, now and then; after a commit, for it may take long."""
        if version - self._thinned.get(rotor_id, 0) >= THIN_EVERY:
            self._thinned[rotor_id] = version
            thin(self.engine, rotor_id, self.settings.keep_versions, self.settings.checkpoint_every)
            trim(self.engine, rotor_id, self.settings.keep_events)

    def commit(self, lease: Lease, task: Task, state: RotorState, change: Change) -> int:
        """State and cursor in one transaction; LostLeaseError leaves the database as it was."""
        memory = new_version.commit(self.engine, lease, task, state, change)
        self._memory.put(lease.rotor_id, memory)
        return memory.version

    def return_unused(self, lease: Lease) -> None:
        """A database that is away or full, code still to be loaded, a worker that is to end: none
        is the rotor's fault, and it must not be blocked for it. Where even that cannot be written
        the lease runs out."""
        self._memory.forget(lease.rotor_id)
        with suppress(StoreAwayError):
            leases.return_unused(self.engine, lease)

    def give_back(self, lease: Lease, task: Task | None, error: Exception) -> None:
        """Pause and try again, or block the rotor and name the entry that stops it.

        A version of an older algorithm that cannot be computed anew stays, and the rotor is as it
        was.
        """
        if lease.renews:
            self._older.leave(lease, error)
            self.return_unused(lease)
            return
        block = lease.attempts >= self.settings.max_attempts
        event = error.event if isinstance(error, CalibrationError) else None
        text = f"{type(error).__name__}: {error}"
        if block and event is None and task is not None:
            with self.interrupt.allowed():
                found = culprit.of_failure(self.store, self.science, lease, task)
            event = found.event
            if found.note:
                text = f"{text[:MOST_TEXT].rstrip(' .:')}. {found.note}"
        pause = min(
            self.settings.retry_max_s, self.settings.retry_base_s * 2 ** (lease.attempts - 1)
        )
        self._fail(lease, text, event, pause, block=block)
        self._memory.forget(lease.rotor_id)
        log.error("rotor %s: attempt %d failed: %s", lease.rotor_id, lease.attempts, text)

    def _fail(
        self, lease: Lease, text: str, event: str | None, pause_s: float, *, block: bool
    ) -> None:
        leases.fail(self.engine, lease, text, event, pause_s, block=block)
        if block:
            trim(self.engine, lease.rotor_id, self.settings.keep_events)

    def heartbeats(
        self, lease: Lease, deadline: Deadline | None = None
    ) -> AbstractContextManager[None]:
        """Prolong the lease every third of it, while the block runs, until the deadline."""
        lease_s = self.settings.lease_s

        def overdue() -> None:
            log.error(
                "rotor %s: the %s has taken longer than BLADETWIN_UPDATE_MAX_S = %g s; its lease "
                "is prolonged no more, and it counts as a death",
                lease.rotor_id,
                "sealing" if lease.sealing else "update",
                self.settings.update_max_s,
            )

        beat = lambda: leases.heartbeat(self.engine, lease, lease_s)  # noqa: E731
        return heartbeats(beat, lease_s, deadline, overdue)
