"""Arrays of the versions of a rotor's posterior, read by name (written and thinned: `versions`).

Only an array whose SHA-256 changed is written, under the version that changed it. Reading name n
at version v takes the row with the greatest version <= v. Decoded arrays are cached by (rotor,
version, name, SHA-256), so that a read of one blade loads what that blade needs and no more. Each
array is compared with the SHA-256 that the version's digest was made from (`kept`): what
was damaged is never used.
"""

from __future__ import annotations

from collections.abc import Mapping

from sqlalchemy import Connection, bindparam, or_, select

from core.errors import ModelError
from service.errors import DamagedError
from service.ports import Array, Get, StateRecord
from service.store import tables as t
from service.store.cache import ArrayCache, Checked, Key
from service.store.encoding import DamagedArrayError, Encoded, decode
from service.store.kept import KeptVersions
from service.store.named import NEWEST_NAMES

# What nearly every request asks: built and understood once.
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


class SqlStates(KeptVersions):
    """The `States` of one transaction: versions, and their arrays.

    settled   until when it sees every entry of the rotor that it was opened for (`settled`)
    """

    def __init__(
        self, connection: Connection, cache: ArrayCache, checked: Checked, settled: float = 0.0
    ) -> None:
        super().__init__(connection, checked, settled)
        self._cache = cache

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
