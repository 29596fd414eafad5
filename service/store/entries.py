"""The entries of a rotor's log as they are read: in order, or page by page."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, Select, bindparam, select, union_all

from service.adopted import KINDS
from service.ports import Event
from service.store import tables as t
from service.store.parts import without_long

COLUMNS = [c for c in t.entry.c if c.name not in ("rotor_id", "traceparent")]
NAMES = [column.name for column in COLUMNS]
_BETWEEN = (
    select(*COLUMNS)
    .where(
        t.entry.c.rotor_id == bindparam("rotor"),
        t.entry.c.seq > bindparam("after"),
        t.entry.c.seq <= bindparam("through"),
    )
    .order_by(t.entry.c.seq)
)
_SOME_BETWEEN = _BETWEEN.limit(bindparam("most"))
# Of each kind by itself: asked for several kinds in the order of their numbers, SQLite goes through
# the rotor's whole log.
CHANGES = (
    union_all(
        *(
            select(*COLUMNS).where(
                t.entry.c.rotor_id == bindparam("rotor"),
                t.entry.c.kind == kind,
                t.entry.c.seq > bindparam("after"),
            )
            for kind in KINDS
        )
    )
    .order_by("seq")
    .limit(bindparam("most"))
)


@lru_cache(maxsize=64)
def page_query(after: bool, blade: bool, newest: bool, most_values: int | None) -> Select[Any]:
    """The query of `SqlLog.page`: whether a number and a blade are given, and the rest of it."""
    seq, columns = t.entry.c.seq, list[ColumnElement[Any]](COLUMNS)
    if most_values is not None:
        short = without_long(t.entry.c.body, most_values).label("body")
        columns = [short if column.name == "body" else column for column in COLUMNS]
    query = select(*columns).where(
        t.entry.c.rotor_id == bindparam("rotor"), t.entry.c.kind == bindparam("kind")
    )
    if after:
        query = query.where(seq < bindparam("after") if newest else seq > bindparam("after"))
    if blade:
        query = query.where(t.entry.c.blade == bindparam("blade"))
    return query.order_by(seq.desc() if newest else seq).limit(bindparam("most"))


def read_entries(
    connection: Connection, rotor_id: str, after: int, through: int, limit: int | None = None
) -> list[Event]:
    """The entries with after < seq <= through, in order; at most `limit` of them."""
    asked: dict[str, object] = {"rotor": rotor_id, "after": after, "through": through}
    if limit is None:
        rows = connection.execute(_BETWEEN, asked)
    else:
        rows = connection.execute(_SOME_BETWEEN, asked | {"most": limit})
    return events_of(rows)


def events_of(rows: Iterable[Row[Any]]) -> list[Event]:
    """Entries of rows of `COLUMNS`."""
    return [Event(**dict(zip(NAMES, row, strict=True))) for row in rows]
