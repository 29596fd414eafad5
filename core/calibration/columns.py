"""The messages of many blades at many nodes: side by side, as few as will do, and kept.

A column, log m_b at nodes of the shared parameters, depends on the blade's readings and the nodes
alone. It is computed once for both; at the many nodes of a placement only at as many of them as
the blade needs (`smooth`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import blake2b
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from core.calibration.alike import AlikeMessage, Family, gathered
from core.calibration.message import PARTS, POOL, BladeMessage
from core.calibration.smooth import NEARLY, TOLERANCE, Column, smoothly
from core.errors import CalibrationError

Array = NDArray[np.float64]
How = Literal["exact", "near", "rough"]
MANY = 32  # nodes from which on a column is computed at a part of them


def columns(messages: Sequence[BladeMessage], unit: Array, *, rough: bool) -> list[Array]:
    """The columns of several blades, one blade beside the other; of a single one, its nodes.

    Those of alike blades come family by family (`alike`).
    """
    found = dict[int, Array]()
    families = dict[int, list[AlikeMessage]]()
    for m in messages:
        if isinstance(m, AlikeMessage):
            families.setdefault(id(m.family), []).append(m)
    for alike in families.values():
        made = alike[0].family.columns(alike, unit, rough)
        found |= {id(m): column for m, column in zip(alike, made, strict=True)}
    others = [m for m in messages if id(m) not in found]
    if len(others) < PARTS:
        found |= {id(m): m.column(unit, rough) for m in others}
    else:
        made = list(POOL.map(lambda m: m.column(unit, rough, parts=1), others))
        found |= {id(m): column for m, column in zip(others, made, strict=True)}
    return [found[id(m)] for m in messages]


def smooth_columns(
    messages: Sequence[BladeMessage],
    unit: Array,
    begun: Sequence[Column | None] | None = None,
    tolerance: float = TOLERANCE,
) -> list[Column]:
    """Exact columns of several blades at many nodes, at as many as each needs (`smooth`)."""

    begun = begun or [None] * len(messages)
    kinds, found = dict[tuple[int, ...], list[int]](), dict[int, Column]()
    for i, m in enumerate(messages):
        kinds.setdefault(m.seen, []).append(i)
    for seen, own in kinds.items():

        def compute(which: Sequence[int], nodes: Array, own: list[int] = own) -> list[Array]:
            return columns([messages[own[i]] for i in which], nodes, rough=False)

        made = smoothly(compute, [begun[i] for i in own], unit, tolerance, seen)
        found |= dict(zip(own, made, strict=True))
    return [found[i] for i in range(len(messages))]


@dataclass
class Columns:
    """Messages already computed, by what they rest on. Bounded, oldest out.

    How a column is asked for: ``exact``; ``near``, which may be off by `smooth.NEARLY`; ``rough``.
    """

    kept: dict[tuple[str, bool, bytes], Column] = field(default_factory=dict)
    limit: int = 20_000
    computed: int = 0
    families: dict[bytes, Family] = field(default_factory=dict)

    def gathered(self, messages: Mapping[str, BladeMessage]) -> dict[str, BladeMessage]:
        """The messages, those of many blades alike from tables that are kept."""
        return gathered(messages, self.families)

    def all(self, messages: Mapping[str, BladeMessage], unit: Array, how: How) -> dict[str, Array]:
        """The column of each blade; those that are missing are computed side by side."""
        # by the nodes: rotors with equal readings share the proposal, but each has its own nodes
        nodes = blake2b(np.ascontiguousarray(unit).tobytes(), digest_size=16).digest()
        places = {b: (m.name, how == "rough", nodes) for b, m in messages.items()}
        tolerance = NEARLY if how == "near" else TOLERANCE
        begun = {b: self.kept.get(place) for b, place in places.items()}
        missing = {b: messages[b] for b, c in begun.items() if c is None or c.error > tolerance}
        if len(self.kept) + len(missing) > self.limit:
            for old in list(self.kept)[: self.limit // 2]:
                if old not in places.values():
                    del self.kept[old]
        many = how != "rough" and len(unit) >= MANY
        smooth = {b: m for b, m in missing.items() if many and m.smooth}
        others = {b: m for b, m in missing.items() if b not in smooth}
        made = smooth_columns([*smooth.values()], unit, [begun[b] for b in smooth], tolerance)
        full = columns([*others.values()], unit, rough=how == "rough")
        found = dict(zip(smooth, made, strict=True))
        found |= {b: Column(v, len(unit), 0.0) for b, v in zip(others, full, strict=True)}
        for blade, column in found.items():
            self.computed += 1
            if np.isnan(column.values).any():
                raise CalibrationError(
                    f"a blade's message is not a number at {int(np.isnan(column.values).sum())} of "
                    f"{len(unit)} nodes; its readings: {missing[blade].rows.y.tolist()[:12]}"
                )
            self.kept[places[blade]] = column
        return {b: self.kept[place].values for b, place in places.items()}
