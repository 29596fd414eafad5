"""What commits to a rotor's log and to its cursor have in common.

They begin with the rotor's row, locked, so that they come one after the other, and number what they
write in the order in which it is seen. At the end they wake who waits: workers for work, requests
for a version. PostgreSQL tells its listeners; of SQLite they watch the file.
"""

from __future__ import annotations

from typing import Any

from sqlalchemy import ColumnElement, Connection, Select, Text, bindparam, select
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.functions import FunctionElement

from service.store import tables as t


def locked_head(rotor_id: ColumnElement[str] | str) -> Select[str, int]:
    """The rotor's row, locked until the end of the transaction: its id and head_seq."""
    own = select(t.rotor.c.id, t.rotor.c.head_seq).where(t.rotor.c.id == rotor_id)
    return own.with_for_update()


_HEAD = locked_head(bindparam("rotor")).with_only_columns(t.rotor.c.head_seq)


def lock_rotor(connection: Connection, rotor_id: str) -> int | None:
    """Lock the rotor's row until the end of the transaction; its head_seq."""
    return connection.execute(_HEAD, {"rotor": rotor_id}).scalar()


class notified(FunctionElement[str]):
    """Listeners of a channel are woken at the commit with a payload; SQLite's watch the file."""

    type = Text()
    inherit_cache = True


@compiles(notified, "sqlite")
def _not_notified(element: Any, compiler: Any, **kw: Any) -> str:
    return "NULL"


@compiles(notified, "postgresql")
def _notified(element: Any, compiler: Any, **kw: Any) -> str:
    return f"pg_notify({compiler.process(element.clauses, **kw)})"


_NOTIFY = select(notified(bindparam("channel", type_=Text()), bindparam("payload", type_=Text())))


def notify(connection: Connection, channel: str, payload: str = "") -> None:
    """Wake listeners at the commit (PostgreSQL; SQLite's readers watch the file)."""
    if connection.dialect.name == "postgresql":
        connection.execute(_NOTIFY, {"channel": channel, "payload": payload})
