"""A version of a posterior is written, with the arrays that it changed; old ones are thinned."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from sqlalchemy import (
    Connection,
    Engine,
    delete,
    exists,
    func,
    insert,
    select,
    tuple_,
)

from service.ports import StateRecord
from service.store import tables as t
from service.store.encoding import Encoded
from service.store.engine import now_s, transaction

ENDED = Encoded("npy", "", "", "", b"")


def write_state(
    connection: Connection, record: StateRecord, changed: Mapping[str, Encoded | None]
) -> None:
    """Write a version and the arrays that changed since the one before; None: the name ended."""
    values = _columns(record) | {"meta": json.dumps(record.meta), "created_at": now_s()}
    connection.execute(insert(t.state).values(values))
    key = {"rotor_id": record.rotor_id, "version": record.version}
    rows = [key | {"name": name} | _columns(e or ENDED) for name, e in changed.items()]
    if rows:
        connection.execute(insert(t.state_array), rows)


def _columns(record: StateRecord | Encoded) -> dict[str, Any]:
    """A record's values by name. (`asdict` would copy a rotor's whole account, 5 ms.)"""
    return {field.name: getattr(record, field.name) for field in fields(record)}


def thin(engine: Engine, rotor_id: str, keep: int, every: int, chunk: int = 8) -> int:
    """Keep the `keep` newest versions and every `every`-th older one; drop what only others used.

    An array row of version a, replaced at version b, is needed while a kept version lies in
    a … b-1. Rows go in short transactions of `chunk`, so that no writer waits long; a thinning that
    is cut goes on with the next. The log is never deleted. Returns the number of rows dropped.
    """
    row = t.state_array
    later = row.alias("later")
    replaced_at = (
        select(func.min(later.c.version))
        .where(
            later.c.rotor_id == row.c.rotor_id,
            later.c.name == row.c.name,
            later.c.version > row.c.version,
        )
        .correlate(row)
        .scalar_subquery()
    )
    needed = exists().where(
        t.state.c.rotor_id == row.c.rotor_id,
        t.state.c.version >= row.c.version,
        t.state.c.version < replaced_at,
    )
    unneeded = select(row.c.name, row.c.version).where(
        row.c.rotor_id == rotor_id, replaced_at.is_not(None), ~needed
    )
    newest = select(func.max(t.state.c.version)).where(t.state.c.rotor_id == rotor_id)
    old = (t.state.c.rotor_id == rotor_id) & (t.state.c.version % every != 0)
    with transaction(engine, write=True) as connection:
        last = connection.execute(newest).scalar() or 0
        connection.execute(delete(t.state).where(old, t.state.c.version <= last - keep))
    with transaction(engine, write=False) as connection:
        doomed = [(r.name, r.version) for r in connection.execute(unneeded)]
    for first in range(0, len(doomed), chunk):
        keys = tuple_(row.c.name, row.c.version).in_(doomed[first : first + chunk])
        with transaction(engine, write=True) as connection:
            connection.execute(delete(row).where(row.c.rotor_id == rotor_id, keys))
    return len(doomed)
