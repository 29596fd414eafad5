"""Entries of a log, packed: a tenth of the memory, and back without reading the database.

An entry with its reading takes 590 bytes as objects; packed it takes 50: columns of what the
readings say, compressed, beside their values and nodes as plain numbers. Back it takes 3 µs an
entry, a tenth of reading it from the database: what was checked once is not checked again.

The entries of a rotor only grow, so they are packed in chunks whose sizes fall at least by half
from one to the next: what comes later joins the last ones, and an entry is packed anew a number of
times that grows as the logarithm of their count.
"""

from __future__ import annotations

import pickle
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from math import prod
from sys import getsizeof, intern
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.observation import Entry, Inspection
from service.ports import Array

OWN = ("id", "time_h", "observed_at", "replaces")
SHARED = ("blade", "quantity", "unit", "instrument", "campaign")
WORDS = (*OWN, *SHARED, "sigma")
CHUNK_BYTES = 450  # a chunk's objects beside its bytes and numbers, measured


@dataclass(frozen=True, slots=True)
class Chunk:
    """Some entries that follow one another.

    count    how many
    columns  seq, kind, target, whether there is a reading; of the readings: digest, shape of the
             values, count of nodes, and each of `WORDS`; pickled and compressed
    values   all values, one after the other
    nodes    all nodes, likewise
    """

    count: int
    columns: bytes
    values: Array
    nodes: NDArray[np.int64]

    @property
    def nbytes(self) -> int:
        return CHUNK_BYTES + getsizeof(self.columns) + self.values.nbytes + self.nodes.nbytes


Chunks = tuple[Chunk, ...]


def packed(entries: Sequence[Entry], before: Chunks = ()) -> Chunks:
    """The entries in chunks.

    before   chunks of the first of these very entries, which are used again where they are long

    >>> some = [Entry(seq, "retraction", "a") for seq in range(1, 8)]
    >>> [chunk.count for chunk in packed(some, packed(some[:6]))]
    [6, 1]
    >>> [chunk.count for chunk in packed(some, packed(some[:4]))]
    [7]
    """
    kept = list(before)
    begin = sum(chunk.count for chunk in kept)
    while kept and kept[-1].count < 2 * (len(entries) - begin):
        begin -= kept.pop().count
    if begin < len(entries):
        kept.append(_chunk(entries[begin:]))
    return tuple(kept)


def unpacked(chunks: Chunks) -> list[Entry]:
    """The entries that were packed, equal to what they were."""
    return [entry for chunk in chunks for entry in _entries(chunk)]


def _chunk(entries: Sequence[Entry]) -> Chunk:
    readings = [entry.inspection for entry in entries if entry.inspection is not None]
    nodes = [np.empty(0, np.int64) if r.nodes is None else r.nodes for r in readings]
    columns: list[list[Any]] = [
        [entry.seq for entry in entries],
        [entry.kind for entry in entries],
        [entry.target for entry in entries],
        [entry.inspection is not None for entry in entries],
        [bytes.fromhex(reading.digest()) for reading in readings],
        [reading.values.shape for reading in readings],
        [-1 if reading.nodes is None else len(reading.nodes) for reading in readings],
        *([getattr(reading, name) for reading in readings] for name in WORDS),
    ]
    return Chunk(
        len(entries),
        zlib.compress(pickle.dumps(columns, protocol=5), level=1),
        np.concatenate([np.empty(0), *(reading.values.ravel() for reading in readings)]),
        np.concatenate([np.empty(0, np.int64), *nodes]),
    )


def _entries(chunk: Chunk) -> list[Entry]:
    columns = pickle.loads(zlib.decompress(chunk.columns))
    seqs, kinds, targets, with_reading, digests, shapes, counts, *words = columns
    for name, column in zip(WORDS, words, strict=True):
        if name in SHARED:
            column[:] = [None if word is None else intern(word) for word in column]
    readings = iter(_readings(chunk, digests, shapes, counts, words))
    return [
        Entry(seq, kind, target, next(readings) if there else None)
        for seq, kind, target, there in zip(seqs, kinds, targets, with_reading, strict=True)
    ]


def _readings(
    chunk: Chunk,
    digests: list[bytes],
    shapes: list[tuple[int, ...]],
    counts: list[int],
    words: list[list[Any]],
) -> list[Inspection]:
    value_ends = list(accumulate((prod(shape) for shape in shapes), initial=0))
    node_ends = list(accumulate((max(count, 0) for count in counts), initial=0))
    found = []
    for i, said in enumerate(zip(*words, strict=True)):
        values = chunk.values[value_ends[i] : value_ends[i + 1]]
        if len(shapes[i]) != 1:
            values = values.reshape(shapes[i])
        nodes = None if counts[i] < 0 else chunk.nodes[node_ends[i] : node_ends[i + 1]]
        rest = zip(WORDS, said, strict=True)
        found.append(Inspection.again(digests[i].hex(), values, nodes, rest))
    return found
