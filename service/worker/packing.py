"""A rotor's log, packed: a tenth of the memory, and an update needs no object of what it knew.

An entry with its reading takes 590 bytes as objects; packed it takes 45: numbers and digests as
columns (`core.columns`), and what readings are called by as compressed text. To bring a log up to
date costs the new entries, a copy of the columns and, where readings share a time, a look at the
text. In what order the readings count, and which do not, is kept beside them: a reading comes in at
its place, and only a correction or retraction asks again of all.

The text is in chunks whose sizes fall at least by half from one to the next: what comes later joins
the last ones, and an entry is compressed anew a number of times that grows as the logarithm of
their count.
"""

from __future__ import annotations

import pickle
import zlib
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from sys import getsizeof
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.columns import Columns
from core.log import Entry, replaced
from core.observation import Inspection
from core.readings import Readings, Words, inspections, made

LOG_BYTES, HEAD_BYTES, RARE_BYTES, TEXT_BYTES = 1400, 180, 280, 130  # of objects, measured
Rows = NDArray[np.unsignedinteger[Any]]


@dataclass(frozen=True, slots=True)
class Text:
    """Arrival number, id, observed_at and replaces of some readings; pickled and compressed."""

    count: int
    packed: bytes

    @classmethod
    def of(cls, columns: Sequence[Sequence[Any]]) -> Text:
        return cls(
            len(columns[0]), zlib.compress(pickle.dumps([list(c) for c in columns], 5), level=1)
        )

    def columns(self) -> list[list[Any]]:
        return list(pickle.loads(zlib.decompress(self.packed)))


@dataclass(frozen=True, slots=True, eq=False)
class PackedLog:
    """The entries of one rotor that concern readings; each reading's id is there once.

    columns      of the readings, as they arrived
    order        rows of the columns by (time, id)
    hidden       rows that do not count: retracted or replaced
    gone         ids that were retracted; over: that are replaced by what stands
    retractions  those entries
    corrections  by the id of each, the id that it names
    texts        what the readings are called by, as they arrived

    >>> log = PackedLog().extended([Entry(1, "retraction", "a")])
    >>> log.extended([Entry(2, "inspection", "a", Inspection("a", "B1", "q", 8e3, [0.1]))]).count
    2
    """

    columns: Columns = field(default_factory=lambda: Columns.of([]))
    order: Rows = field(default_factory=lambda: np.empty(0, np.uint8))
    hidden: frozenset[int] = frozenset()
    gone: frozenset[str] = frozenset()
    over: frozenset[str] = frozenset()
    retractions: tuple[Entry, ...] = ()
    corrections: Mapping[str, str] = field(default_factory=dict)
    texts: tuple[Text, ...] = ()

    @property
    def count(self) -> int:
        """How many entries."""
        return len(self.columns) + len(self.retractions)

    @property
    def nbytes(self) -> int:
        c = self.columns
        arrays = (c.code, c.time_h, c.sigma, c.digests, c.values, c.nodes, self.order)
        rare = len(self.retractions) + len(self.corrections)
        return (
            LOG_BYTES
            + sum(array.nbytes for array in arrays)
            + HEAD_BYTES * len(c.heads)
            + RARE_BYTES * rare
            + sum(getsizeof(text.packed) + TEXT_BYTES for text in self.texts)
        )

    def extended(self, entries: Sequence[Entry]) -> PackedLog:
        """These entries and some that came after them."""
        if not entries:
            return self
        new = [(e.seq, e.inspection) for e in entries if e.inspection is not None]
        readings = [reading for _, reading in new]
        retractions = tuple(entry for entry in entries if entry.inspection is None)
        named = {r.id: r.replaces for r in readings if r.replaces is not None}
        columns, order, texts = self.columns, self.order, self.texts
        if readings:
            columns = columns.joined(Columns.of(readings, columns.heads))
            order = self._merged(readings)
            texts = _texts(texts, new)
        hidden, gone, over, corrections = self.hidden, self.gone, self.over, self.corrections
        if named or retractions:
            corrections = {**corrections, **named}
            gone = gone.union(entry.target for entry in retractions)
            over = frozenset(replaced(corrections, gone))
            ids = enumerate(_words(texts)[0])
            hidden = frozenset(row for row, name in ids if name in gone or name in over)
        elif gone or over:
            rows = enumerate(readings, start=len(self.columns))
            hidden = hidden.union(k for k, r in rows if r.id in gone or r.id in over)
        return PackedLog(
            columns, order, hidden, gone, over, self.retractions + retractions, corrections, texts
        )

    def effective(self) -> Readings:
        """The readings that count, as `core.log.effective` finds and orders them."""
        rows = self.order
        if self.hidden:
            out = np.zeros(len(self.columns), dtype=bool)
            out[list(self.hidden)] = True
            rows = rows[~out[rows]]

        def words() -> Words:
            every, at = _words(self.texts), rows.tolist()
            return ([every[0][k] for k in at], [every[1][k] for k in at], [every[2][k] for k in at])

        return Readings(self.columns.taken(rows), words)

    def entries(self) -> list[Entry]:
        """All of them, equal to what they were."""
        seqs = [seq for text in self.texts for seq in text.columns()[0]]
        words = _words(self.texts)
        readings: list[Inspection] = inspections(self.columns.taken(np.arange(len(seqs))), *words)
        kinds = ["inspection"] * len(seqs)
        found = made(Entry, len(seqs), seq=seqs, kind=kinds, target=words[0], inspection=readings)
        return sorted([*found, *self.retractions], key=lambda entry: entry.seq)

    def _merged(self, readings: Sequence[Inspection]) -> Rows:
        """The order with these readings, which came last."""
        before, times = len(self.order), self.columns.time_h[self.order]
        ids: list[str] | None = None
        fresh = sorted(range(len(readings)), key=lambda k: (readings[k].time_h, readings[k].id))
        places = []
        for reading in (readings[k] for k in fresh):
            first, last = (
                int(np.searchsorted(times, reading.time_h, side)) for side in ("left", "right")
            )
            if first < last:
                ids = ids or _words(self.texts)[0]
                same = [ids[row] for row in self.order[first:last].tolist()]
                first += bisect_left(same, reading.id)
            places.append(first)
        dtype = np.min_scalar_type(max(before + len(readings) - 1, 0))
        rows = np.array(fresh, dtype=np.int64) + before
        return np.insert(self.order.astype(dtype), places, rows.astype(dtype))


def _texts(before: tuple[Text, ...], new: Sequence[tuple[int, Inspection]]) -> tuple[Text, ...]:
    """The text with that of new readings; chunks that are long are used again."""
    kept, count, joined = list(before), len(new), list[list[list[Any]]]()
    while kept and kept[-1].count < 2 * count:
        last = kept.pop()
        joined.insert(0, last.columns())
        count += last.count
    fresh = [[seq, r.id, r.observed_at, r.replaces] for seq, r in new]
    joined.append([list(column) for column in zip(*fresh, strict=True)])
    columns = [[value for part in joined for value in part[k]] for k in range(4)]
    return (*kept, Text.of(columns))


def _words(texts: Sequence[Text]) -> Words:
    """Ids, observed_at and replaces of all readings."""
    parts = [text.columns()[1:] for text in texts]
    ids, observed_at, replaces = ([word for part in parts for word in part[k]] for k in range(3))
    return ids, observed_at, replaces
