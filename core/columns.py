"""Columns of readings: numbers of all of them as arrays, what many have in common once.

The arrays hold one reading after the other. Values and nodes of a reading are pieces of two long
arrays, whose lengths its head tells.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.observation import Inspection

Array = NDArray[np.float64]


class Head(NamedTuple):
    """What readings have in common. `node_count` is -1 where a reading names no nodes."""

    blade: str
    quantity: str
    unit: str | None
    instrument: str | None
    campaign: str | None
    shape: tuple[int, ...]
    node_count: int


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """n readings, without what they are called by.

    heads    each once
    code     (n,) place of each reading's head
    time_h   (n,) operating hours [h]
    sigma    (n,) standard deviations that the readings give; NaN: none. Empty: none gives one
    digests  (n,) the 16 bytes of each reading's digest
    values   all values, one reading after the other
    nodes    all nodes, likewise
    """

    heads: tuple[Head, ...]
    code: NDArray[np.uint32]
    time_h: Array
    sigma: Array
    digests: NDArray[np.bytes_]
    values: Array
    nodes: NDArray[np.int64]

    @classmethod
    def of(cls, readings: Sequence[Inspection], heads: Sequence[Head] = ()) -> Columns:
        """Columns of readings; `heads` that are known keep their places."""
        place = {head: k for k, head in enumerate(heads)}
        code = [place.setdefault(_head(reading), len(place)) for reading in readings]
        given = [reading.sigma for reading in readings]
        some = any(sigma is not None for sigma in given)
        nodes = [reading.nodes for reading in readings if reading.nodes is not None]
        return cls(
            tuple(place),
            np.array(code, dtype=np.uint32),
            np.array([reading.time_h for reading in readings], dtype=np.float64),
            np.array(given if some else [], dtype=np.float64),
            np.array([bytes.fromhex(reading.digest()) for reading in readings], dtype="S16"),
            np.concatenate([np.empty(0), *(reading.values.ravel() for reading in readings)]),
            np.concatenate([np.empty(0, np.int64), *nodes]),
        )

    def __len__(self) -> int:
        return len(self.time_h)

    def each(self, told: Callable[[Head], Any]) -> list[Any]:
        """What a head tells, of each reading."""
        once = [told(head) for head in self.heads]
        return [once[code] for code in self.code.tolist()]

    def counts(self, told: Callable[[Head], int]) -> NDArray[np.int64]:
        """A number that a head tells, of each reading: (n,)."""
        found: NDArray[np.int64] = np.array([told(h) for h in self.heads], dtype=np.int64)
        taken: NDArray[np.int64] = found[self.code]
        return taken

    def value_ends(self) -> NDArray[np.int64]:
        """Where each reading's values end: (n,)."""
        return np.cumsum(self.counts(_size))

    def node_ends(self) -> NDArray[np.int64]:
        """Where each reading's nodes end: (n,)."""
        return np.cumsum(self.counts(_nodes))

    @classmethod
    def joined(cls, parts: Sequence[Columns], heads: tuple[Head, ...]) -> Columns:
        """Those of all parts, one after the other; the parts' codes are places among `heads`."""
        parts = [cls.of([]), *parts]
        sigma = np.empty(0)
        if any(len(part.sigma) for part in parts):
            sigma = np.concatenate(
                [p.sigma if len(p.sigma) else np.full(len(p), np.nan) for p in parts]
            )
        return cls(
            heads,
            np.concatenate([part.code for part in parts]),
            np.concatenate([part.time_h for part in parts]),
            sigma,
            np.concatenate([part.digests for part in parts]),
            np.concatenate([part.values for part in parts]),
            np.concatenate([part.nodes for part in parts]),
        )

    def taken(self, rows: NDArray[np.integer[Any]]) -> Columns:
        """Those readings, in the order of the rows."""
        return Columns(
            self.heads,
            self.code[rows],
            self.time_h[rows],
            self.sigma[rows] if len(self.sigma) else self.sigma,
            self.digests[rows],
            self.values[_places(self.value_ends(), self.counts(_size), rows)],
            self.nodes[_places(self.node_ends(), self.counts(_nodes), rows)]
            if len(self.nodes)
            else self.nodes,
        )


def _head(reading: Inspection) -> Head:
    nodes = -1 if reading.nodes is None else len(reading.nodes)
    common = (reading.blade, reading.quantity, reading.unit, reading.instrument, reading.campaign)
    return Head(*common, reading.values.shape, nodes)


def _size(head: Head) -> int:
    return prod(head.shape)


def _nodes(head: Head) -> int:
    return max(head.node_count, 0)


def _places(
    ends: NDArray[np.int64], counts: NDArray[np.int64], rows: NDArray[np.integer[Any]]
) -> NDArray[np.int64]:
    """Where the pieces of some rows lie, in the order of the rows."""
    own, last = counts[rows], ends[rows]
    if len(own) and own.min() == own.max() == 1:
        at: NDArray[np.int64] = last - 1
        return at
    shift = last - np.cumsum(own)
    return np.repeat(shift, own) + np.arange(own.sum())
