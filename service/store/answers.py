"""What requests with an Idempotency-Key were answered, until it expires."""

from __future__ import annotations

import json
from collections.abc import Sequence

from sqlalchemy import ColumnElement, Connection, delete, select, update
from sqlalchemy.dialects import postgresql, sqlite

from service.access import FirstAnswer
from service.store import access_tables as t
from service.store.engine import now_s

c = t.first_answer.c


class SqlAnswers:
    """The `Answers` of one transaction."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def begin(
        self, owner: str, key: str, fingerprint: str, keep_s: float, stale_s: float
    ) -> FirstAnswer | None:
        """Take the key for a request; the answer that it has already, else None: it is taken.

        Two requests at once cannot both take it: the second waits for the first one's row. A
        request that has been answering for `stale_s` has died; its key is taken over. So has one
        that began that far in the future: the database's clock was set back.
        """
        now = now_s()
        self._connection.execute(delete(t.first_answer).where(c.expires_at <= now))
        dead = (c.owner == owner) & (c.key == key) & c.status.is_(None)
        stale = (c.begun_at <= now - stale_s) | (c.begun_at > now + stale_s)
        self._connection.execute(delete(t.first_answer).where(dead, stale))
        dialect = sqlite if self._connection.dialect.name == "sqlite" else postgresql
        statement = dialect.insert(t.first_answer).values(
            owner=owner, key=key, fingerprint=fingerprint, begun_at=now, expires_at=now + keep_s
        )
        taken = statement.on_conflict_do_nothing().returning(c.key)
        if self._connection.execute(taken).first() is not None:
            return None
        query = select(t.first_answer, (now - c.begun_at).label("age_s"))
        row = self._connection.execute(query.where(c.owner == owner, c.key == key)).first()
        if row is None:  # freed between the two statements (PostgreSQL): as if it still went on
            return FirstAnswer(fingerprint, None, (), b"", 0.0)
        headers = tuple((name, value) for name, value in json.loads(row.headers or "[]"))
        body = bytes(row.body or b"")
        return FirstAnswer(row.fingerprint, row.status, headers, body, row.age_s)

    def finish(
        self,
        owner: str,
        key: str,
        fingerprint: str,
        status: int,
        headers: Sequence[tuple[str, str]],
        body: bytes,
    ) -> None:
        """Keep the answer for those who ask again; not where another request has taken over."""
        own = update(t.first_answer).where(_own(owner, key, fingerprint))
        told = json.dumps([list(pair) for pair in headers])
        self._connection.execute(own.values(status=status, headers=told, body=body))

    def forget(self, owner: str, key: str, fingerprint: str) -> None:
        """Free the key of a request that changed nothing."""
        self._connection.execute(delete(t.first_answer).where(_own(owner, key, fingerprint)))


def _own(owner: str, key: str, fingerprint: str) -> ColumnElement[bool]:
    named = (c.owner == owner) & (c.key == key)
    return named & (c.fingerprint == fingerprint) & c.status.is_(None)
