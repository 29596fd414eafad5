"""Work that answers later: the registration or training of a model, a diagnosis.

A job is claimed, fenced and finished like a rotor's update: its result is written only while the
fence of the claim still holds. While it runs, a heartbeat prolongs its lease every third of it, and
each step writes how far it is; there a worker stops that lost its lease or whose job was cancelled.
A step that takes too long hangs (`service.worker.overdue`), and counts as its worker's death.
Diagnoses and trainings take minutes and belong to workers of their own (role `diagnose`); the
others take the short jobs.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, suppress
from json import dumps
from time import monotonic

from core.errors import BladetwinError, FaultsError, InputError, ModelError
from core.log import Entry
from service import tracing
from service.errors import AdoptionError, LostLeaseError, NotFoundError, StoreAwayError
from service.handlers.adoptable import read_ahead
from service.handlers.adoptions import adopt_in, backed_out
from service.handlers.diagnoses import BECAUSE
from service.handlers.diagnoses import KIND as DIAGNOSE
from service.handlers.models import TRAIN
from service.ports import Json, Progress, Science
from service.settings import Settings
from service.store.engine import now_s
from service.store.outbox import post
from service.store.unit_of_work import SqlStore, SqlTransaction
from service.worker.claiming import Role
from service.worker.diagnosing import diagnose
from service.worker.heartbeat import Deadline, heartbeats
from service.worker.job_lease import JobLease, beat_job, claim_job, close, give_back, tell_progress
from service.worker.overdue import Bound, Steps, endless, hangs
from service.worker.training import drop_runs, keep, refusal, train

log = logging.getLogger("bladetwin.worker")
# Writes what a job comes to, in the transaction that ends it, and gives the job's result.
Outcome = Callable[[SqlTransaction], Json]


class StoppedError(BladetwinError):
    """The worker is to end: the job goes back as if it had not been begun."""


class Jobs:
    """Runs jobs, one at a time. `stopping` says that the worker is to end."""

    def __init__(
        self,
        store: SqlStore,
        science: Science,
        settings: Settings,
        owner: str,
        role: Role = "all",
        stopping: Callable[[], bool] = lambda: False,
    ) -> None:
        self.store = store
        self.science = science
        self.settings = settings
        self.owner = owner
        self.role = role
        self.stopping = stopping
        self.bound: Bound = endless

    def run_once(self) -> bool:
        """Claim a job and finish it; False: there was none."""
        lease = claim_job(
            self.store.engine,
            self.owner,
            self.settings.lease_s,
            self.role,
            self.settings.retry_max_s,
        )
        if lease is None:
            return False
        with tracing.span(
            lease.kind, kind="consumer", parent=tracing.parent_of(lease.traceparent)
        ) as span:
            span.tell(job=lease.id, rotor=lease.rotor_id, attempt=lease.attempts)
            self._run(lease, span)
        return True

    def _run(self, lease: JobLease, span: tracing.Span) -> None:
        """Do the job and write what it came to."""
        try:
            if lease.attempts > self.settings.max_attempts:
                raise NotFoundError(
                    "worker that survives job", lease.id, "see the log of the workers"
                )
            steps = Steps(self.settings.step_max_s, self.bound)
            with steps, self.heartbeats(lease, steps.deadline):
                write = self.work(lease, span, steps.next)
            with self.store.write() as tx:
                result = write(tx)
                close(
                    tx.connection,
                    lease,
                    status="done",
                    kept=None,
                    result=dumps(result, allow_nan=False),
                    error=None,
                    progress=None,
                    finished_at=now_s(),
                )
        except LostLeaseError as error:
            span.fail(type(error).__name__)
            log.warning("%s", error)
        except StoppedError:
            span.event("given back")
            self._give_back(lease)
        except StoreAwayError as error:
            span.fail(type(error).__name__)
            with suppress(StoreAwayError):
                self._give_back(lease)
            raise
        except Exception as error:
            span.fail(type(error).__name__)
            self._failed(lease, error)

    def work(
        self,
        lease: JobLease,
        span: tracing.Span = tracing.NOTHING,
        begins: Callable[[], None] = lambda: None,
    ) -> Outcome:
        """The result of a job, computed outside any transaction; `begins` is told of each step."""
        if lease.kind == "register-model":
            card = self.science.builtin(lease.request["builtin"])
            result = {"model": card.id, "version": card.version, "digest": card.digest}

            def register(tx: SqlTransaction) -> Json:
                tx.records.put_model(card, lease.request)
                return result

            return register
        if lease.kind == TRAIN:
            told = self.progress(lease, span, begins)
            card, artefact = train(self.store, self.science, lease.request, told)
            return lambda tx: keep(tx, lease.id, lease.request, card, artefact)
        if lease.kind == DIAGNOSE and lease.rotor_id is not None:
            told = self.progress(lease, span, begins)
            found = diagnose(
                self.store, self.science, lease.rotor_id, lease.request, told, lease.kept
            )
            ahead = self.ahead_of(lease.rotor_id, found)
            return lambda tx: self.concluded(tx, lease, found, ahead)
        raise NotFoundError("kind of job", lease.kind, "run a worker of the release that wrote it")

    def ahead_of(self, rotor_id: str, found: Json) -> Sequence[Entry]:
        """The rotor's entries so far, where its option may adopt what was found."""
        with self.store.read() as tx:
            option = tx.records.rotor(rotor_id).adopts
        wanted = option == "effect" and found["verdict"] == "effect"
        return read_ahead(self.store, rotor_id) if wanted else ()

    def concluded(
        self, tx: SqlTransaction, lease: JobLease, found: Json, ahead: Sequence[Entry]
    ) -> Json:
        """The result of a diagnosis; adopted with it where the rotor says so and nothing forbids.

        What forbids it stands in the result, as ``not_adopted``.
        """
        assert lease.rotor_id is not None
        tx.log.lock(lease.rotor_id)
        told = {"diagnosis": lease.id, "verdict": found["verdict"], "names": found["names"]}
        post(tx.connection, lease.rotor_id, "diagnosed", told)
        option = tx.records.rotor(lease.rotor_id).adopts
        if option != "effect" or found["verdict"] != "effect":
            return found
        try:
            job = tx.records.job(lease.id)
            asked = BECAUSE not in job.request
            problem = None if asked else backed_out(tx, lease.rotor_id, found["effects"])
            if problem is not None:
                there = f"/v1/rotors/{lease.rotor_id}/diagnoses/{lease.id}"
                remedy = f"where it is to be had all the same, POST {there}/adoption"
                raise AdoptionError(lease.id, "adopted unasked", problem, remedy)
            adopt_in(tx, self.science, job, found, ahead, unasked=True)
        except AdoptionError as error:
            log.warning("%s", error)
            return found | {"not_adopted": str(error)}
        return found

    def progress(
        self,
        lease: JobLease,
        span: tracing.Span = tracing.NOTHING,
        begins: Callable[[], None] = lambda: None,
    ) -> Progress:
        """Writes each step with the time left, judged by the steps before, and ends a lost job."""
        begun = monotonic()

        def tell(what: str, done: int, total: int) -> None:
            if self.stopping():
                raise StoppedError(f"job {lease.id} goes back: its worker ends")
            begins()
            span.event(what)
            left = round((monotonic() - begun) * (total - done) / done, 1) if done else None
            told = {"what": what, "done": done, "total": total, "seconds_left": left}
            with suppress(StoreAwayError):
                tell_progress(self.store.engine, lease, told)

        return tell

    def heartbeats(
        self, lease: JobLease, deadline: Deadline | None = None
    ) -> AbstractContextManager[None]:
        """Prolong the lease every third of it, while the block runs."""
        lease_s = self.settings.lease_s
        due = deadline or Deadline()
        beat = lambda: beat_job(self.store.engine, lease, lease_s)  # noqa: E731
        return heartbeats(beat, lease_s, due, lambda: hangs(f"job {lease.id}", due))

    def _give_back(self, lease: JobLease) -> None:
        """To the queue; the attempt does not count."""
        with suppress(LostLeaseError):
            give_back(self.store.engine, lease)

    def _failed(self, lease: JobLease, error: Exception) -> None:
        final = isinstance(error, (InputError, FaultsError, NotFoundError))
        final = final or (lease.kind == TRAIN and isinstance(error, ModelError))
        final = final or lease.attempts >= self.settings.max_attempts
        refused = {"result": refusal(error)} if final and lease.kind == TRAIN else {}
        pause = self.settings.retry_base_s * 2 ** (lease.attempts - 1)
        log.error("job %s: attempt %d failed: %s", lease.id, lease.attempts, error)
        try:
            with self.store.write() as tx:
                if final and lease.kind == TRAIN:
                    drop_runs(tx, lease.id, lease.request)
                close(
                    tx.connection,
                    lease,
                    status="failed" if final else "queued",
                    **refused,
                    **({"kept": None} if final else {}),
                    error=f"{type(error).__name__}: {error}"[:4000],
                    progress=None,
                    not_before=now_s() + min(pause, self.settings.retry_max_s),
                    finished_at=now_s() if final else None,
                )
        except LostLeaseError as lost:
            log.warning("%s", lost)
