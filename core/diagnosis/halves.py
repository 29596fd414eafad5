"""Whether an amplitude holds: between halves of the blades, and between early and late readings.

With the effect in the model, at the amplitude a that all readings agree on, let one half have a + d
and the other a − d. The readings' score for d under the posterior (`core.diagnosis.scores`), of
the signature

    g_d = ± df/da      + where a reading is of the first half, − where it is of the second

is zero on average if there is one amplitude; what d could be is d = U_d / (I_d + 1/w²), with a
prior sd w of `WIDE` expected sizes. It is asked at the calibrated amplitude and not at none. df/da
is the slope on a, in rows that the effect concerns, and how it goes with the residual is taken over
the same particles. An amplitude of more than w is outside of that prior, and the answers are far
from linear so far from none: each half is asked by itself (`parted`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from core.diagnosis.amplitudes import Amplitude
from core.diagnosis.grammar import Cell
from core.diagnosis.parted import BLADES, HOURS
from core.diagnosis.scatter import Scatter
from core.diagnosis.scores import Scores
from core.diagnosis.verdict import WIDE, Held

Array = NDArray[np.float64]


def halves(
    seen: Scores, effects: Iterable[Amplitude], again: Callable[[Cell, float, str], Held]
) -> tuple[Held, ...]:
    """Of the effects in a state's model, each in both ways of halving where it concerns enough.

    again   what each half says by itself of an effect: its cell, expected size, how it is halved
    """
    found: list[Held] = []
    for one in effects:
        for by, half in splits(seen, one.slope):
            if abs(one.mean) > WIDE:
                found.append(again(one.cell, one.size, by))
            else:
                found.append(between(seen, one.slope, one.pull, half, one.cell, by, one.mean))
    return tuple(found)


def splits(seen: Scores, g: Array) -> list[tuple[str, NDArray[np.bool_]]]:
    """Ways to halve what a signature g (B, n) concerns: a name, and which rows are the second half.

    Blades by their order of names, readings by their median hour.
    """
    concerned = (g != 0) & seen.real
    blades = np.flatnonzero(concerned.any(axis=1))
    odd = np.broadcast_to(np.isin(np.arange(len(g)), blades[1::2])[:, None], g.shape)
    late = seen.hours > np.median(seen.hours[concerned]) if np.any(concerned) else odd
    ways = ((BLADES, odd), (HOURS, late))
    return [(by, h) for by, h in ways if np.any(concerned & h) and np.any(concerned & ~h)]


def between(
    seen: Scores,
    g: Array,
    h: Array,
    half: NDArray[np.bool_],
    cell: Cell,
    by: str,
    mean: float,
) -> Held:
    """The amplitudes of two halves of a signature g, h (B, n) of one expected size."""
    d = np.where(half, -g, g)[:, :, None]
    efficient = seen.efficient(d)
    pull = np.where(half, -h, h).sum(axis=1)[:, None]
    c = np.einsum("bic,bi->bc", efficient, seen.q) + pull
    own = np.einsum("bic,bij,bjc->bc", efficient, seen.information, efficient)
    u = np.einsum("bic,bi->c", d, seen.q) + pull.sum(axis=0)
    information = np.diag(seen.cross(d))
    concerned, alone = np.any(d != 0, axis=1), np.array([cell.whom == "blade"])
    phi = float(Scatter.of(own, concerned, alone).phi(c, u, information)[0])
    variance = 1.0 / (float(information[0]) / phi + 1.0 / WIDE**2)
    off = variance * float(u[0]) / phi
    return Held(by, (mean + off, mean - off), 2.0 * float(np.sqrt(variance)), cell.name)
