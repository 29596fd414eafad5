"""One reading is no evidence of an effect in one blade: it may be misread.

Of a blade that is read a few times, a slip of 0.2 mm looks like a rub at its tip, and where noise
has heavy tails some blade of a hundred has one. Nothing within the readings tells them apart: what
a single reading carries would be claimed of the blade, and go on into its forecast. So an effect of
one blade counts by what is left of it without any one reading, the least of all of them. With
C = Q⁻¹ the covariance of a blade's rows, of which row i is left out,

    u₍ᵢ₎ = u − a_i q_i / Q_ii − h_i,      I₍ᵢ₎ = I − a_i² / Q_ii,      a = Q g

are score and information of the others (the inverse of a matrix without a row and column). What is
read at many nodes at once is no slip of one value and stays in. Dealt sets (`dealing`) are asked
the same, so that the test keeps its size. Such a reading is told in words (`slips`).

So do effects of an instrument or a campaign that read few of the blades, half of them at most, as a
reading that was taken again between two outages: one slip would be the zero of the whole campaign.
Of `LEAST_BLADES` or more their scatter about the effect tells (`scatter`). And so do effects of the
rest: where one reading of a blade is by another instrument, a gain of the usual one is told by this
reading alone, which is not among those that it concerns.

A blade that contradicts by one reading, and is `bounded` in its state, has particles that were
fitted to that reading: its residuals at the others are as wrong as at this one. Of such a blade
nothing is scanned (`apart`), and the verdict says so (`set_apart`). One whose readings contradict
together stays in: an effect of its own may be what they have in common. So do two blades whose
readings look exchanged: an instrument three noises off makes some look so, and without
them what was left behind its offset was called more than chance.

One value of half of the blades at a visit was hardly read of them (`copied`). A sigma that is
stated too small (how well a gauge repeats, say, and not how well it is set up) is no free
parameter, so that everything contradicts (`understated`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from core.calibration.state import RotorState
from core.diagnosis.bayes import one_by_one
from core.diagnosis.grammar import Cell, few
from core.diagnosis.left_out import LeftOut
from core.diagnosis.scatter import LEAST_BLADES
from core.diagnosis.scores import Scores
from core.observation import Inspection

Array = NDArray[np.float64]
RARE = 0.01  # of rotors with normal noise have a reading so far off
TOLD = 5
NORMAL = 1.4826  # sd of a normal variable over the median of its size
FARTHER, SURELY = 1.5, 4.0  # times as far as stated, and in sds of that, before it is told
LONE = 3.0  # blades that have an effect's information, below which one value may be all of it


@dataclass(frozen=True)
class Spared:
    """Cells (`spared`) without each of their readings in turn, L of both together.

    cell, blade, row  (L,); share: a_i / Q_ii, lost: a_i² / Q_ii, pull: h_i, (L,) each
    """

    cell: NDArray[np.intp]
    blade: NDArray[np.intp]
    row: NDArray[np.intp]
    share: Array
    lost: Array
    pull: Array

    @staticmethod
    def of(seen: Scores, g: Array, h: Array, alone: NDArray[np.bool_]) -> Spared:
        """Of signatures g with their covariances h, (B, n, C); alone: which are spared, (C,)."""
        single = np.array(
            [
                [place >= 0 and rows.readings[place].values.size == 1 for place in own]
                for rows, own in zip(seen.rows, seen.place.tolist(), strict=True)
            ]
        ).reshape(seen.place.shape)
        found: list[tuple[int, int, int]] = []
        part: list[Array] = []
        for c in np.flatnonzero(alone):
            for b in np.flatnonzero(np.any(g[:, :, c] != 0, axis=1)):
                rows_ = np.flatnonzero(single[b])
                q = seen.information[b]
                own = np.diag(q)[rows_]
                sure = own > 0
                a = (q @ g[b, :, c])[rows_]
                share = np.where(sure, a / np.where(sure, own, 1.0), 0.0)
                found += [(int(c), int(b), int(i)) for i in rows_]
                part.append(np.array([share, share * a, h[b, rows_, c]]))
        cell, blade, row = np.array(found, dtype=np.intp).reshape(-1, 3).T
        share, lost, pull = np.concatenate([np.empty((3, 0)), *part], axis=1)
        return Spared(cell, blade, row, share, lost, pull)

    def least(
        self,
        gains: Array,
        u: Array,
        q: Array,
        information: Array,
        phi: Array,
        signs: NDArray[np.int64],
        pulled: bool = True,
    ) -> Array:
        """log BF of each cell (C,), of those that are spared the least without a reading.

        u, phi, signs (C,), q (B, n); information: of each cell by itself, (C,); pulled: whether
        the scores have their covariances in them
        """
        without = u[self.cell] - self.share * q[self.blade, self.row] - pulled * self.pull
        left = np.maximum(information[self.cell] - self.lost, 0.0)
        own = one_by_one(without, left, phi[self.cell], signs[self.cell])
        out = gains.copy()
        np.minimum.at(out, self.cell, own)
        return out


def alone_of(cells: Sequence[Cell], columns: int) -> NDArray[np.bool_]:
    """Columns that concern one blade, (columns,); cells come first."""
    out = np.zeros(columns, bool)
    out[: len(cells)] = [cell.whom == "blade" for cell in cells]
    return out


def spared(cells: Sequence[Cell], g: Array, own: Array) -> NDArray[np.bool_]:
    """Columns of signatures g (B, n, C) that one misread value could make, (C,).

    Those of one blade, or of a lot of which one was read; of an instrument or a campaign that read
    few of the blades, or of which a blade or two have the information (own, (B, C)).
    """
    whom = np.array([cell.whom for cell in cells] + ["all"] * (g.shape[2] - len(cells)))
    read = np.any(g != 0, axis=1).sum(axis=0)
    tell = own.sum(axis=0) ** 2 / np.maximum(np.sum(own**2, axis=0), 1e-300)
    few = (read < LEAST_BLADES) & (2 * read <= len(g)) | (tell < LONE) & (2 * tell <= len(g))
    few &= np.isin(whom, ("instrument", "campaign"))
    lone = (whom != "all") & (read == 1) & (len(g) > 1)
    return np.asarray(alone_of(cells, g.shape[2]) | few | lone)


def apart(state: RotorState) -> frozenset[str]:
    """Blades that are set apart by one reading."""
    told = state.meta["health"].get("contradicted", ())
    return frozenset(one["blade"] for one in told if one.get("bounded") and one.get("suspects"))


def set_apart(state: RotorState) -> tuple[str, ...]:
    """That they were, in words; and which blades look exchanged, who stay in."""
    told = (
        ("left out of the scan, for one reading contradicts all others of the blade", apart(state)),
        ("readings of a visit look exchanged, look at these first", _exchanged(state)),
    )
    return tuple(f"{why}: {few(sorted(blades), TOLD)}" for why, blades in told if blades)


def _exchanged(state: RotorState) -> frozenset[str]:
    told = state.meta["health"].get("exchanged", ())
    return frozenset(blade for one in told for blade in one["blades"])


def slips(read: LeftOut) -> tuple[str, ...]:
    """Readings that lie too far from what all others say, in words; the farthest first."""
    if not (count := len(read.readings)):
        return ()
    limit = float(norm.isf(0.5 * RARE / count))
    far = [int(i) for i in np.argsort(-np.abs(read.z), kind="stable") if abs(read.z[i]) > limit]
    if not far:
        return ()
    told = [_told(read.readings[i], float(read.z[i])) for i in far[:TOLD]]
    told += [f"{len(far) - TOLD} more"] if len(far) > TOLD else []
    return (
        f"farther than {limit:.1f} sd from what all others say, and maybe misread: "
        f"{', '.join(told)}; no effect of a blade is claimed from a single reading",
    )


def understated(read: LeftOut) -> tuple[str, ...]:
    """That readings lie farther from what all others say than their stated sigma has it, in words,
    by quantity and instrument.

    Their z has the scale 1.48 median |z|, to which single readings that are misread matter little;
    of n sound readings it is known to 1.17 / √(2n).
    """
    groups: dict[tuple[str, str | None], list[int]] = {}
    for i, one in enumerate(read.readings):
        if one.sigma is not None:
            groups.setdefault((one.quantity, one.instrument), []).append(i)
    told = []
    for (quantity, instrument), own in sorted(
        groups.items(), key=lambda g: (g[0][0], str(g[0][1]))
    ):
        scale = NORMAL * float(np.median(np.abs(read.z[own])))
        if scale > max(FARTHER, 1.0 + SURELY * 1.17 / np.sqrt(2 * len(own))):
            stated = float(np.median([read.readings[i].sigma or 0.0 for i in own]))
            by = f" by {instrument}" if instrument else ""
            told.append(
                f"{len(own)} readings of {quantity}{by} lie {scale:.1f} times as far from what all "
                f"others say as their stated sigma has it ({stated:.3g}): where the model lacks "
                "nothing, state that of the whole reading, its set-up included, or none, so that "
                "it is calibrated"
            )
    return tuple(told[:TOLD])


def _told(reading: Inspection, z: float) -> str:
    return f"{reading.id} (blade {reading.blade}, {reading.time_h:,.0f} h, {z:+z.1f} sd)"


def copied(readings: Sequence[Inspection]) -> tuple[str, ...]:
    """That one value stands for half of the blades of a visit, or more, in words: at most `TOLD`.

    >>> data = [Inspection(str(b), f"B{b}", "y", 9e3, [0.3], campaign="c") for b in range(9)]
    >>> copied(data)
    ('y is 0.3 in 9 of 9 blades in campaign c: copied, or rounded too coarsely?',)
    >>> copied(data[:7])
    ()
    """
    visits: dict[tuple[str, int, str, float], dict[str, float]] = {}
    for one in readings:
        if one.values.size == 1:
            node = -1 if one.nodes is None else int(one.nodes[0])
            when = (one.campaign, 0.0) if one.campaign else ("", one.time_h)
            visits.setdefault((one.quantity, node, *when), {})[one.blade] = float(one.values.item())
    told = []
    for (quantity, node, campaign, hour), read in sorted(visits.items()):
        value, count = Counter(read.values()).most_common(1)[0]
        if count >= max(LEAST_BLADES, 0.5 * len(read)):
            place = "" if node < 0 else f" at node {node}"
            at = f"in campaign {campaign}" if campaign else f"at {hour:,.6g} h"
            told.append(
                f"{quantity}{place} is {value:.6g} in {count} of {len(read)} blades {at}: "
                "copied, or rounded too coarsely?"
            )
    return tuple(told[:TOLD])
