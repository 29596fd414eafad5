"""A version of a posterior is written, with the arrays that it changed; old ones are thinned.

Versions beyond the newest ones are thinned to checkpoints, the fewer the older they are. Their
numbers are cut into blocks of `every`; two neighbours become one block of twice the size as soon as
they lie as far back as both are long, and so on. Of each block the last sealed version
stays, or the last one where none is sealed: of n versions at most two for each doubling of
n / `every`. A block that two became keeps one of those that they kept, so that what was dropped is
never missed, however often and whenever it is thinned.
"""

from __future__ import annotations

import json
from bisect import bisect_left
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from itertools import pairwise
from typing import Any

from sqlalchemy import (
    Connection,
    Engine,
    bindparam,
    delete,
    func,
    insert,
    select,
    tuple_,
)

from service.ports import StateRecord
from service.store import tables as t
from service.store.encoding import Encoded
from service.store.engine import is_sqlite, now_s, transaction

ENDED = Encoded("npy", "", "", "", b"")
MOST = 500  # versions that one transaction drops: rows without arrays
# Rows of arrays that one transaction drops, by whether it is SQLite's, where all writers wait.
CHUNK = {True: 8, False: 200}
_OWN = t.state_array.c.rotor_id == bindparam("rotor")
_WRITTEN = (
    select(t.state_array.c.name, t.state_array.c.version)
    .where(_OWN)
    .order_by(t.state_array.c.name, t.state_array.c.version)
)
_KEPT = (
    select(t.state.c.version)
    .where(t.state.c.rotor_id == bindparam("rotor"))
    .order_by(t.state.c.version)
)
# Of every commit: built and understood once. Keys are given, so that nobody asks for them.
_STATE = insert(t.state).values(created_at=now_s()).inline()
_ARRAYS = insert(t.state_array)


def write_state(
    connection: Connection, record: StateRecord, changed: Mapping[str, Encoded | None]
) -> None:
    """Write a version and the arrays that changed since the one before; None: the name ended."""
    values = _columns(record) | {"meta": json.dumps(record.meta)}
    del values["created_at"]
    connection.execute(_STATE, values)
    key = {"rotor_id": record.rotor_id, "version": record.version}
    rows = [key | {"name": name} | _columns(e or ENDED) for name, e in changed.items()]
    if rows:
        connection.execute(_ARRAYS, rows)


def _columns(record: StateRecord | Encoded) -> dict[str, Any]:
    """A record's values by name. (`asdict` would copy a rotor's whole account, 5 ms.)"""
    return {field.name: getattr(record, field.name) for field in fields(record)}


def block(version: int, last: int, every: int) -> tuple[int, int]:
    """(number, size) of the block that a version is in, where `last` is the newest to be thinned.

    >>> [block(version, 40, 4) for version in (1, 20, 21, 32, 33, 40)]
    [(0, 16), (2, 8), (2, 8), (3, 8), (8, 4), (9, 4)]
    """
    number, size, now = (version - 1) // every, 1, (last - 1) // every
    while now - (number | 1) * size - (size - 1) >= 2 * size:
        number, size = number // 2, 2 * size
    return number, size * every


def dropped(versions: Iterable[tuple[int, bool]], last: int, every: int) -> list[int]:
    """Of (version, sealed) in order, none newer than `last`, those that are no checkpoint."""
    kept: dict[tuple[int, int], tuple[int, bool]] = {}
    gone = []
    for version, sealed in versions:
        place = block(version, last, every)
        before = kept.get(place)
        if before is not None and before[1] and not sealed:
            gone.append(version)
            continue
        if before is not None:
            gone.append(before[0])
        kept[place] = version, sealed
    return gone


def thin(engine: Engine, rotor_id: str, keep: int, every: int, chunk: int | None = None) -> int:
    """Keep the `keep` newest versions and checkpoints of older ones; drop what only others used.

    Rows of arrays go in short transactions of `chunk` (None: `CHUNK`), so that no writer waits
    long; a thinning that is cut goes on with the next. The log is never deleted. Returns the number
    of rows dropped.
    """
    most = CHUNK[is_sqlite(engine)] if chunk is None else chunk
    row, own = t.state_array, t.state.c.rotor_id == rotor_id
    newest = select(func.max(t.state.c.version)).where(own)
    with transaction(engine, write=False) as connection:
        last = (connection.execute(newest).scalar() or 0) - keep
        old = select(t.state.c.version, t.state.c.sealed).where(own, t.state.c.version <= last)
        rows = connection.execute(old.order_by(t.state.c.version)).all()
    gone = dropped(((row.version, row.sealed) for row in rows), last, every)
    for first in range(0, len(gone), MOST):
        these = t.state.c.version.in_(gone[first : first + MOST])
        with transaction(engine, write=True) as connection:
            connection.execute(delete(t.state).where(own, these))
    with transaction(engine, write=False) as connection:
        # In this order: the row of a version that is written in between is not seen, so that what
        # it replaces stays.
        written = connection.execute(_WRITTEN, {"rotor": rotor_id}).all()
        kept = list(connection.execute(_KEPT, {"rotor": rotor_id}).scalars())
    doomed = unneeded([(row.name, row.version) for row in written], kept)
    for first in range(0, len(doomed), most):
        keys = tuple_(row.c.name, row.c.version).in_(doomed[first : first + most])
        with transaction(engine, write=True) as connection:
            connection.execute(delete(row).where(row.c.rotor_id == rotor_id, keys))
    return len(doomed)


def unneeded(written: Sequence[tuple[str, int]], kept: Sequence[int]) -> list[tuple[str, int]]:
    """Rows of arrays, (name, version) in order, that no kept version needs; both rise.

    A row of version a, replaced at version b, is needed while a kept version lies in a … b-1; one
    that nothing replaces always is.

    >>> unneeded([("x", 1), ("x", 3), ("x", 4), ("y", 2)], [2, 4, 5])
    [('x', 3)]
    """
    found = []
    for (name, version), (later, replaced) in pairwise(written):
        if name == later:
            first = bisect_left(kept, version)
            if first == len(kept) or kept[first] >= replaced:
                found.append((name, version))
    return found
