"""Notes of what was committed: one for each new version and each blocking of a rotor, each alarm,
each diagnosis that has ended, each effect adopted or backed out. What webhooks ask for is written
for them in the same transaction.

A note is written in the transaction that it tells of, after the rotor's cursor was locked, so that
the numbers of a rotor's notes are in the order of its commits; between rotors they need not be.
Only the newest notes of a rotor are kept; `cursor.outbox_dropped` is the last that is not, so that
a reader who asks from before it can be told.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from sqlalchemy import Connection, Engine, delete, exists, func, insert, literal, select, update

from service.ports import Note
from service.store import tables as t
from service.store.commits import notified
from service.store.engine import now_s, transaction
from service.store.hook_tables import webhook
from service.store.webhooks import tell

o = t.outbox.c
# Of every commit: built and understood once. A hint to who waits, and whether a webhook may ask for
# it; nobody asks for the number.
_NOTE = (
    insert(t.outbox)
    .values(at=now_s())
    .returning(exists(select(webhook.c.id)), notified(literal("bladetwin_applied"), o.rotor_id))
)


class SqlOutbox:
    """The `Outbox` of one transaction."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def after(self, rotor_id: str, number: int, limit: int) -> list[Note]:
        query = select(t.outbox).where(o.rotor_id == rotor_id, o.id > number)
        rows = self._connection.execute(query.order_by(o.id).limit(limit))
        return [Note(row.id, rotor_id, row.kind, json.loads(row.payload), row.at) for row in rows]

    def newest(self, rotor_ids: Sequence[str]) -> dict[str, int]:
        query = select(o.rotor_id, func.max(o.id)).where(o.rotor_id.in_(rotor_ids))
        return {row[0]: row[1] for row in self._connection.execute(query.group_by(o.rotor_id))}

    def missing(self, rotor_id: str, number: int) -> bool:
        """Whether notes after one are no longer kept, or the rotor never had that one: it is of a
        database that was restored since, where numbers come again, or of another rotor."""
        own = exists().where(o.rotor_id == rotor_id, o.id == number)
        query = select(t.cursor.c.outbox_dropped, own).where(t.cursor.c.rotor_id == rotor_id)
        dropped, there = self._connection.execute(query).one_or_none() or (0, False)
        return number < dropped or not (there or number in (0, dropped))

    def post(self, rotor_id: str, kind: str, payload: dict[str, Any]) -> None:
        post(self._connection, rotor_id, kind, payload)


def post(connection: Connection, rotor_id: str, kind: str, payload: dict[str, Any]) -> None:
    """A row of the outbox, in the transaction of what it tells, and a hint to who waits.

    The rotor's row has to be locked, so that its notes are numbered in the order of its commits.
    """
    row = {"rotor_id": rotor_id, "kind": kind, "payload": json.dumps(payload)}
    if connection.execute(_NOTE, row).scalar():
        tell(connection, rotor_id, kind, payload)


def trim(engine: Engine, rotor_id: str, keep: int) -> None:
    """Keep the `keep` newest notes of a rotor, at least one, so that numbers never come again."""
    query = select(o.id).where(o.rotor_id == rotor_id).order_by(o.id.desc())
    query = query.offset(max(1, keep)).limit(1)
    with transaction(engine, write=False) as connection:
        last = connection.execute(query).scalar()
    if last is None:
        return
    with transaction(engine, write=True) as connection:
        behind = (t.cursor.c.rotor_id == rotor_id) & (t.cursor.c.outbox_dropped < last)
        connection.execute(update(t.cursor).where(behind).values(outbox_dropped=last))
        connection.execute(delete(t.outbox).where(o.rotor_id == rotor_id, o.id <= last))
