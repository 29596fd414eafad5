"""The messages of many blades at many nodes: side by side, as few as will do, and kept.

A column, log m_b at nodes of the shared parameters, depends on the blade's readings and the nodes
alone. It is computed once for both; at the many nodes of a placement only at as many of them as
the blade needs (`smooth`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from core.calibration.message import PARTS, POOL, BladeMessage
from core.calibration.smooth import smoothly
from core.errors import CalibrationError

Array = NDArray[np.float64]
MANY = 64  # nodes from which on a column is computed at a part of them


def columns(messages: Sequence[BladeMessage], unit: Array, *, rough: bool) -> list[Array]:
    """The columns of several blades, one blade beside the other; of a single one, its nodes."""
    if len(messages) < PARTS:
        return [m.column(unit, rough) for m in messages]
    return list(POOL.map(lambda m: m.column(unit, rough, parts=1), messages))


def smooth_columns(messages: Sequence[BladeMessage], unit: Array) -> list[Array]:
    """The exact columns of several blades at many nodes, as many as each needs (`smooth`)."""

    def compute(which: Sequence[int], nodes: Array) -> list[Array]:
        return columns([messages[i] for i in which], nodes, rough=False)

    return smoothly(compute, len(messages), unit)


@dataclass
class Columns:
    """Messages already computed, by what they rest on. Bounded, oldest out."""

    kept: dict[tuple[str, str, bytes], Array] = field(default_factory=dict)
    limit: int = 20_000
    computed: int = 0

    def of(self, message: BladeMessage, unit: Array, how: str) -> Array:
        return self.all({"": message}, unit, how)[""]

    def all(self, messages: Mapping[str, BladeMessage], unit: Array, how: str) -> dict[str, Array]:
        """The column of each blade; those that are missing are computed side by side."""
        # by the nodes: rotors with equal readings share the proposal, but each has its own nodes
        nodes = blake2b(np.ascontiguousarray(unit).tobytes(), digest_size=16).digest()
        places = {b: (m.name, how, nodes) for b, m in messages.items()}
        missing = {b: messages[b] for b, place in places.items() if place not in self.kept}
        if len(self.kept) + len(missing) > self.limit:
            for old in list(self.kept)[: self.limit // 2]:
                if old not in places.values():
                    del self.kept[old]
        found = dict[str, Array]()
        for smooth in (True, False):
            own = {b: m for b, m in missing.items() if m.smooth == smooth}
            if smooth and how == "exact" and len(unit) >= MANY:
                made = smooth_columns(list(own.values()), unit)
            else:
                made = columns(list(own.values()), unit, rough=how == "rough")
            found |= dict(zip(own, made, strict=True))
        for blade, column in found.items():
            self.computed += 1
            if np.isnan(column).any():
                raise CalibrationError(
                    f"a blade's message is not a number at {int(np.isnan(column).sum())} of "
                    f"{len(column)} nodes; its readings: {missing[blade].rows.y.tolist()[:12]}"
                )
            self.kept[places[blade]] = column
        return {b: self.kept[place] for b, place in places.items()}
