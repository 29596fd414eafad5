"""The messages of many blades at many nodes: side by side, as few as will do, and kept.

A column, log m_b at nodes of the shared parameters, depends on the blade's readings and the nodes
alone. It is computed once for both; at the many nodes of a placement only at as many of them as
the blade needs (`smooth`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import blake2b
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from core.calibration.alike import AlikeMessage, Family, gathered
from core.calibration.message import PARTS, POOL, BladeMessage
from core.calibration.smooth import NEARLY, TOLERANCE, Asked, Column, as_near, stages, together
from core.errors import CalibrationError

Array = NDArray[np.float64]
How = Literal["exact", "near", "rough"]
MANY = 32  # nodes from which on a column is computed at a part of them


def columns(messages: Sequence[BladeMessage], unit: Array, *, rough: bool) -> list[Array]:
    """The columns of several blades, one blade beside the other; of a single one, its nodes.

    Those of alike blades come family by family (`alike`).
    """
    return several([(messages, unit)], rough=rough)[0]


def several(
    asked: Sequence[tuple[Sequence[BladeMessage], Array]], *, rough: bool
) -> list[list[Array]]:
    """`columns` of several groups of blades, each at nodes of its own, all side by side."""
    found = dict[tuple[int, int], Array]()
    for k, (messages, unit) in enumerate(asked):
        families = dict[int, list[AlikeMessage]]()
        for m in messages:
            if isinstance(m, AlikeMessage):
                families.setdefault(id(m.family), []).append(m)
        for alike in families.values():
            made = alike[0].family.columns(alike, unit, rough)
            found |= {(k, id(m)): column for m, column in zip(alike, made, strict=True)}
    others = [(k, m, u) for k, (ms, u) in enumerate(asked) for m in ms if (k, id(m)) not in found]
    if len(others) < PARTS:
        found |= {(k, id(m)): m.column(unit, rough) for k, m, unit in others}
    else:
        made = list(POOL.map(lambda one: one[1].column(one[2], rough, parts=1), others))
        found |= {(k, id(m)): column for (k, m, _), column in zip(others, made, strict=True)}
    return [[found[k, id(m)] for m in messages] for k, (messages, _) in enumerate(asked)]


def smooth_columns(
    messages: Sequence[BladeMessage],
    unit: Array,
    begun: Sequence[Column | None] | None = None,
    tolerance: float = TOLERANCE,
) -> list[Column]:
    """Exact columns of several blades at many nodes, at as many as each needs (`smooth`)."""
    begun = begun or [None] * len(messages)
    kinds = dict[tuple[int, ...], list[int]]()
    for i, m in enumerate(messages):
        kinds.setdefault(m.seen, []).append(i)
    own = list(kinds.values())

    def compute(asked: list[Asked]) -> list[list[Array]]:
        return several(
            [([messages[own[k][i]] for i in due], nodes) for k, due, nodes in asked], rough=False
        )

    runs = [stages([begun[i] for i in kinds[seen]], unit, tolerance, seen) for seen in kinds]
    found = dict[int, Column]()
    for which, made in zip(own, together(runs, compute), strict=True):
        found |= dict(zip(which, made, strict=True))
    return [found[i] for i in range(len(messages))]


@dataclass
class KeptColumns:
    """Messages already computed, by what they rest on. Bounded, oldest out.

    How a column is asked for: ``exact``; ``near``, which may be off by `smooth.NEARLY`; ``rough``.
    A near column is the same whether the exact one is kept or not: by near ones is decided where
    nodes stand, and equal readings have to end in equal states whatever a process has met before.

    heed  called before anything is computed; what it raises ends the update, and nothing is lost
    """

    kept: dict[tuple[str, How, bytes], Column] = field(default_factory=dict)
    limit: int = 20_000
    computed: int = 0
    families: dict[bytes, Family] = field(default_factory=dict)
    heed: Callable[[], None] = lambda: None

    def gathered(self, messages: Mapping[str, BladeMessage]) -> dict[str, BladeMessage]:
        """The messages, those of many blades alike from tables that are kept."""
        return gathered(messages, self.families)

    def all(self, messages: Mapping[str, BladeMessage], unit: Array, how: How) -> dict[str, Array]:
        """The column of each blade; those that are missing are computed side by side."""
        # by the nodes: rotors with equal readings share the proposal, but each has its own nodes
        nodes = blake2b(np.ascontiguousarray(unit).tobytes(), digest_size=16).digest()
        places = {b: (m.name, how, nodes) for b, m in messages.items()}
        many = how != "rough" and len(unit) >= MANY
        begun = dict[str, Column | None]()
        for blade, message in messages.items():
            if places[blade] in self.kept or how == "rough":
                continue
            other: How = "near" if how == "exact" else "exact"
            known = begun[blade] = self.kept.get((message.name, other, nodes))
            if known is not None and how == "near":
                smooth = many and message.smooth
                self.kept[places[blade]] = as_near(known, unit, message.seen) if smooth else known
        missing = {b: m for b, m in messages.items() if places[b] not in self.kept}
        if missing:
            self.heed()
        if len(self.kept) + len(missing) > self.limit:
            for old in list(self.kept)[: self.limit // 2]:
                if old not in places.values():
                    del self.kept[old]
        smooth_ones = {b: m for b, m in missing.items() if many and m.smooth}
        others = [b for b in missing if b not in smooth_ones]
        made = smooth_columns(
            [*smooth_ones.values()],
            unit,
            [begun[b] for b in smooth_ones],
            NEARLY if how == "near" else TOLERANCE,
        )
        full = columns([missing[b] for b in others], unit, rough=how == "rough")
        found = dict(zip(smooth_ones, made, strict=True))
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
