"""Many histories at once, each with pieces and marks at hours of its own.

The rule is that of `core.surrogate.history`. Blades are read at hours of their own: to follow all
of them between the hours of all would cost the square of their number.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError
from core.surrogate.followed import Followed
from core.surrogate.history import Memory, Walk
from core.surrogate.model import Surrogate

Array = NDArray[np.float64]


def follow_each(
    surrogate: Surrogate,
    edges: Array,
    inputs: Array,
    marks: Array,
    at_marks: Array,
    what: Sequence[Followed],
    *,
    late: bool = False,
) -> list[Array]:
    """Of each of `what` the mean of its rows at hours `marks`, (n, M, R); NaN where there is none.

    edges     hours (n, P + 1) of each history, from 0, between which inputs are held; NaN behind
              its last
    inputs    (n, P, d), held over each piece
    marks     (n, M); NaN where a history has fewer
    at_marks  (n, M, d), held from the last edge before each mark to the mark
    late      as of `core.surrogate.history.follow`

    Raises RangeError for inputs outside the surrogate's box.
    """
    fits = inputs.shape[1] == edges.shape[1] - 1 and at_marks.shape[:2] == marks.shape
    if not fits or np.any(edges[:, 0] != 0) or np.any(np.diff(edges) <= 0) or np.any(marks <= 0):
        raise InputError("edges", edges.tolist(), "do not fit the inputs", "one piece per interval")
    walk, now = Walk.of(surrogate, what, False, late), Memory.of(len(marks), what)
    found = [np.full((*marks.shape, one.curves.forms.shape[2]), np.nan) for one in what]
    last = np.sum(edges[:, None, :] < marks[:, :, None], axis=2) - 1  # the edge strictly before
    going = np.arange(len(marks))  # histories that `now` is of
    for p in range(int(last.max(initial=-1)) + 1):
        here, m = np.nonzero(last[going] == p)
        if here.size:
            rows = going[here]
            hours = (marks[rows, m] - edges[rows, p])[:, None]
            seen = walk.on(now.at(here), walk.known(at_marks[rows, m]), hours)
            for out, own in zip(found, seen.rows, strict=True):
                out[rows, m] = own.total
        on = np.flatnonzero(last[going].max(axis=1, initial=-1) > p)
        going = going[on]
        if going.size:
            hours = (edges[going, p + 1] - edges[going, p])[:, None]
            now = walk.on(now.at(on), walk.known(inputs[going, p]), hours)
    return found
