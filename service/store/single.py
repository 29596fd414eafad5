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
the index. It would not be for a question to another table that changes: the cursor, which a worker
may have moved meanwhile, is looked at by the statement after this one. That a blade is there does
not change, so a reading that was checked by what the process knows of its rotor
(`service.store.met`) is held against the database here: model and blade are conditions.
"""

from __future__ import annotations

from typing import Any

from sqlalchemy import Connection, Select, bindparam, exists, select, update
from sqlalchemy.dialects.postgresql import insert

from service import tracing
from service.ports import ModelCard, NewEvent
from service.store import tables as t
from service.store.engine import now_s

GIVEN = (*NewEvent.__slots__, "posted_by", "traceparent")


def statement(*, checked: bool) -> Select[Any]:
    """Head of the rotor (None: it is not there) and number of the entry (None: its id is there).

    checked   None, too, where the rotor has another model or has not the entry's blade
    """
    rotor = bindparam("rotor", type_=t.rotor.c.id.type)
    of = t.rotor.c
    own = select(of.head_seq).where(of.id == rotor)
    if checked:
        own = own.where(of.model_id == bindparam("model"), of.model_version == bindparam("version"))
    head = own.with_for_update().cte("head")
    given = {name: bindparam(f"new_{name}", type_=t.entry.c[name].type) for name in GIVEN}
    row = given | {
        "rotor_id": rotor,
        "seq": head.c.head_seq + 1,
        "received_at": now_s(),
    }
    values = select(*row.values())
    if checked:
        blade = (t.blade.c.rotor_id == rotor, t.blade.c.id == given["blade"])
        values = values.where(exists().where(*blade))
    put = insert(t.entry).from_select(list(row), values).on_conflict_do_nothing()
    new = put.returning(t.entry.c.rotor_id, t.entry.c.seq).cte("new")
    moved = update(t.rotor).where(t.rotor.c.id == new.c.rotor_id).values(head_seq=new.c.seq)
    found = select(
        select(head.c.head_seq).scalar_subquery(),
        select(new.c.seq).scalar_subquery(),
    )
    return found.add_cte(moved.cte("moved"))


ONE, CHECKED = statement(checked=False), statement(checked=True)


def append_one(
    connection: Connection,
    rotor_id: str,
    event: NewEvent,
    posted_by: str | None,
    card: ModelCard | None = None,
) -> tuple[int | None, int | None]:
    """The rotor's head before, and the number that an entry got; see `statement`.

    The rotor's row stays locked in either case.

    card   of the rotor's model, by which the entry was checked; None: it needs no check
    """
    own = {name: getattr(event, name) for name in NewEvent.__slots__}
    own |= {"posted_by": posted_by, "traceparent": tracing.current()}
    asked = {f"new_{name}": value for name, value in own.items()} | {"rotor": rotor_id}
    if card is None:
        found = connection.execute(ONE, asked).one()
    else:
        of = {"model": card.id, "version": card.version}
        found = connection.execute(CHECKED, asked | of).one()
    return found[0], found[1]
