"""Jobs: what takes longer than a request, and what became of it."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

from sqlalchemy import Connection, RowMapping, insert, select, update

from service import tracing
from service.errors import NotFoundError
from service.ports import JobRecord, Json, ResidualRecord
from service.store import tables as t
from service.store.commits import notify
from service.store.engine import now_s
from service.store.parts import json_parts

UNFINISHED = ("queued", "running")
LISTED = ("verdict", "names", "not_adopted")


class SqlJobs:
    """The jobs of one transaction, and the residuals that workers keep."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def put_job(
        self, job_id: str, kind: str, request: Json, rotor_id: str | None = None
    ) -> JobRecord:
        statement = insert(t.job).values(
            id=job_id,
            kind=kind,
            status="queued",
            request=json.dumps(request),
            attempts=0,
            fence=0,
            created_at=now_s(),
            rotor_id=rotor_id,
            traceparent=tracing.current(),
        )
        self._connection.execute(statement)
        notify(self._connection, "bladetwin_work")
        return self.job(job_id)

    def job(self, job_id: str) -> JobRecord:
        query = select(t.job).where(t.job.c.id == job_id)
        row = self._connection.execute(query).mappings().one_or_none()
        if row is None:
            raise NotFoundError("job", job_id, "use the id of the answer to the POST")
        return _job(row)

    def jobs_of(self, rotor_id: str, kind: str, before: str | None, limit: int) -> list[JobRecord]:
        """Jobs of a rotor whose ids lie below one, the greatest first; of a result `LISTED`."""
        columns = [column for column in t.job.c if column.name not in ("result", "kept")]
        query = select(*columns, json_parts(t.job.c.result, *LISTED).label("parts"))
        query = query.where(t.job.c.rotor_id == rotor_id, t.job.c.kind == kind)
        if before is not None:
            query = query.where(t.job.c.id < before)
        query = query.order_by(t.job.c.id.desc()).limit(limit)
        return [_listed(row) for row in self._connection.execute(query).mappings()]

    def unfinished(self, rotor_id: str, kind: str) -> list[JobRecord]:
        """Jobs of a rotor that are queued or running, the oldest first."""
        query = select(t.job).where(
            t.job.c.rotor_id == rotor_id, t.job.c.kind == kind, t.job.c.status.in_(UNFINISHED)
        )
        rows = self._connection.execute(query.order_by(t.job.c.id)).mappings()
        return [_job(row) for row in rows]

    def residuals(self, rotor_id: str) -> ResidualRecord:
        """What the diagnosing workers kept last."""
        r = t.residual.c
        query = select(r.version, r.body, r.alarms, r.computed_at, r.error)
        row = self._connection.execute(query.where(r.rotor_id == rotor_id)).one_or_none()
        if row is None:
            return ResidualRecord(0, None, 0, None, None)
        return ResidualRecord(**dict(row._mapping) | {"body": _read(row.body)})

    def cancel_job(self, job_id: str) -> None:
        """End a job that is queued or running; its worker's fence holds no longer."""
        own = (t.job.c.id == job_id) & t.job.c.status.in_(UNFINISHED)
        end = (
            update(t.job)
            .where(own)
            .values(
                status="cancelled",
                fence=t.job.c.fence + 1,
                owner=None,
                lease_until=None,
                kept=None,
                finished_at=now_s(),
            )
        )
        self._connection.execute(end)


def _job(row: RowMapping | dict[str, Any]) -> JobRecord:
    return JobRecord(
        id=row["id"],
        kind=row["kind"],
        status=row["status"],
        request=json.loads(row["request"]),
        created_at=row["created_at"],
        result=_read(row["result"]),
        error=row["error"],
        attempts=row["attempts"],
        finished_at=row["finished_at"],
        rotor_id=row["rotor_id"],
        progress=_read(row["progress"]),
    )


def _listed(row: RowMapping) -> JobRecord:
    values = json.loads(row["parts"] or "[]")
    parts = dict(zip(LISTED, values, strict=False))
    told = parts if any(value is not None for value in values) else None
    return replace(_job({**row, "result": None}), result=told)


def _read(text: str | None) -> Any:
    return None if text is None else json.loads(text)
