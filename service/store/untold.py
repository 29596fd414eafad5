"""What a webhook is not told any more: deliveries that are no longer kept, and their count.

Of each webhook and rotor the newest `WAITING` deliveries wait for a receiver that is away. The
oldest of those before them becomes a gap: it has their place, so that it is sent first, and says
how many were dropped since the webhook was made. A gap that grows is another message, under another
id: what a receiver has seen of it stays true, and a worker that is just sending the former one
marks nothing. Dead deliveries that are no longer kept are counted, too, and make no gap.

All is counted in `untold`, a row for each webhook and rotor.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Sequence
from typing import Any

from sqlalchemy import ColumnElement, Connection, delete, func, select, text, update

from service.hooks import GAP
from service.moments import moment
from service.store import hook_tables as t

WAITING = 1000  # deliveries of a webhook and rotor that may wait, the newest
d, u = t.delivery.c, t.untold.c
_ADD = text(
    "INSERT INTO untold (webhook_id, rotor_id, count, first_at, last_at)"
    " VALUES (:webhook_id, :rotor_id, :count, :first_at, :last_at)"
    " ON CONFLICT (webhook_id, rotor_id) DO UPDATE SET"
    " count = untold.count + excluded.count, last_at = excluded.last_at"
)


def message() -> str:
    """A new message's id."""
    return f"msg_{os.urandom(16).hex()}"


def written(kind: str, data: dict[str, object]) -> str:
    """A message's body."""
    told = {"type": kind, "timestamp": moment(time.time()), "data": data}
    return json.dumps(told, separators=(",", ":"), allow_nan=False)


def bound(connection: Connection, webhook_id: str, rotor_id: str) -> None:
    """Drop what waits beyond the newest `WAITING`, and leave a gap; the rotor is locked.

    So are they, for a worker may be noting just now that the oldest was sent: what it notes first
    is not dropped, and what is dropped first it marks no more.
    """
    own = (d.webhook_id == webhook_id) & (d.status == "pending") & (d.rotor_id == rotor_id)
    last = select(d.id).where(own).order_by(d.id.desc()).offset(WAITING).limit(1)
    number = connection.execute(last).scalar()
    if number is None:
        return
    if not (rows := locked(connection, own & (d.id <= number))) or rows[-1].id < number:
        return  # sent meanwhile
    first = rows[0]
    if (first.id, first.event) == (number, GAP):
        return  # nothing but the gap itself is older
    count_untold(connection, webhook_id, own & (d.id <= number) & (d.event != GAP))
    connection.execute(delete(t.delivery).where(own, d.id < number))
    row = connection.execute(
        select(t.untold).where(u.webhook_id == webhook_id, u.rotor_id == rotor_id)
    ).one()
    data = {"rotor": rotor_id, "dropped": row.count}
    data |= {"first": moment(row.first_at), "last": moment(row.last_at)}
    values = {"event": GAP, "message_id": message(), "body": written(GAP, data)}
    values |= {name: getattr(first, name) for name in ("attempts", "not_before", "tried_at")}
    gap = update(t.delivery).where(d.id == number)
    connection.execute(gap.values(**values, last_error=first.last_error))


def locked(connection: Connection, which: ColumnElement[bool]) -> Sequence[Any]:
    """The deliveries that a condition names, the oldest first, kept as they are by a lock."""
    columns = (d.id, d.event, d.attempts, d.not_before, d.tried_at, d.last_error)
    query = select(*columns).where(which).order_by(d.id)
    return connection.execute(query.with_for_update()).all()


def count_untold(connection: Connection, webhook_id: str, which: ColumnElement[bool]) -> None:
    """Add the deliveries that a condition names to what their webhook is not told."""
    query = select(d.rotor_id, func.count(), func.min(d.created_at), func.max(d.created_at)).where(
        which
    )
    for rotor_id, count, first, last in connection.execute(
        query.group_by(d.rotor_id).order_by(d.rotor_id)
    ).all():
        row = {"webhook_id": webhook_id, "rotor_id": rotor_id, "count": count}
        connection.execute(_ADD, row | {"first_at": first, "last_at": last})
