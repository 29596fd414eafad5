"""One new entry of the log in one statement, on PostgreSQL.

Nearly every post is one reading that is new. What `service.store.log` does for many in four
statements (lock the rotor's row, look whether the id is known, insert, move the head) is one here,
so that the lock is held for less, and a post costs less:

    head      the rotor's row, locked: its head as the last commit left it (not locked, whoever
              comes at the same time would find the number taken, and go the long way)
    new       the entry with the number after it, unless the id is there
    (moved)   the head moves to the entry's number

Whoever waited for the lock has a snapshot from before the wait. That is harmless here: a locked row
is read as it stands, not as it stood, an UPDATE follows it, and a conflict with an id is found in
the index. It would not be for a question to another table, so that the cursor, which a worker may
have moved meanwhile, is looked at by the statement after this one.
"""

from __future__ import annotations

from typing import Any

from sqlalchemy import Connection, Select, bindparam, select, update
from sqlalchemy.dialects.postgresql import insert

from service import tracing
from service.ports import NewEvent
from service.store import tables as t
from service.store.engine import now_s

GIVEN = (*NewEvent.__slots__, "posted_by", "traceparent")


def statement(*, locked: bool = True) -> Select[Any]:
    """Head of the rotor (None: it is not there) and number of the entry (None: its id is there)."""
    rotor = bindparam("rotor", type_=t.rotor.c.id.type)
    query = select(t.rotor.c.head_seq).where(t.rotor.c.id == rotor)
    head = (query.with_for_update() if locked else query).cte("head")
    given = {name: bindparam(f"new_{name}", type_=t.entry.c[name].type) for name in GIVEN}
    row = given | {
        "rotor_id": rotor,
        "seq": head.c.head_seq + 1,
        "received_at": now_s(),
    }
    put = insert(t.entry).from_select(list(row), select(*row.values())).on_conflict_do_nothing()
    new = put.returning(t.entry.c.rotor_id, t.entry.c.seq).cte("new")
    moved = update(t.rotor).where(t.rotor.c.id == new.c.rotor_id).values(head_seq=new.c.seq)
    found = select(
        select(head.c.head_seq).scalar_subquery(),
        select(new.c.seq).scalar_subquery(),
    )
    return found.add_cte(moved.cte("moved"))


ONE = statement()


def append_one(
    connection: Connection, rotor_id: str, event: NewEvent, posted_by: str | None
) -> tuple[int | None, int | None]:
    """The rotor's head before, and the number that an entry got; see `statement`.

    The rotor's row stays locked in either case.
    """
    own = {name: getattr(event, name) for name in NewEvent.__slots__}
    own |= {"posted_by": posted_by, "traceparent": tracing.current()}
    asked = {f"new_{name}": value for name, value in own.items()} | {"rotor": rotor_id}
    found = connection.execute(ONE, asked).one()
    return found[0], found[1]
