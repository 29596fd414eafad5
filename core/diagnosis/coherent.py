"""The simulation errs alike at many readings, and that is no effect.

Messages take what surrogate and mesh do not know as independent from reading to reading. It is not:
at all visits of a blade its inputs are the same, and blades of a rotor have nearly the same, so
that where the surrogate is off it is off in the same way. With a = Q g⊥ the weights of the rows in
the score u and s_i the simulation's sd of row i (`Scores.unsure`), the score's variance is not I
but, of an effect of one blade,

    I + max(0, (Σ_i a_i s_i)² − Σ_i a_i² s_i²)     values of a quantity, wholly correlated
    I + (M − 1) Σ_i a_i² s_i²                      M scans: at most, for the modes of one go with
                                                   the same modes of all others

and of an effect of several

    I + rho |Σ_b,i a_bi L_bi|²                     L_bi, `loadings`: of values s_i; of scans rows of
                                                   W R C^½, each as long as its s_i

with C the covariance of the error of the modes' coefficients (`core.calibration.scans`: W R are a
scan's rows as mixtures of modes), wholly correlated over visits, and by rho over blades: the mean
correlation of the surrogate's error between them (`core.surrogate.alike`). Both discount score
and information as scatter between blades does (`scatter`). What shared parameters make up for is
out of g⊥. Where noise rules it is little: elongations of a hundred blades. In scanned fleets with
an effect in the model it is what a found effect leaves: the surrogate of wide runs is off by a few
per cent of it, in all blades alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from core.calibration.target import BladeRows
from core.diagnosis.scores import Scores
from core.model import Model

Array = NDArray[np.float64]
TINY = 1e-300


def loadings(model: Model, rows: BladeRows, unsure: Array) -> dict[str, Array]:
    """L of the module's text for the rows of one blade, (n, M) of each kind of reading.

    unsure  s, (n,)
    """
    found: dict[str, Array] = {}
    of = np.array(rows.of[: len(unsure)])
    for place, reading in enumerate(rows.readings):
        at, kind = np.flatnonzero(of == place), reading.quantity
        own = unsure[at, None]
        if (mixing := rows.mixings.get(place)) is not None:
            value, vector = np.linalg.eigh(model.part(kind).mode_covariance(reading.time_h))
            root = (vector * np.sqrt(np.maximum(value, 0.0))) @ vector.T
            modes = mixing.turn @ mixing.modes @ root
            own = own * modes / np.maximum(np.linalg.norm(modes, axis=1), TINY)[:, None]
            kind = f"scans of {kind}"
        found.setdefault(kind, np.zeros((len(unsure), own.shape[1])))[at] = own
    return found


def joined(each: Sequence[Mapping[str, Array]], rows: int) -> Array:
    """Those of all blades beside each other, (B, n, M): the same columns for the same kind."""
    width = {kind: one.shape[1] for blade in each for kind, one in blade.items()}
    first = dict(zip(width, np.cumsum([0, *width.values()]).tolist(), strict=False))
    out = np.zeros((len(each), rows, sum(width.values())))
    for b, blade in enumerate(each):
        for kind, one in blade.items():
            out[b, : len(one), first[kind] : first[kind] + width[kind]] = one
    return out


def discount(seen: Scores, g: Array, alone: NDArray[np.bool_], information: Array) -> Array:
    """By what the variance of each score (C,) is larger than its information (C,), 1 or more.

    g (B, n, C) signatures; alone: which concern one blade, (C,)
    """
    out = np.ones(g.shape[2])
    if seen.alike is not None:
        weighed = seen.information @ seen.alike
        shared = np.tensordot(seen.deviation, g, axes=((0, 1), (0, 1)))
        off = np.tensordot(g, weighed, axes=((0, 1), (0, 1)))
        off -= shared.T @ np.tensordot(seen.imitated, weighed, axes=((0, 1), (0, 1)))
        out += np.sum(off**2, axis=1) / np.maximum(information, TINY)
        out[alone] = 1.0
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
        out[at] += more / np.maximum(own, TINY)
    return out
