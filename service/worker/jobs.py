"""Work that answers later: the registration or training of a model, a diagnosis.

A job is claimed, fenced and finished like a rotor's update: its result is written only while the
fence of the claim still holds. While it runs, a heartbeat prolongs its lease every third of it, and
each step writes how far it is; there a worker stops that lost its lease or whose job was cancelled.
Diagnoses and trainings take minutes and belong to workers of their own (role `diagnose`); the
others take the short jobs.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from json import dumps, loads
from time import monotonic

from sqlalchemy import ColumnElement, Connection, Engine, or_, select, update

from core.errors import BladetwinError, FaultsError, InputError, ModelError
from service import tracing
from service.errors import AdoptionError, LostLeaseError, NotFoundError, StoreAwayError
from service.handlers.adoptions import adopt_in
from service.handlers.diagnoses import KIND as DIAGNOSE
from service.handlers.models import TRAIN
from service.ports import Json, Progress, Science
from service.settings import Settings
from service.store import tables as t
from service.store.engine import now_s, transaction
from service.store.outbox import post
from service.store.unit_of_work import SqlStore, SqlTransaction
from service.worker.diagnosing import diagnose
from service.worker.heartbeat import heartbeats
from service.worker.lease import Role, over
from service.worker.training import drop_runs, keep, refusal, train

log = logging.getLogger("bladetwin.worker")
c = t.job.c
LONG = (DIAGNOSE, TRAIN)
# Writes what a job comes to, in the transaction that ends it, and gives the job's result.
Outcome = Callable[[SqlTransaction], Json]


class StoppedError(BladetwinError):
    """The worker is to end: the job goes back as if it had not been begun."""


@dataclass(frozen=True, slots=True)
class JobLease:
    """A claimed job."""

    id: str
    kind: str
    request: Json
    fence: int
    attempts: int
    rotor_id: str | None
    traceparent: str | None = None


def takes(role: Role) -> ColumnElement[bool]:
    """The kinds of jobs that a worker of this role takes."""
    return c.kind.in_(LONG) if role == "diagnose" else c.kind.not_in(LONG)


def holds(lease: JobLease) -> ColumnElement[bool]:
    """The fence: no one has claimed or cancelled the job since."""
    return c.fence == lease.fence


def claim_job(engine: Engine, owner: str, lease_s: float, role: Role = "all") -> JobLease | None:
    """Take the oldest job of the role's kinds that nobody alive holds."""
    free = or_(c.lease_until.is_(None), over(c.lease_until, lease_s))
    rested = or_(c.not_before.is_(None), c.not_before <= now_s())
    first = select(c.id).where(c.status.in_(("queued", "running")), takes(role), free, rested)
    first = first.order_by(c.created_at).limit(1)
    with transaction(engine, write=False) as connection:
        if connection.execute(first).scalar() is None:
            return None
    with transaction(engine, write=True) as connection:
        job_id = connection.execute(first.with_for_update(skip_locked=True)).scalar()
        if job_id is None:
            return None
        take = (
            update(t.job)
            .where(c.id == job_id)
            .values(
                status="running",
                fence=c.fence + 1,
                attempts=c.attempts + 1,
                owner=owner,
                lease_until=now_s() + lease_s,
            )
        )
        told = take.returning(c.kind, c.request, c.fence, c.attempts, c.rotor_id, c.traceparent)
        row = connection.execute(told).one()
        return JobLease(
            id=job_id,
            kind=row.kind,
            request=loads(row.request),
            fence=row.fence,
            attempts=row.attempts,
            rotor_id=row.rotor_id,
            traceparent=row.traceparent,
        )


def beat_job(engine: Engine, lease: JobLease, lease_s: float) -> bool:
    """Prolong the lease; False: the job is no longer the caller's."""
    own = (c.id == lease.id) & holds(lease)
    with transaction(engine, write=True) as connection:
        beat = update(t.job).where(own).values(lease_until=now_s() + lease_s)
        return connection.execute(beat).rowcount == 1


def tell_progress(engine: Engine, lease: JobLease, progress: Json) -> None:
    """Write how far a job is. LostLeaseError: it was cancelled, or another worker has it."""
    own = (c.id == lease.id) & holds(lease)
    with transaction(engine, write=True) as connection:
        told = update(t.job).where(own).values(progress=dumps(progress))
        if connection.execute(told).rowcount != 1:
            raise LostLeaseError(f"job {lease.id}", lease.fence)


