"""What one process keeps of the database: decoded arrays, and what it has compared with digests."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from operator import is_
from typing import NamedTuple

from service.ports import Array, BladeRecord, Json, Policy, RotorRecord

Key = tuple[str, int, str]
Kept = tuple[str, int, str, str | None]  # and the SHA-256 that it has in this version
MOST_CHECKED = 512
MOST_SOUND = 256  # rotors; of a hundred blades, some 50 kB each
VERSIONS = 3
OVERHEAD = 664  # bytes of an array's objects, head and key beside its numbers, measured


class ArrayCache:
    """Decoded arrays of a few versions of each rotor; safe between threads.

    Of a rotor the `VERSIONS` that were used last are kept: a rotor that is read while it is updated
    leaves versions behind that nobody asks for again. Above `limit_mb` the arrays that were used
    the longest ago go. Each counts with what Python needs to hold it: of small arrays that is
    nearly all.
    """

    def __init__(self, limit_mb: float) -> None:
        self._limit = int(limit_mb * 2**20)
        self._size = 0
        self._arrays: OrderedDict[Kept, Array] = OrderedDict()
        self._versions: dict[str, OrderedDict[int, set[Kept]]] = {}
        self._lock = threading.Lock()

    def get(self, key: Kept) -> Array | None:
        with self._lock:
            if key in self._arrays:
                self._arrays.move_to_end(key)
                self._versions[key[0]].move_to_end(key[1])
            return self._arrays.get(key)

    def put(self, key: Kept, array: Array) -> None:
        with self._lock:
            if key in self._arrays or array.nbytes + OVERHEAD > self._limit:
                return
            self._arrays[key] = array
            self._size += array.nbytes + OVERHEAD
            versions = self._versions.setdefault(key[0], OrderedDict())
            versions.setdefault(key[1], set()).add(key)
            versions.move_to_end(key[1])
            if len(versions) > VERSIONS:
                for old in list(next(iter(versions.values()))):
                    self._drop(old)
            while self._size > self._limit:
                self._drop(next(iter(self._arrays)))

    def _drop(self, key: Kept) -> None:
        self._size -= self._arrays.pop(key).nbytes + OVERHEAD
        versions = self._versions[key[0]]
        versions[key[1]].discard(key)
        if not versions[key[1]]:
            del versions[key[1]]
        if not versions:
            del self._versions[key[0]]

    def __len__(self) -> int:
        return len(self._arrays)


class Checked:
    """Versions whose digest was compared: (rotor, version) -> what was read, SHA-256 by array.

    A version whose row reads differently from what was compared is compared again.
    """

    def __init__(self) -> None:
        self._found: OrderedDict[tuple[str, int], tuple[str, Mapping[str, str]]] = OrderedDict()
        self._last = dict[str, int]()
        self._lock = threading.Lock()

    def get(self, rotor_id: str, version: int, told: str | None = None) -> Mapping[str, str] | None:
        """SHA-256 of each array, where the version was compared (with this very row)."""
        with self._lock:
            known = self._found.get((rotor_id, version))
            if known is not None:
                self._found.move_to_end((rotor_id, version))
        return known[1] if known is not None and told in (None, known[0]) else None

    def put(self, rotor_id: str, version: int, told: str, names: Mapping[str, str]) -> None:
        with self._lock:
            self._found[rotor_id, version] = (told, names)
            self._found.move_to_end((rotor_id, version))
            self._last[rotor_id] = max(version, self._last.get(rotor_id, version))
            while len(self._found) > MOST_CHECKED:
                (rotor, dropped), _ = self._found.popitem(last=False)
                if self._last.get(rotor) == dropped:
                    del self._last[rotor]

    def last(self, rotor_id: str) -> tuple[int, Mapping[str, str]] | None:
        """The greatest version of a rotor that was compared, and SHA-256 of each of its arrays."""
        with self._lock:
            version = self._last.get(rotor_id)
            return None if version is None else (version, self._found[rotor_id, version][1])


class Asked(NamedTuple):
    """What a rotor's digests were made from beside its blades, and the digests."""

    model_id: str
    particles: int
    seed: int
    network: Json | None
    adopt: str
    diagnose: str
    digest: str
    policy: Policy | None

    @staticmethod
    def of(rotor: RotorRecord) -> Asked:
        return Asked(*(getattr(rotor, name) for name in Asked._fields))


class Sound:
    """Rotors and blades whose rows were compared with their digests and the log, as they read then.

    Who reads a row that is equal to one of these has a sound one, as long as no entry of the log
    moved a blade since; any other is to be compared.
    """

    def __init__(self) -> None:
        self._found: OrderedDict[str, tuple[Asked, int, dict[str, BladeRecord]]] = OrderedDict()
        self._lock = threading.Lock()

    def knows(
        self, rotor: RotorRecord, moves: int, name: str | None, blade: BladeRecord | None
    ) -> bool:
        """Whether the rotor's row, and that of the blade, if one is named, read as they did.

        moves   entries of its log by which blades joined or left
        """
        *known, blades = self._get(rotor.id)
        return known == [Asked.of(rotor), moves] and (name is None or blades.get(name) == blade)

    def knows_all(self, rotor: RotorRecord, moves: int, blades: Sequence[BladeRecord]) -> bool:
        """The same of all blades, of which none is missing."""
        *known, there = self._get(rotor.id)
        same = len(there) == len(blades) and all(there.get(b.id) == b for b in blades)
        return known == [Asked.of(rotor), moves] and same

    def put(self, rotor: RotorRecord, moves: int, blades: Sequence[BladeRecord]) -> None:
        with self._lock:
            self._found[rotor.id] = Asked.of(rotor), moves, {blade.id: blade for blade in blades}
            self._found.move_to_end(rotor.id)
            while len(self._found) > MOST_SOUND:
                self._found.popitem(last=False)

    def _get(self, rotor_id: str) -> tuple[Asked | None, int, Mapping[str, BladeRecord]]:
        with self._lock:
            if rotor_id in self._found:
                self._found.move_to_end(rotor_id)
            return self._found.get(rotor_id, (None, 0, {}))


class Compared:
    """Rotors whose rows, and what their logs tell of blades, were found sound, as they read then.

    For who computes from them, and has to notice any change of any row: equal is not enough, for 1
    and 1.0 are equal and have other digests. Blades that read the same to the last character are
    the same objects (`service.store.records`).
    """

    def __init__(self) -> None:
        self._found: OrderedDict[str, tuple[str, object, tuple[BladeRecord, ...]]] = OrderedDict()
        self._lock = threading.Lock()

    def knows(self, rotor: RotorRecord, moves: object, blades: Sequence[BladeRecord]) -> bool:
        """Whether all of it reads as it did. moves   what the log tells of blades"""
        with self._lock:
            known = self._found.get(rotor.id)
            if known is None:
                return False
            self._found.move_to_end(rotor.id)
        asked, told, there = known
        return (
            (asked, told) == (repr(Asked.of(rotor)), moves)
            and len(there) == len(blades)
            and all(map(is_, there, blades))
        )

    def put(self, rotor: RotorRecord, moves: object, blades: Sequence[BladeRecord]) -> None:
        with self._lock:
            self._found[rotor.id] = repr(Asked.of(rotor)), moves, tuple(blades)
            self._found.move_to_end(rotor.id)
            while len(self._found) > MOST_SOUND:
                self._found.popitem(last=False)
