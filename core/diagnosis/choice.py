"""Which of several sets of effects goes into the model: first its names, then its course.

A coating that wears has three courses, one that spalls as many as there are intervals between
inspections. Each is a hypothesis with an evidence of its own, and none of several that are much
alike has more than its part: the single one with the most may be of a name that has less than
another's together. With the log evidence L_k of what was calibrated and c_k its price, the log of
its prior weight (`search.prices`), names are compared by

    log Σ_k exp(L_k − c_k)      over the courses of one set of names

and the largest term of the largest sum is taken. What was not calibrated has no part in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from core.diagnosis.grammar import Cell
from core.smc.particles import log_sum_exp

Which = tuple[int, ...]


def by_name(left: Mapping[Which, float], cells: Sequence[Cell]) -> Which:
    """Of the names with the most evidence the course that has the most.

    left  L_k − c_k [nat] of each set of places among the cells

    >>> from core.diagnosis.families import FAMILIES
    >>> wear = [Cell(FAMILIES[0], shape, "all") for shape in ("linear", "early")]
    >>> cells = [*wear, Cell(FAMILIES[1], "step", "all", None, 9000.0)]
    >>> by_name({(0,): 3.4, (1,): 2.7, (2,): 3.5}, cells)
    (0,)
    """
    named: dict[tuple[str, ...], list[Which]] = {}
    for which in left:
        named.setdefault(tuple(sorted(cells[i].name for i in which)), []).append(which)
    most = max(named.values(), key=lambda own: log_sum_exp(np.array([left[w] for w in own])))
    return max(most, key=left.__getitem__)
