"""Work that belongs to no rotor, e.g. the registration of a model.

A job is claimed, fenced and finished like a rotor's update: its result is written only while the
fence of the claim still holds.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from json import dumps, loads

from sqlalchemy import Connection, Engine, or_, select, update

from core.errors import InputError
from service.errors import LostLeaseError, NotFoundError
from service.ports import Json, ModelCard, Science
from service.settings import Settings
from service.store import tables as t
from service.store.engine import now_s, transaction
from service.store.unit_of_work import SqlStore

log = logging.getLogger("bladetwin.worker")
c = t.job.c


@dataclass(frozen=True, slots=True)
class JobLease:
    """A claimed job."""

    id: str
    kind: str
    request: Json
    fence: int
    attempts: int


def claim_job(engine: Engine, owner: str, lease_s: float) -> JobLease | None:
    """Take the oldest job that nobody alive holds."""
    free = or_(c.lease_until.is_(None), c.lease_until <= now_s())
    rested = or_(c.not_before.is_(None), c.not_before <= now_s())
    first = select(c.id).where(c.status.in_(("queued", "running")), free, rested)
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
        row = connection.execute(take.returning(c.kind, c.request, c.fence, c.attempts)).one()
        return JobLease(job_id, row.kind, loads(row.request), row.fence, row.attempts)


def _close(connection: Connection, lease: JobLease, **values: object) -> None:
    own = (c.id == lease.id) & (c.fence == lease.fence)
    close = update(t.job).where(own).values(owner=None, lease_until=None, **values)
    if connection.execute(close).rowcount != 1:
        raise LostLeaseError(f"job {lease.id}", lease.fence)


class Jobs:
    """Runs jobs, one at a time."""

    def __init__(self, store: SqlStore, science: Science, settings: Settings, owner: str) -> None:
        self.store = store
        self.science = science
        self.settings = settings
        self.owner = owner

    def run_once(self) -> bool:
        """Claim a job and finish it; False: there was none."""
        lease = claim_job(self.store.engine, self.owner, self.settings.lease_s)
        if lease is None:
            return False
        try:
            if lease.attempts > self.settings.max_attempts:
                raise NotFoundError(
                    "worker that survives job", lease.id, "see the log of the workers"
                )
            card = self._card(lease)
            with self.store.write() as tx:
                tx.records.put_model(card, lease.request)
                result = {"model": card.id, "version": card.version, "digest": card.digest}
                _close(
                    tx.connection,
                    lease,
                    status="done",
                    result=dumps(result),
                    error=None,
                    finished_at=now_s(),
                )
        except LostLeaseError as error:
            log.warning("%s", error)
        except Exception as error:
            self._failed(lease, error)
        return True

    def _card(self, lease: JobLease) -> ModelCard:
        if lease.kind == "register-model":
            return self.science.builtin(lease.request["builtin"])
        raise NotFoundError("kind of job", lease.kind, "run a worker of the release that wrote it")

    def _failed(self, lease: JobLease, error: Exception) -> None:
        final = isinstance(error, (InputError, NotFoundError))
        final = final or lease.attempts >= self.settings.max_attempts
        pause = self.settings.retry_base_s * 2 ** (lease.attempts - 1)
        log.error("job %s: attempt %d failed: %s", lease.id, lease.attempts, error)
        try:
            with transaction(self.store.engine, write=True) as connection:
                _close(
                    connection,
                    lease,
                    status="failed" if final else "queued",
                    error=f"{type(error).__name__}: {error}"[:4000],
                    not_before=now_s() + min(pause, self.settings.retry_max_s),
                    finished_at=now_s() if final else None,
                )
        except LostLeaseError as lost:
            log.warning("%s", lost)
