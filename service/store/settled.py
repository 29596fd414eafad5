"""When what a rotor had received by a moment can no longer change, and who writes has ended.

An entry gets its time (`received_at`) under the lock of its rotor's row, and is seen when its
transaction is committed. Between the two, a read as of a moment just past would not count it, and
the same read a moment later would. So such a read first waits for whoever holds the lock:
whoever takes it afterwards gets a later time.

Where a later entry than the moment is there already, nobody is waited for: entries are committed in
the order of their numbers, and one that comes now has a greater number than that one.

`ended` waits for transactions in general: one that looked for webhooks before a new one was there,
and commits after it, would tell it nothing.
"""

from __future__ import annotations

import math
import time

from sqlalchemy import Engine, bindparam, select, text

from service.store import tables as t
from service.store.engine import is_sqlite, now_s, transaction

_LAST = (
    select(t.entry.c.received_at)
    .where(t.entry.c.rotor_id == bindparam("rotor"))
    .order_by(t.entry.c.seq.desc())
    .limit(1)
)
# PostgreSQL may look at the clock before it waits for the row: a time too early, which is safe.
_WAIT = select(now_s()).where(t.rotor.c.id == bindparam("rotor")).with_for_update(read=True)
# The oldest transaction that writes, and the first that has not begun to.
_WRITING = text(
    "SELECT pg_snapshot_xmin(now)::text::bigint, pg_snapshot_xmax(now)::text::bigint"
    " FROM pg_current_snapshot() AS now"
)
LOOK_S = 0.005


def end_of(at: float) -> float:
    """The end of a moment's millisecond: what is received before it was received by then.

    >>> end_of(1.25), end_of(1.2504)
    (1.251, 1.251)
    """
    return (math.floor(1000.0 * at + 1e-3) + 1) / 1000.0


def settled(engine: Engine, rotor_id: str, at: float) -> float:
    """Until when the entries that a rotor has received are committed, each of them.

    At least to the end of the moment's millisecond, which is waited for; less for a moment in the
    future. On PostgreSQL it waits for the rotor's row, on SQLite for the writer, and keeps neither.
    """
    end, asked = end_of(at), {"rotor": rotor_id}
    with transaction(engine, write=False) as connection:
        last = connection.execute(_LAST, asked).scalar()
    if last is not None and last >= end:
        return end
    while True:
        with transaction(engine, write=True) as connection:
            now = connection.execute(_WAIT, asked).scalar()
            connection.rollback()  # a commit would wait for the disk, of a lock
        if now is None or now < at or now >= end:
            return now or 0.0
        time.sleep(end - now)


def ended(engine: Engine, patience_s: float) -> bool:
    """Whether all that were writing when it was called have committed or given up, in time.

    On SQLite they have when one's own transaction begins. On PostgreSQL no lock is asked for, since
    others would queue behind it; one that stops is not waited for longer than `patience_s`.
    """
    if is_sqlite(engine):
        return True
    end, first = time.monotonic() + patience_s, None
    while True:
        with transaction(engine, write=False) as connection:
            oldest, coming = connection.execute(_WRITING).one()
        first = coming if first is None else first
        if oldest >= first:
            return True
        if time.monotonic() >= end:
            return False
        time.sleep(LOOK_S)
