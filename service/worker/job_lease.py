"""The fenced moves of a job, like those of a rotor's cursor (`service.worker.lease`).

A claim raises the job's fence, and a cancellation does, too; from then on the earlier worker's
heartbeat, progress and end match no row: it finds that the job is no longer its own. The kinds
that take minutes (`LONG`) belong to workers of their own.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from json import dumps, loads

from sqlalchemy import ColumnElement, Connection, Engine, Select, or_, select, update

from service.errors import LostLeaseError
from service.handlers.diagnoses import KIND as DIAGNOSE
from service.handlers.models import TRAIN
from service.ports import Json
from service.store import tables as t
from service.store.engine import now_s, transaction
from service.worker import clock
from service.worker.claiming import Role
from service.worker.clock import LONGEST_S, over, rested

c = t.job.c
LONG = (DIAGNOSE, TRAIN)


@dataclass(frozen=True, slots=True)
class JobLease:
    """A claimed job; `kept` is what earlier attempts at it have found out."""

    id: str
    kind: str
    request: Json
    fence: int
    attempts: int
    rotor_id: str | None
    traceparent: str | None = None
    kept: Json = field(default_factory=dict)


def takes(role: Role) -> ColumnElement[bool]:
    """The kinds of jobs that a worker of this role takes."""
    return c.kind.in_(LONG) if role == "diagnose" else c.kind.not_in(LONG)


def holds(lease: JobLease) -> ColumnElement[bool]:
    """The fence: no one has claimed or cancelled the job since."""
    return c.fence == lease.fence


def runs() -> ColumnElement[bool]:
    """The job has not ended."""
    return c.status == "running"


@lru_cache(maxsize=32)
def _oldest(
    lease_s: float, role: Role, longest_s: float, conditions: tuple[object, ...]
) -> Select[str]:
    """The job that waits longest, built once (as `service.worker.claiming` does)."""
    free = or_(c.lease_until.is_(None), over(c.lease_until, lease_s))
    now = rested(c.not_before, longest_s)
    first = select(c.id).where(c.status.in_(("queued", "running")), takes(role), free, now)
    return first.order_by(c.created_at).limit(1)


def claim_job(
    engine: Engine, owner: str, lease_s: float, role: Role = "all", longest_s: float = LONGEST_S
) -> JobLease | None:
    """Take the oldest job of the role's kinds that nobody alive holds."""
    first = _oldest(lease_s, role, longest_s, (takes, over, clock.AHEAD))
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
                attempts=c.attempts + clock.counted(c.lease_until, lease_s),
                owner=owner,
                lease_until=now_s() + lease_s,
            )
        )
        told = (c.kind, c.request, c.fence, c.attempts, c.rotor_id, c.traceparent, c.kept)
        row = connection.execute(take.returning(*told)).one()
        return JobLease(
            id=job_id,
            kind=row.kind,
            request=loads(row.request),
            fence=row.fence,
            attempts=row.attempts,
            rotor_id=row.rotor_id,
            traceparent=row.traceparent,
            kept=loads(row.kept) if row.kept else {},
        )


def beat_job(engine: Engine, lease: JobLease, lease_s: float) -> bool:
    """Prolong the lease; False: the job is no longer the caller's."""
    own = (c.id == lease.id) & holds(lease)
    with transaction(engine, write=True) as connection:
        beat = update(t.job).where(own).values(lease_until=now_s() + lease_s)
        return connection.execute(beat).rowcount == 1


def tell_progress(engine: Engine, lease: JobLease, progress: Json) -> None:
    """Write how far a job is, and what was found out on the way, for whoever has to go on.

    LostLeaseError: it was cancelled, or another worker has it.
    """
    own = (c.id == lease.id) & holds(lease)
    with transaction(engine, write=True) as connection:
        told = update(t.job).where(own).values(progress=dumps(progress), **_found(lease))
        if connection.execute(told).rowcount != 1:
            raise LostLeaseError(f"job {lease.id}", lease.fence)


def still_holds(engine: Engine, lease: JobLease) -> None:
    """LostLeaseError: the job was cancelled, or another worker has it."""
    own = (c.id == lease.id) & runs() & holds(lease)
    with transaction(engine, write=False) as connection:
        if connection.execute(select(c.id).where(own)).scalar() is None:
            raise LostLeaseError(f"job {lease.id}", lease.fence)


def close(connection: Connection, lease: JobLease, **values: object) -> None:
    """End the claim in the caller's transaction. LostLeaseError: roll everything back.

    A job that has ended keeps its end, though its worker was never told that it was committed.
    """
    own = (c.id == lease.id) & runs() & holds(lease)
    close = update(t.job).where(own).values(owner=None, lease_until=None, **values)
    if connection.execute(close).rowcount != 1:
        raise LostLeaseError(f"job {lease.id}", lease.fence)


def give_back(engine: Engine, lease: JobLease) -> None:
    """End a claim of which nothing came: the job is queued again, and no attempt is counted."""
    with transaction(engine, write=True) as connection:
        same = _found(lease) | {"attempts": c.attempts - 1, "progress": None}
        close(connection, lease, status="queued", **same)


def _found(lease: JobLease) -> dict[str, object]:
    """What was found out so far, as a column's value."""
    return {"kept": dumps(lease.kept)} if lease.kept else {}
