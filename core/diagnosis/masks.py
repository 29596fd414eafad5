"""Which readings a cell of the grammar concerns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from core.diagnosis.grammar import Cell, Facts, there
from core.diagnosis.scores import Scores
from core.observation import Inspection

Array = NDArray[np.float64]
WHOM = ("all", "lot", "coating_lot", "blade", "instrument", "campaign", "quantity")


def labelled(whom: str, blade: str, facts: Facts, reading: Inspection) -> str | None:
    """What a reading is called by in a way of grouping; an effect is on those of its own value."""
    match whom:
        case "lot" | "coating_lot":
            found: str | None = getattr(facts, whom)
        case "blade":
            found = blade
        case "instrument" | "campaign" | "quantity":
            found = getattr(reading, whom)
        case _:
            found = None
    return found


def masks(cells: Sequence[Cell], seen: Scores, facts: Mapping[str, Facts]) -> NDArray[np.bool_]:
    """Which rows each cell concerns, (B, n, C).

    Of a sensor's, those of its quantity; of an event's, those of blades that were there.
    """
    labels = {whom: np.full(seen.place.shape, None, object) for whom in WHOM}
    for b, i in np.argwhere(seen.real):
        blade, reading = seen.blades[b], seen.reading(b, i)
        for whom, own in labels.items():
            own[b, i] = labelled(whom, blade, facts[blade], reading)
    out = np.zeros((*seen.place.shape, len(cells)), bool)
    for c, cell in enumerate(cells):
        concerned = seen.real & (labels[cell.whom] == cell.value)
        if cell.family.target == "reading":
            concerned &= labels["quantity"] == cell.family.of
        if cell.family.clock == "event":
            concerned &= np.array([[there(cell, facts[b])] for b in seen.blades])
        out[:, :, c] = concerned
    return out
