"""Who changed what, when and from where."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query
from fastapi.responses import JSONResponse

from service.access import AuditRecord
from service.api.services import Limit, Seen, Wired, moment, page, page_size
from service.handlers.audit import list_audit
from service.names import ID_PATTERN

router = APIRouter(prefix="/v1/audit", tags=["audit"])
Named = Annotated[str | None, Query(max_length=100, pattern=ID_PATTERN)]


def row_out(row: AuditRecord) -> dict[str, Any]:
    """A row as it is told: by the API and by `bladetwin audit`."""
    entries = {"first_seq": row.first_seq, "last_seq": row.last_seq}
    return {
        "id": row.id,
        "at": moment(row.at),
        "key": row.key_id,
        "who": row.who,
        "address": row.address,
        "request_id": row.request_id,
        "what": row.what,
        "path": row.path,
        "rotor": row.rotor_id,
        "entries": None if row.first_seq is None else entries,
        "status": row.status,
        "problem": row.problem,
    }


@router.get("", summary="State-changing requests, the newest first")
def get_audit(
    services: Wired,
    seen: Seen,
    limit: Limit = None,
    cursor: Annotated[int | None, Query(ge=0, lt=2**62)] = None,
    rotor: Named = None,
    key: Named = None,
) -> JSONResponse:
    size = page_size(services, limit)
    rows = list_audit(services.store, cursor, size + 1, rotor, key, seen)
    body = page([row_out(row) for row in rows], size, "id")
    return JSONResponse(body, headers={"Cache-Control": "no-store"})
