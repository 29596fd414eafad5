"""What pages show at a glance: readings of each blade, and who works on what.

Few plain queries: no state is loaded, no body of a reading is parsed.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from sqlalchemy import Connection, Select, and_, case, func, or_, select, true

from service.ports import AtWork, BladeReadings, JobRecord, Operations, RotorRecord
from service.store import tables as t
from service.store.engine import now_s
from service.store.gauges import read_gauges
from service.store.records import SqlRecords

e, c, j = t.entry.c, t.cursor.c, t.job.c
UNFINISHED = ("queued", "running")


def _gone(rotor_id: str, through: int) -> Select[Any]:
    """Ids of what was retracted."""
    return select(e.replaces).where(
        e.rotor_id == rotor_id, e.seq <= through, e.kind == "retraction"
    )


def _replaced(rotor_id: str, through: int) -> Select[Any]:
    """Ids of what is replaced, `core.log.replaced` in SQL: up the chain of each correction
    that stands, through those that are retracted."""
    own = (
        e.rotor_id == rotor_id,
        e.seq <= through,
        e.kind == "inspection",
        e.replaces.is_not(None),
    )
    gone = _gone(rotor_id, through)
    first = select(e.event_id.label("tip"), e.replaces.label("above"))
    chain = first.where(*own, e.event_id.not_in(gone)).cte("chain", recursive=True)
    further = select(chain.c.tip, e.replaces).join(t.entry, e.event_id == chain.c.above)
    chain = chain.union(further.where(*own, e.event_id.in_(gone)))
    return select(chain.c.above).where(chain.c.above != chain.c.tip)


def read_blade_readings(
    connection: Connection, rotor_id: str, through: int
) -> dict[str, BladeReadings]:
    """By blade, of the entries up to `through`: how many readings count, how many do not, and the
    one that counts and came last."""
    gone, over = _gone(rotor_id, through), _replaced(rotor_id, through)
    overruled = or_(e.event_id.in_(gone), e.event_id.in_(over))
    per_blade = (
        select(
            e.blade,
            func.count().label("all"),
            func.sum(case((overruled, 0), else_=1)).label("counting"),
            func.max(case((overruled, None), else_=e.seq)).label("last_seq"),
        )
        .where(e.rotor_id == rotor_id, e.seq <= through, e.kind == "inspection")
        .group_by(e.blade)
        .subquery()
    )
    last = and_(e.rotor_id == rotor_id, e.seq == per_blade.c.last_seq)
    query = select(per_blade, e.event_id, e.time_h, e.received_at).outerjoin(t.entry, last)
    return {
        row.blade: BladeReadings(
            counting=int(row.counting),
            overruled=int(row.all - row.counting),
            last_id=row.event_id,
            last_time_h=row.time_h,
            last_received_at=row.received_at,
        )
        for row in connection.execute(query)
    }


def read_operations(connection: Connection, limit: int, superseded: Sequence[str]) -> Operations:
    """The gauges, who holds a lease now, jobs that go on and rotors that are blocked."""
    now = float(connection.execute(select(now_s())).scalar_one())
    held = select(
        c.rotor_id, c.owner, c.sealing, c.lease_until, (t.rotor.c.head_seq - c.applied_seq)
    ).join(t.rotor, t.rotor.c.id == c.rotor_id)
    held = held.where(c.owner.is_not(None), c.lease_until > now).order_by(c.rotor_id).limit(limit)
    work = [
        AtWork(owner, "seals" if sealing else "applies", rotor, until - now, behind)
        for rotor, owner, sealing, until, behind in connection.execute(held)
    ]
    jobs = []
    going = select(t.job).where(j.status.in_(UNFINISHED)).order_by(j.created_at).limit(limit)
    for row in connection.execute(going):
        told = None if row.progress is None else json.loads(row.progress)
        request = json.loads(row.request)
        jobs.append(
            JobRecord(
                id=row.id,
                kind=row.kind,
                status=row.status,
                request=request,
                created_at=row.created_at,
                attempts=row.attempts,
                rotor_id=row.rotor_id,
                progress=told,
            )
        )
        if row.owner is not None and row.lease_until is not None and row.lease_until > now:
            work.append(AtWork(row.owner, row.kind, row.rotor_id, row.lease_until - now, None))
    return Operations(
        read_gauges(connection, superseded),
        tuple(work),
        tuple(jobs),
        _blocked(connection, limit),
    )


def _blocked(connection: Connection, limit: int) -> tuple[RotorRecord, ...]:
    names = select(c.rotor_id).where(c.blocked == true()).order_by(c.rotor_id).limit(limit)
    records = SqlRecords(connection)
    return tuple(records.rotor(name) for name in connection.execute(names).scalars())
