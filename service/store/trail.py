"""The audit trail: a row for each state-changing request, never dropped.

Paths and request ids come from outside, so tokens are taken out of them before they are written.
"""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import Connection, insert, select, update

from service.access import Act, AuditRecord
from service.store import access_tables as t
from service.store.engine import now_s
from service.tokens import redacted

LONGEST_PATH = 500
LONGEST_NAME = 200
_NOTE = insert(t.audit).values(at=now_s()).returning(t.audit.c.id)


class SqlAudit:
    """The `Audit` of one transaction."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def note(
        self,
        act: Act,
        status: int,
        problem: str | None = None,
        entries: tuple[int, int] | None = None,
    ) -> int:
        """Write the row of a request; its id."""
        first, last = entries or (None, None)
        row = {
            "key_id": act.key_id,
            "who": act.who,
            "address": None if act.address is None else _text(act.address)[:LONGEST_NAME],
            "request_id": redacted(act.request_id),
            "what": act.what,
            "path": _text(redacted(act.path))[:LONGEST_PATH],
            "rotor_id": None if act.rotor is None else _text(redacted(act.rotor))[:LONGEST_NAME],
            "first_seq": first,
            "last_seq": last,
            "status": status,
            "problem": problem,
        }
        return int(self._connection.execute(_NOTE, row).scalar_one())

    def correct(self, row: int, status: int, problem: str | None) -> None:
        """The answer was another one than the row says."""
        statement = update(t.audit).where(t.audit.c.id == row)
        self._connection.execute(statement.values(status=status, problem=problem))

    def page(
        self,
        before: int | None,
        limit: int,
        rotor: str | None = None,
        key_id: str | None = None,
        only: Sequence[str] | None = None,
    ) -> list[AuditRecord]:
        """The newest rows first, below an id; of one rotor, one key, or some rotors only."""
        c = t.audit.c
        query = select(t.audit).order_by(c.id.desc()).limit(limit)
        if before is not None:
            query = query.where(c.id < before)
        if rotor is not None:
            query = query.where(c.rotor_id == rotor)
        if key_id is not None:
            query = query.where(c.key_id == key_id)
        if only is not None:
            query = query.where(c.rotor_id.in_(only))
        return [AuditRecord(**row) for row in self._connection.execute(query).mappings()]


def _text(value: str) -> str:
    """What PostgreSQL can keep as text: no NUL, no half of a surrogate pair."""
    return value.replace("\x00", "␀").encode("utf-8", "replace").decode()
