"""Rows of a surrogate compiled hour by hour, kept until somebody asks for the same again.

To compile rows costs as much as thousands of answers by them. Hours that are asked for together
share the way to them, and rows of several quantities what the process says along it
(`core.surrogate.history`), nearly all of the cost. So who knows beforehand what will be asked for
says so once (`ready`), and is told the same numbers as if each were asked for by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from core.response import Response

Array = NDArray[np.float64]
MOST = 512  # rows of an hour that are kept
TOGETHER = 32  # hours at once: 30 MB of answers for a scan's rows


@dataclass(frozen=True)
class Wanted:
    """Rows of a quantity, of a field at nodes; or mixtures (Q, B) of the deformation's modes."""

    quantity: str
    nodes: tuple[int, ...] | None = None
    mixing: tuple[tuple[float, ...], ...] | None = None

    @staticmethod
    def of(
        quantity: str, nodes: Sequence[int] | None = None, mixing: Array | None = None
    ) -> Wanted:
        """From arrays."""
        mixed = None if mixing is None else tuple(map(tuple, mixing.tolist()))
        return Wanted(quantity, None if nodes is None else tuple(nodes), mixed)


Make = Callable[[Sequence[Wanted], Sequence[float]], Sequence[Sequence[Response]]]


@dataclass(frozen=True)
class Kept:
    """Rows by what they are of and hour.

    make   compiles all of the rows wanted at each of some hours after 0: by rows, then by hour
    """

    make: Make
    _rows: dict[tuple[Wanted, float], Response] = field(
        default_factory=dict, repr=False, compare=False
    )

    def at(self, wanted: Wanted, times: Sequence[float]) -> dict[float, Response]:
        """Of each hour after 0; those that are new are compiled together."""
        # taken out once: another thread may clear what is kept meanwhile
        found = {t: self._rows.get((wanted, t)) for t in _after_0(times)}
        new = {t for t, rows in found.items() if rows is None}
        made = self.made({wanted: new})
        return {t: made[wanted, t] if rows is None else rows for t, rows in found.items()}

    def ready(self, asked: Mapping[Wanted, Iterable[float]]) -> None:
        """Compile at once what is new of all this."""
        self.made(
            {
                wanted: {t for t in _after_0(times) if (wanted, t) not in self._rows}
                for wanted, times in asked.items()
            }
        )

    def made(self, new: Mapping[Wanted, set[float]]) -> dict[tuple[Wanted, float], Response]:
        """Compiled together, and kept: rows at each of these hours after 0."""
        made: dict[tuple[Wanted, float], Response] = {}
        alike = [(tuple(t in own for own in new.values()), t) for t in set().union(*new.values())]
        hours = [t for _, t in sorted(alike)]  # so that few are of what others of them are not
        for k in range(0, len(hours), TOGETHER):
            some = sorted(hours[k : k + TOGETHER])
            wanted = [one for one, own in new.items() if own & set(some)]
            for one, by_hour in zip(wanted, self.make(wanted, some), strict=True):
                rows = zip(some, by_hour, strict=True)
                made |= {(one, t): row for t, row in rows if t in new[one]}
        if made and len(self._rows) > MOST:
            self._rows.clear()
        self._rows.update(made)
        return made


def _after_0(times: Iterable[float]) -> set[float]:
    return {float(t) for t in times if t > 0}
