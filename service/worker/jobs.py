"""Work that answers later: the registration or training of a model, a diagnosis.

A job is claimed, fenced and finished like a rotor's update: its result is written only while the
fence of the claim still holds. While it runs, a heartbeat prolongs its lease every third of it, and
each step writes how far it is; there, and within a diagnosis' steps (`service.worker.heed`), a
worker stops that lost its lease or whose job was cancelled.
A step that takes too long hangs (`service.worker.overdue`), and counts as its worker's death.
Diagnoses and trainings take minutes and belong to workers of their own (role `diagnose`); the
others take the short jobs.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from json import dumps
from time import monotonic

from core.errors import FaultsError, InputError, ModelError
from service import tracing
from service.errors import LostLeaseError, NotFoundError, StoreAwayError
from service.handlers.diagnoses import KIND as DIAGNOSE
from service.handlers.models import TRAIN
from service.ports import Json, Progress, Science
from service.settings import Settings
from service.store.engine import now_s
from service.store.unit_of_work import SqlStore, SqlTransaction
from service.worker.claiming import Role
from service.worker.concluding import ahead_of, concluded, in_vain
from service.worker.diagnosing import diagnose
from service.worker.heartbeat import Deadline, heartbeats
from service.worker.heed import Heed, StoppedError
from service.worker.job_lease import JobLease, beat_job, claim_job, close, give_back, tell_progress
from service.worker.overdue import Bound, Steps, endless, hangs
from service.worker.training import drop_runs, keep, refusal, train

log = logging.getLogger("bladetwin.worker")
# Writes what a job comes to, in the transaction that ends it, and gives the job's result.
Outcome = Callable[[SqlTransaction], Json]


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
            heed = Heed(self.store.engine, lease, self.stopping)
            asked = (lease.rotor_id, lease.request)
            found = diagnose(self.store, self.science, *asked, told, lease.kept, heed)
            ahead = ahead_of(self.store, lease.rotor_id, found)
            return lambda tx: concluded(tx, self.science, lease, found, ahead)
        raise NotFoundError("kind of job", lease.kind, "run a worker of the release that wrote it")

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
        said = f"{type(error).__name__}: {error}"[:4000]
        try:
            with self.store.write() as tx:
                if final and lease.kind == TRAIN:
                    drop_runs(tx, lease.id, lease.request)
                if final and lease.kind == DIAGNOSE:
                    in_vain(tx, lease, said)
                close(
                    tx.connection,
                    lease,
                    status="failed" if final else "queued",
                    **refused,
                    **({"kept": None} if final else {}),
                    error=said,
                    progress=None,
                    not_before=now_s() + min(pause, self.settings.retry_max_s),
                    finished_at=now_s() if final else None,
                )
        except LostLeaseError as lost:
            log.warning("%s", lost)
