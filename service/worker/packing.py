"""A rotor's log, packed: a tenth of the memory, and an update needs no object of what it knew.

An entry with its reading takes 590 bytes as objects; packed it takes 37: numbers and digests as
columns (`core.columns`), and what readings are called by as text. To bring a log up to date costs
the new entries, 0.1 µs for each that was there, and a look at the text where readings share a time.
In what order the readings count, and which do not, is kept beside them: a reading comes in at its
place, and only a correction or retraction asks again of all.

Numbers and text are in chunks whose sizes fall at least by half from one to the next: what comes
later joins the last ones, and an entry is packed anew a number of times that grows as the logarithm
of their count. Places are numbers of four bytes, though fewer would do: numpy keeps what was freed
of less than a KiB, seven times for each number of bytes, and so arrays of any such number would
hold megabytes.
"""

from __future__ import annotations

import pickle
import zlib
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.columns import Array, Columns, Head
from core.log import Entry, replaced
from core.observation import Inspection
from core.readings import Readings, Words, inspections, made

LOG_BYTES, CHUNK_BYTES, HEAD_BYTES, RARE_BYTES = 700, 150, 180, 280  # of objects, measured
Rows = NDArray[np.uint32]
COLUMNS = tuple(
    (name, np.dtype(kind))
    for name, kind in (
        ("code", "u4"), ("time_h", "f8"), ("sigma", "f8"), ("digests", "S16"), ("values", "f8"),
        ("nodes", "i8"),
    )
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Chunk:
    """Some readings that followed one another in the log.

    counts   of the numbers in each of `COLUMNS`
    numbers  those, one column after the other, compressed; what readings have in common is told by
             the log
    text     arrival number, id, observed_at and replaces of each; pickled and compressed
    """

    counts: tuple[int, ...]
    numbers: bytes
    text: bytes

    @classmethod
    def of(cls, columns: Columns, words: Sequence[Sequence[Any]]) -> Chunk:
        arrays = [np.asarray(getattr(columns, name), dtype) for name, dtype in COLUMNS]
        numbers = zlib.compress(b"".join(array.tobytes() for array in arrays), level=1)
        text = pickle.dumps([list(column) for column in words], protocol=5)
        return cls(tuple(map(len, arrays)), numbers, zlib.compress(text, level=1))

    @property
    def count(self) -> int:
        return self.counts[0]

    @property
    def nbytes(self) -> int:
        return CHUNK_BYTES + len(self.numbers) + len(self.text)

    def columns(self) -> Columns:
        whole, begin, found = zlib.decompress(self.numbers), 0, dict[str, Any]()
        for (name, dtype), count in zip(COLUMNS, self.counts, strict=True):
            found[name] = np.frombuffer(whole, dtype, count, begin)
            begin += found[name].nbytes
        return Columns((), **found)

    def words(self) -> list[list[Any]]:
        return list(pickle.loads(zlib.decompress(self.text)))


@dataclass(frozen=True, slots=True, eq=False)
class PackedLog:
    """The entries of one rotor that concern readings; each reading's id is there once.

    heads        what readings have in common, each once
    chunks       the readings, as they arrived
    order        places of the readings by (time, id)
    hidden       places of those that do not count: retracted or replaced
    gone         ids that were retracted; over: that are replaced by what stands
    retractions  those entries
    corrections  by the id of each, the id that it names
    whole        columns of all readings, while they are needed (`closed`)

    >>> log = PackedLog().extended([Entry(1, "retraction", "a")])
    >>> log.extended([Entry(2, "inspection", "a", Inspection("a", "B1", "q", 8e3, [0.1]))]).count
    2
    """

    heads: tuple[Head, ...] = ()
    chunks: tuple[Chunk, ...] = ()
    order: Rows = field(default_factory=lambda: np.empty(0, np.uint32))
    hidden: frozenset[int] = frozenset()
    gone: frozenset[str] = frozenset()
    over: frozenset[str] = frozenset()
    retractions: tuple[Entry, ...] = ()
    corrections: Mapping[str, str] = field(default_factory=dict)
    whole: Columns | None = None

    @property
    def count(self) -> int:
        """How many entries."""
        return len(self.order) + len(self.retractions)

    @property
    def nbytes(self) -> int:
        rare = len(self.retractions) + len(self.corrections)
        return (
            LOG_BYTES
            + self.order.nbytes
            + HEAD_BYTES * len(self.heads)
            + RARE_BYTES * rare
            + sum(chunk.nbytes for chunk in self.chunks)
        )

    def extended(self, entries: Sequence[Entry]) -> PackedLog:
        """These entries and some that came after them."""
        if not entries:
            return self
        new = [(e.seq, e.inspection) for e in entries if e.inspection is not None]
        readings = [reading for _, reading in new]
        retractions = tuple(entry for entry in entries if entry.inspection is None)
        named = {r.id: r.replaces for r in readings if r.replaces is not None}
        heads, order, chunks = self.heads, self.order, self.chunks
        whole = self.columns()
        if readings:
            columns = Columns.of(readings, heads)
            words = zip(*((s, r.id, r.observed_at, r.replaces) for s, r in new), strict=True)
            heads = columns.heads if len(columns.heads) > len(heads) else heads
            order = self._merged(readings, whole.time_h[order])
            whole = Columns.joined([whole, columns], heads)
            chunks = _joined(chunks, Chunk.of(columns, [*words]))
        hidden, gone, over, corrections = self.hidden, self.gone, self.over, self.corrections
        if named or retractions:
            corrections = {**corrections, **named}
            gone = gone.union(entry.target for entry in retractions)
            over = frozenset(replaced(corrections, gone))
            ids = enumerate(_words(chunks)[1])
            hidden = frozenset(row for row, name in ids if name in gone or name in over)
        elif gone or over:
            rows = enumerate(readings, start=len(self.order))
            hidden = hidden.union(k for k, r in rows if r.id in gone or r.id in over)
        retractions = self.retractions + retractions
        return PackedLog(heads, chunks, order, hidden, gone, over, retractions, corrections, whole)

    def closed(self) -> PackedLog:
        """The same, to be kept: columns are unpacked when they are next needed."""
        return replace(self, whole=None)

    def columns(self) -> Columns:
        """Of all readings, as they arrived."""
        if self.whole is not None:
            return self.whole
        return Columns.joined([chunk.columns() for chunk in self.chunks], self.heads)

    def effective(self) -> Readings:
        """The readings that count, as `core.log.effective` finds and orders them."""
        rows = self.order
        if self.hidden:
            out = np.zeros(len(rows), dtype=bool)
            out[list(self.hidden)] = True
            rows = rows[~out[rows]]

        def words() -> Words:
            (_, *every), at = _words(self.chunks), rows.tolist()
            ids, observed_at, replaces = ([column[k] for k in at] for column in every)
            return ids, observed_at, replaces

        return Readings(self.columns().taken(rows), words)

    def entries(self) -> list[Entry]:
        """All of them, equal to what they were."""
        seqs, *words = _words(self.chunks)
        readings: list[Inspection] = inspections(self.columns(), *words)
        kinds = ["inspection"] * len(seqs)
        found = made(Entry, len(seqs), seq=seqs, kind=kinds, target=words[0], inspection=readings)
        return sorted([*found, *self.retractions], key=lambda entry: entry.seq)

    def _merged(self, readings: Sequence[Inspection], times: Array) -> Rows:
        """The order with these readings, which came last; times: of the others, in order [h]."""
        before = len(self.order)
        ids: list[str] | None = None
        fresh = sorted(range(len(readings)), key=lambda k: (readings[k].time_h, readings[k].id))
        places = []
        for reading in (readings[k] for k in fresh):
            first, last = (
                int(np.searchsorted(times, reading.time_h, side)) for side in ("left", "right")
            )
            if first < last:
                ids = ids or _words(self.chunks)[1]
                same = [ids[row] for row in self.order[first:last].tolist()]
                first += bisect_left(same, reading.id)
            places.append(first)
        return np.insert(self.order, places, np.array(fresh, dtype=np.uint32) + np.uint32(before))


def _joined(before: tuple[Chunk, ...], new: Chunk) -> tuple[Chunk, ...]:
    """The chunks with new readings; those that are long are used again."""
    count, first = new.count, len(before)
    while first and before[first - 1].count < 2 * count:
        first -= 1
        count += before[first].count
    last = [*before[first:], new]
    if len(last) > 1:
        new = Chunk.of(Columns.joined([chunk.columns() for chunk in last], ()), _words(last))
    return (*before[:first], new)


def _words(chunks: Sequence[Chunk]) -> list[list[Any]]:
    """Arrival numbers, ids, observed_at and replaces of all readings."""
    parts = [chunk.words() for chunk in chunks]
    return [[word for part in parts for word in part[k]] for k in range(4)]
