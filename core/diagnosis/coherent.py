"""The simulation errs alike at all readings of a blade, and that is no effect of the blade.

Messages take what surrogate and mesh do not know as independent from reading to reading. Of one
blade it is not: its inputs are the same at all visits, so that where the surrogate is off it is off
in the same way, and mostly in corners of the runs, where few of them are. An effect of that blade
alone could be just this. With a = Q g the weights of the rows in the score u and s_i the
simulation's sd of row i (`Scores.unsure`), the score's variance is not I but

    I + max(0, (Σ_i a_i s_i)² − Σ_i a_i² s_i²)     values of a quantity, wholly correlated
    I + (M − 1) Σ_i a_i² s_i²                      M scans: at most, for the modes of one go with
                                                   the same modes of all others

which discounts score and information as scatter between blades does (`scatter`). Blade by blade:
what surrogates do wrong in many blades alike is not in it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from core.diagnosis.scores import Scores

Array = NDArray[np.float64]


def discount(seen: Scores, g: Array, alone: NDArray[np.bool_]) -> Array:
    """By what the variance of each score (C,) is larger than its information, 1 or more.

    g (B, n, C) signatures; alone: which concern one blade, (C,); all others have 1
    """
    out = np.ones(g.shape[2])
    if seen.unsure is None:
        return out
    for b, rows in enumerate(seen.rows):
        at = np.flatnonzero(alone & np.any(g[b] != 0, axis=0))
        if not len(at):
            continue
        a = seen.information[b] @ g[b][:, at]
        own, more = np.sum(a * g[b][:, at], axis=0), np.zeros(len(at))
        groups: dict[tuple[str, bool], list[int]] = {}
        for i in np.flatnonzero(seen.real[b]):
            reading = rows.readings[seen.place[b, i]]
            groups.setdefault((reading.quantity, reading.values.size > 1), []).append(int(i))
        for (_, scanned), which in groups.items():
            part = a[which] * seen.unsure[b, which, None]
            apart = np.sum(part**2, axis=0)
            if scanned:
                more += (len({int(seen.place[b, i]) for i in which}) - 1) * apart
            else:
                more += np.maximum(np.sum(part, axis=0) ** 2 - apart, 0.0)
        out[at] += more / np.maximum(own, 1e-300)
    return out
