"""What one process keeps of stored versions: decoded arrays, and which versions it has checked."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Mapping

from service.ports import Array

Key = tuple[str, int, str]
Kept = tuple[str, int, str, str | None]  # and the SHA-256 that it has in this version
MOST_CHECKED = 512
OVERHEAD = 664  # bytes of an array's objects, head and key beside its numbers, measured


class ArrayCache:
    """Decoded arrays, least recently used ones dropped above `limit_mb`; safe between threads.

    Each counts with what Python needs to hold it: of small arrays that is nearly all.
    """

    def __init__(self, limit_mb: float) -> None:
        self._limit = int(limit_mb * 2**20)
        self._size = 0
        self._arrays: OrderedDict[Kept, Array] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: Kept) -> Array | None:
        with self._lock:
            if key in self._arrays:
                self._arrays.move_to_end(key)
            return self._arrays.get(key)

    def put(self, key: Kept, array: Array) -> None:
        with self._lock:
            if key in self._arrays or array.nbytes + OVERHEAD > self._limit:
                return
            self._arrays[key] = array
            self._size += array.nbytes + OVERHEAD
            while self._size > self._limit:
                _, dropped = self._arrays.popitem(last=False)
                self._size -= dropped.nbytes + OVERHEAD


class Checked:
    """Versions whose digest was compared: (rotor, version) -> what was read, SHA-256 by array.

    A version whose row reads differently from what was compared is compared again.
    """

    def __init__(self) -> None:
        self._found: OrderedDict[tuple[str, int], tuple[str, Mapping[str, str]]] = OrderedDict()
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
            while len(self._found) > MOST_CHECKED:
                self._found.popitem(last=False)
