"""Entries of a log, packed: a tenth of the memory, and back without reading the database.

An entry with its reading takes 590 bytes as objects; packed it takes 50: columns of what the
readings say, compressed, beside their values and nodes as plain numbers. Back it takes 2 µs an
entry, a twentieth of reading it from the database: what was checked once is not checked again, and
objects are made field by field for all entries at once, so that no loop runs in Python.

The entries of a rotor only grow, so they are packed in chunks whose sizes fall at least by half
from one to the next: what comes later joins the last ones, and an entry is packed anew a number of
times that grows as the logarithm of their count.
"""

from __future__ import annotations

import pickle
import zlib
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import accumulate, repeat
from math import prod
from sys import getsizeof, intern
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from core.observation import Entry, Inspection
from service.ports import Array

T = TypeVar("T")
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
    told = dict(zip(WORDS, words, strict=True))
    for name in SHARED:
        told[name] = _interned(told[name])
    made = _made(
        Inspection,
        len(digests),
        values=_pieces(chunk.values, [prod(shape) for shape in shapes], shapes),
        nodes=_nodes(chunk.nodes, counts),
        _digest=map(bytes.hex, digests),
        **told,
    )
    readings: Iterable[Inspection | None] = made
    if len(made) < chunk.count:
        following = iter(made)
        readings = [next(following) if there else None for there in with_reading]
    return _made(Entry, chunk.count, seq=seqs, kind=kinds, target=targets, inspection=readings)


def _interned(column: list[str | None]) -> list[str | None]:
    """The same with each word once in memory."""
    once = {word: None if word is None else intern(word) for word in set(column)}
    return [once[word] for word in column]


def _pieces(whole: Array, sizes: list[int], shapes: list[tuple[int, ...]]) -> Iterable[Array]:
    """The readings' values, read-only, as views of all of them."""
    whole.flags.writeable = False
    if set(shapes) <= {(1,)}:
        return iter(whole[:, np.newaxis])
    ends = accumulate(sizes)
    return [
        whole[end - size : end].reshape(shape)
        for end, size, shape in zip(ends, sizes, shapes, strict=True)
    ]


def _nodes(whole: NDArray[np.int64], counts: list[int]) -> list[NDArray[np.int64] | None]:
    """The readings' nodes likewise; a count below 0: none."""
    whole.flags.writeable = False
    if not len(whole):
        return [None if count < 0 else whole for count in counts]
    ends = accumulate(max(count, 0) for count in counts)
    return [
        None if count < 0 else whole[end - count : end]
        for end, count in zip(ends, counts, strict=True)
    ]


def _made(cls: type[T], count: int, **columns: Iterable[Any]) -> list[T]:
    """Objects of a class with slots from all of its fields; nothing is checked or computed.

    >>> _made(Entry, 2, seq=[1, 2], kind=["retraction"] * 2, target="ab", inspection=[None] * 2)[1]
    Entry(seq=2, kind='retraction', target='b', inspection=None)
    """
    made = list(map(cls.__new__, repeat(cls, count)))
    for name, column in columns.items():
        deque(map(getattr(cls, name).__set__, made, column), maxlen=0)
    return made