def _close(connection: Connection, lease: JobLease, **values: object) -> None:
    own = (c.id == lease.id) & holds(lease)
    close = update(t.job).where(own).values(owner=None, lease_until=None, **values)
    if connection.execute(close).rowcount != 1:
        raise LostLeaseError(f"job {lease.id}", lease.fence)


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

    def run_once(self) -> bool:
        """Claim a job and finish it; False: there was none."""
        lease = claim_job(self.store.engine, self.owner, self.settings.lease_s, self.role)
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
            with self.heartbeats(lease):
                write = self.work(lease, span)
            with self.store.write() as tx:
                result = write(tx)
                _close(
                    tx.connection,
                    lease,
                    status="done",
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

    def work(self, lease: JobLease, span: tracing.Span = tracing.NOTHING) -> Outcome:
        """The result of a job, computed outside any transaction."""
        if lease.kind == "register-model":
            card = self.science.builtin(lease.request["builtin"])
            result = {"model": card.id, "version": card.version, "digest": card.digest}

            def register(tx: SqlTransaction) -> Json:
                tx.records.put_model(card, lease.request)
                return result

            return register
        if lease.kind == TRAIN:
            told = self.progress(lease, span)
            card, artefact = train(self.store, self.science, lease.request, told)
            return lambda tx: keep(tx, lease.id, lease.request, card, artefact)
        if lease.kind == DIAGNOSE and lease.rotor_id is not None:
            told = self.progress(lease, span)
            found = diagnose(self.store, self.science, lease.rotor_id, lease.request, told)
            return lambda tx: self.concluded(tx, lease, found)
        raise NotFoundError("kind of job", lease.kind, "run a worker of the release that wrote it")

    def concluded(self, tx: SqlTransaction, lease: JobLease, found: Json) -> Json:
        """The result of a diagnosis; adopted with it where the rotor says so and nothing forbids.

        What forbids it stands in the result, as ``not_adopted``.
        """
        assert lease.rotor_id is not None
        tx.log.lock(lease.rotor_id)
        told = {"diagnosis": lease.id, "verdict": found["verdict"], "names": found["names"]}
        post(tx.connection, lease.rotor_id, "diagnosed", told)
        option = tx.records.rotor(lease.rotor_id).adopt
        if option != "effect" or found["verdict"] != "effect":
            return found
        try:
            adopt_in(tx, self.science, tx.records.job(lease.id), found, unasked=True)
        except AdoptionError as error:
            log.warning("%s", error)
            return found | {"not_adopted": str(error)}
        return found

    def progress(self, lease: JobLease, span: tracing.Span = tracing.NOTHING) -> Progress:
        """Writes each step with the time left, judged by the steps before, and ends a lost job."""
        begun = monotonic()

        def tell(what: str, done: int, total: int) -> None:
            if self.stopping():
                raise StoppedError(f"job {lease.id} goes back: its worker ends")
            span.event(what)
            left = round((monotonic() - begun) * (total - done) / done, 1) if done else None
            told = {"what": what, "done": done, "total": total, "seconds_left": left}
            with suppress(StoreAwayError):
                tell_progress(self.store.engine, lease, told)

        return tell

    def heartbeats(self, lease: JobLease) -> AbstractContextManager[None]:
        """Prolong the lease every third of it, while the block runs."""
        lease_s = self.settings.lease_s
        return heartbeats(lambda: beat_job(self.store.engine, lease, lease_s), lease_s)

    def _give_back(self, lease: JobLease) -> None:
        """To the queue; the attempt does not count."""
        with suppress(LostLeaseError), transaction(self.store.engine, write=True) as connection:
            _close(connection, lease, status="queued", attempts=c.attempts - 1, progress=None)

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
                _close(
                    tx.connection,
                    lease,
                    status="failed" if final else "queued",
                    **refused,
                    error=f"{type(error).__name__}: {error}"[:4000],
                    progress=None,
                    not_before=now_s() + min(pause, self.settings.retry_max_s),
                    finished_at=now_s() if final else None,
                )
        except LostLeaseError as lost:
            log.warning("%s", lost)
