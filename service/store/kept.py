"""Versions of a rotor's posterior that are kept: the newest, one by number, one as of a moment.

A version is compared with its digest when a process first loads it (`service.store.intact`), from
the SHA-256 of each of its arrays (`service.store.states` reads those): what was damaged is never
used. As of a moment t the version is the newest one that rests on exactly the entries received by
t. One that is not kept any more is gone, and the nearest ones before and after it are told.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

from sqlalchemy import (
    Column,
    Connection,
    Select,
    bindparam,
    func,
    select,
)

from core.errors import RangeError
from service.errors import DamagedError, GoneError, NotFoundError, NotYetError
from service.moments import moment
from service.ports import Json, StateRecord
from service.store import intact
from service.store import tables as t
from service.store.cache import Checked
from service.store.engine import now_s
from service.store.intact import Stored
from service.store.named import digests, digests_since
from service.store.settled import end_of

NEWEST = (
    select(t.state.c.version, t.state.c.digest)
    .join(t.cursor, t.cursor.c.rotor_id == t.state.c.rotor_id)
    .where(t.state.c.rotor_id == bindparam("rotor"), t.state.c.version == t.cursor.c.version)
)


class KeptVersions:
    """The versions that one transaction sees, each without its arrays.

    settled   until when it sees every entry of the rotor that it was opened for (`settled`)
    """

    def __init__(self, connection: Connection, checked: Checked, settled: float) -> None:
        self._connection = connection
        self._checked = checked
        self._settled = settled

    def get(self, rotor_id: str, version: int | None = None) -> StateRecord:
        """The newest version, or the one asked for; DamagedError: it is not what was written."""
        asked = {"rotor": rotor_id}
        if version is None:
            row = self._connection.execute(_LAST, asked).first()
        else:
            row = self._connection.execute(_ONE, asked | {"version": version}).first()
        if row is not None and version is None and row.version < row.newest:
            row = None
        if row is not None and (found := self._record(row)) is not None:
            return found
        newest = select(t.cursor.c.version).where(t.cursor.c.rotor_id == rotor_id)
        last = self._connection.execute(newest).scalar()
        if last and version in (None, last):
            raise DamagedError(rotor_id, last, "state", "its row is missing")
        if last is None:
            raise NotFoundError("rotor", rotor_id, "POST /v1/rotors creates it")
        if version is None or last == 0:
            raise NotYetError(
                f"the posterior of rotor {rotor_id}",
                f"wait for it with GET /v1/rotors/{rotor_id}?wait_for=0&timeout=30",
            )
        if 1 <= version <= last:
            near = self._nearest(rotor_id, t.state.c.version, version)
            raise GoneError(f"version {version} of rotor {rotor_id}", "version", version, near)
        raise NotFoundError("version", str(version), f"the newest one is {last}")

    def given(self, rotor_id: str, row: Stored, version: int | None = None) -> StateRecord:
        """As `get`, where the row with the greatest version was read before. Where that one is not
        the answer it is asked for, which tells why."""
        there = row.version is not None
        fits = there and (row.version >= row.newest if version is None else row.version == version)
        found = self._record(row) if fits else None
        return self.get(rotor_id, version) if found is None else found

    def newest(self, rotor_id: str) -> tuple[int, str] | None:
        """Number and digest of the newest version; None: none yet, or its row is missing."""
        row = self._connection.execute(NEWEST, {"rotor": rotor_id}).one_or_none()
        return None if row is None else (row.version, row.digest)

    def standing(self, rotor_ids: Sequence[str]) -> dict[str, tuple[bool, Json]]:
        """Of the newest version of each rotor whether it is sealed, and what its account says of
        itself; compared with nothing, and left out where it cannot be read."""
        found = {}
        for row in self._connection.execute(_STANDING, {"ids": list(rotor_ids)}):
            with suppress(ValueError):
                found[row.rotor_id] = (row.sealed, json.loads(row.meta))
        return found

    def page(self, rotor_id: str, before: int | None, limit: int) -> list[StateRecord]:
        """Versions that are kept, the newest first, below a number."""
        query = stored(rotor_id).order_by(t.state.c.version.desc()).limit(limit)
        if before is not None:
            query = query.where(t.state.c.version < before)
        found = [self._record(row) for row in self._connection.execute(query).all()]
        return [record for record in found if record is not None]

    def as_of(self, rotor_id: str, at: float) -> StateRecord:
        """The newest version that rests on exactly the entries received by a moment.

        at   seconds since 1970, as the log's `received_at`; told to the millisecond, so that an
             entry of that very millisecond counts
        In a transaction of `SqlStore.read_as_of`; in another one every moment is in the future.
        Raises RangeError for a moment before the rotor or in the future, NotYetError where it is
        still to be computed, GoneError with the nearest versions where it is not kept.
        """
        through, applied = self._received_by(rotor_id, at)
        query = select(func.max(t.state.c.version)).where(
            t.state.c.rotor_id == rotor_id, t.state.c.through_seq == through
        )
        version = self._connection.execute(query).scalar()
        if version is not None:
            return self.get(rotor_id, version)
        if through > applied:
            raise NotYetError(
                f"the posterior of rotor {rotor_id} through entry {through}",
                f"wait for it with GET /v1/rotors/{rotor_id}?wait_for={through}&timeout=30",
            )
        what = f"a version of rotor {rotor_id} that ends with entry {through}, as of then,"
        near = self._nearest(rotor_id, t.state.c.through_seq, through)
        raise GoneError(what, "at", moment(at), near)

    def _received_by(self, rotor_id: str, at: float) -> tuple[int, int]:
        """(the last of the entries that all came by a moment, the cursor; -1: to be computed)."""
        end = end_of(at)
        c, e = t.cursor.c, t.entry.c
        rotor = select(t.rotor.c.head_seq, t.rotor.c.created_at, c.applied_seq, c.version)
        row = self._connection.execute(
            rotor.join(t.cursor, c.rotor_id == t.rotor.c.id).where(t.rotor.c.id == rotor_id)
        ).one_or_none()
        if row is None:
            raise NotFoundError("rotor", rotor_id, "POST /v1/rotors creates it")
        times = select(func.min(e.received_at)).where(e.rotor_id == rotor_id)
        first = self._connection.execute(times).scalar()
        begun = row.created_at if first is None else min(row.created_at, first)
        if not (begun < end and at <= self._settled):
            now = max(self._settled, self._connection.execute(select(now_s())).scalar_one())
            problem = f"lies outside {moment(begun)} … {moment(now)}, the rotor's time till now"
            raise RangeError("at", moment(at), problem, "ask for a moment inside, or leave it out")
        later = select(func.min(e.seq)).where(e.rotor_id == rotor_id, e.received_at >= end)
        after = self._connection.execute(later).scalar()
        through = row.head_seq if after is None else after - 1
        none_yet = not row.version and through == row.head_seq
        return through, -1 if none_yet else row.applied_seq

    def _nearest(
        self, rotor_id: str, column: Column[Any], value: int
    ) -> tuple[tuple[int, int], ...]:
        """(version, through_seq) of the kept versions next to a value, before it and after it."""
        s = t.state.c
        query = select(s.version, s.through_seq).where(s.rotor_id == rotor_id).limit(1)
        before = query.where(column < value).order_by(s.version.desc())
        after = query.where(column > value).order_by(s.version)
        rows = [self._connection.execute(one).one_or_none() for one in (before, after)]
        return tuple((row.version, row.through_seq) for row in rows if row is not None)

    def _record(self, row: Stored) -> StateRecord | None:
        """The version, compared with its digest; None: it was thinned out meanwhile."""
        told = intact.told(row)
        if self._checked.get(row.rotor_id, row.version, told) is None:
            names = self._names(row)
            try:
                intact.check(row, names)
            except DamagedError:
                again = stored(row.rotor_id).where(t.state.c.version == row.version)
                if self._connection.execute(again).first() is None:
                    return None
                raise
            self._checked.put(row.rotor_id, row.version, told, names)
        return record_of(row)

    def _names(self, row: Stored) -> Mapping[str, str]:
        """SHA-256 of each array of a version: as after the last version that was compared, if that
        gives its digest, else of all of them."""
        last = self._checked.last(row.rotor_id)
        if last is not None and last[0] < row.version:
            names = digests_since(self._connection, row.rotor_id, row.version, *last)
            if not intact.problems(row, names):
                return names
        return digests(self._connection, row.rotor_id, row.version)


_STORED = select(t.state, t.cursor.c.version.label("newest"), t.cursor.c.applied_seq).join(
    t.cursor, t.cursor.c.rotor_id == t.state.c.rotor_id
)
# What nearly every request asks: built and understood once.
_OWN = _STORED.where(t.state.c.rotor_id == bindparam("rotor"))
_LAST = _OWN.order_by(t.state.c.version.desc()).limit(1)
_ONE = _OWN.where(t.state.c.version == bindparam("version"))
_STANDING = (
    select(t.state.c.rotor_id, t.state.c.sealed, t.state.c.meta)
    .join(t.cursor, t.cursor.c.rotor_id == t.state.c.rotor_id)
    .where(
        t.state.c.version == t.cursor.c.version,
        t.state.c.rotor_id.in_(bindparam("ids", expanding=True)),
    )
)


def stored(rotor_id: str) -> Select[Any]:
    """The rotor's versions as they stand in the table, each with where the cursor is."""
    return _STORED.where(t.state.c.rotor_id == rotor_id)


def record_of(row: Stored) -> StateRecord:
    """A row of `stored`, compared before."""
    values = {name: getattr(row, name) for name in t.state.c.keys()}  # noqa: SIM118
    return StateRecord(**values | {"meta": json.loads(row.meta)})
