"""Versions of a rotor's posterior, read by name (written and thinned: `versions`).

Only an array whose SHA-256 changed is written, under the version that changed it. Reading name n
at version v takes the row with the greatest version <= v. Decoded arrays are cached by (rotor,
version, name, SHA-256), so that a read of one blade loads what that blade needs and no more.

A version is compared with its digest when a process first loads it (`service.store.intact`), and
each array with the SHA-256 that the digest was made from: what was damaged is never used.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from sqlalchemy import (
    Column,
    Connection,
    Select,
    bindparam,
    func,
    or_,
    select,
)

from core.errors import ModelError, RangeError
from service.errors import DamagedError, GoneError, NotFoundError, NotYetError
from service.moments import moment
from service.ports import Array, Get, StateRecord
from service.store import intact
from service.store import tables as t
from service.store.cache import ArrayCache, Checked, Key
from service.store.encoding import DamagedArrayError, Encoded, decode
from service.store.intact import Stored
from service.store.named import NEWEST_NAMES, digests, digests_since
from service.store.settled import end_of

NEWEST = (
    select(t.state.c.version, t.state.c.digest)
    .join(t.cursor, t.cursor.c.rotor_id == t.state.c.rotor_id)
    .where(t.state.c.rotor_id == bindparam("rotor"), t.state.c.version == t.cursor.c.version)
)


class SqlStates:
    """The `States` of one transaction.

    settled   until when it sees every entry of the rotor that it was opened for (`settled`)
    """

    def __init__(
        self, connection: Connection, cache: ArrayCache, checked: Checked, settled: float = 0.0
    ) -> None:
        self._connection = connection
        self._cache = cache
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
            now = moment(self._settled)
            problem = f"lies outside {moment(begun)} … {now}, the rotor's time till now"
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

    def reader(self, state: StateRecord) -> Get:
        """The arrays of a version by name, inside this transaction."""
        return lambda name: self.array((state.rotor_id, state.version, name))

    def array(self, key: Key, names: Mapping[str, str] | None = None) -> Array:
        """One array of one version, from the cache or the database.

        names   SHA-256 of each array that the version has, where the caller knows them
        """
        rotor_id, version, name = key
        names = self.names(rotor_id, version) if names is None else names
        array = self._cache.get((*key, names.get(name)))
        if array is None:
            array = self._decoded(key, self._row(key), names)
        return array

    def prefetch(self, rotor_id: str, version: int) -> None:
        """Take what every update looks at, the shared nodes and the blades' columns, at once."""
        asked, names = {"rotor": rotor_id, "version": version}, self.names(rotor_id, version)
        for name, *row in self._connection.execute(_SMALL, asked):
            key, one = (rotor_id, version, name), Encoded(*row)
            if one.dtype and self._cache.get((*key, one.sha256)) is None:
                self._decoded(key, one, names)

    def _decoded(self, key: Key, row: Encoded, names: Mapping[str, str]) -> Array:
        rotor_id, version, name = key
        sha256 = names.get(name)
        if sha256 != row.sha256:
            self.get(rotor_id, version)  # GoneError: it was thinned out, and an older row is left
            problem = f"its sha256 {row.sha256[:12]}… is not the one that the version has"
            raise DamagedError(rotor_id, version, f"array {name}", problem)
        try:
            array = decode(name, row)
        except DamagedArrayError as error:
            raise DamagedError(rotor_id, version, f"array {name}", str(error)) from None
        self._cache.put((*key, sha256), array)
        return array

    def names(self, rotor_id: str, version: int) -> Mapping[str, str]:
        """SHA-256 of each array that a version has; one that was not compared is compared now."""
        while (names := self._checked.get(rotor_id, version)) is None:
            self.get(rotor_id, version)
        return names

    def _row(self, key: Key) -> Encoded:
        rotor_id, version, name = key
        asked = {"rotor": rotor_id, "version": version, "name": name}
        row = self._connection.execute(_ARRAY, asked).one_or_none()
        if row is None or not row.dtype:
            self.get(rotor_id, version)  # GoneError: it was thinned out meanwhile
            raise ModelError(f"rotor {rotor_id}, version {version}: no array {name!r} is stored")
        return Encoded(**row._mapping)


_STORED = select(t.state, t.cursor.c.version.label("newest"), t.cursor.c.applied_seq).join(
    t.cursor, t.cursor.c.rotor_id == t.state.c.rotor_id
)
# What nearly every request asks: built and understood once.
_OWN = _STORED.where(t.state.c.rotor_id == bindparam("rotor"))
_LAST = _OWN.order_by(t.state.c.version.desc()).limit(1)
_ONE = _OWN.where(t.state.c.version == bindparam("version"))
_A = t.state_array.c
_BYTES = (_A.encoding, _A.dtype, _A.shape, _A.sha256, _A.data)
_UNTIL = (_A.rotor_id == bindparam("rotor"), _A.version <= bindparam("version"))
_ARRAY = (
    select(*_BYTES)
    .where(*_UNTIL, _A.name == bindparam("name"))
    .order_by(_A.version.desc())
    .limit(1)
)
_NEWEST_SMALL = NEWEST_NAMES.where(
    or_(_A.name.like("shared/%"), _A.name.like("column/%"))
).subquery()
_SMALL = select(_A.name, *_BYTES).where(
    _A.rotor_id == bindparam("rotor"),
    _A.name == _NEWEST_SMALL.c.name,
    _A.version == _NEWEST_SMALL.c.version,
)


def stored(rotor_id: str) -> Select[Any]:
    """The rotor's versions as they stand in the table, each with where the cursor is."""
    return _STORED.where(t.state.c.rotor_id == rotor_id)


def record_of(row: Stored) -> StateRecord:
    """A row of `stored`, compared before."""
    values = {name: getattr(row, name) for name in t.state.c.keys()}  # noqa: SIM118
    return StateRecord(**values | {"meta": json.loads(row.meta)})
