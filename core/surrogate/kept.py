"""Rows of a surrogate compiled hour by hour, kept until somebody asks for the same again.

To compile rows costs as much as thousands of answers by them, and hours that are asked for together
share the way to them (`core.surrogate.history`). So who knows beforehand at which hours answers
will be wanted says so once (`at`), and is told the same numbers as if each were asked for by
itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from core.response import Response

MOST = 512  # hours that are kept
Make = Callable[[str, Sequence[float], Sequence[int] | None], Response]


@dataclass(frozen=True)
class Kept:
    """Rows by quantity, hour and nodes.

    make   compiles rows of hours after 0, in the order of (time, row)
    """

    make: Make
    _rows: dict[tuple[str, float, tuple[int, ...] | None], Response] = field(
        default_factory=dict, repr=False, compare=False
    )

    def at(
        self, quantity: str, times: Sequence[float], nodes: Sequence[int] | None
    ) -> dict[float, Response]:
        """Of each hour after 0; those that are new are compiled together."""
        which = None if nodes is None else tuple(nodes)
        asked = {float(t) for t in times if t > 0}
        # taken out once: another thread may clear what is kept meanwhile
        found = {t: self._rows.get((quantity, t, which)) for t in asked}
        new = sorted(t for t, rows in found.items() if rows is None)
        if new:
            if len(self._rows) > MOST:
                self._rows.clear()
            for t, rows in zip(new, each(self.make(quantity, new, nodes), len(new)), strict=True):
                found[t] = self._rows[quantity, t, which] = rows
        return {t: rows for t, rows in found.items() if rows is not None}


def each(rows: Response, count: int) -> list[Response]:
    """Rows in the order of (time, row), as one for each of `count` times."""
    return [rows.rows(own) for own in np.split(np.arange(len(rows)), count)]
