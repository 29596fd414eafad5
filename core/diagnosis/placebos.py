"""Placebos: the effect that is to be claimed, where it is not.

An effect that is there explains readings because it is where it is said to be and runs as it is
said to run. Given to others, the same effect, as large, explains next to nothing; where it explains
as much, something else is there (one odd blade, say, which any other lot that has it would explain
as well). So each effect is held against itself in other places:

    other blades     as many as it is of, drawn from all; where all have it, a drawn half of them
                     has it the other way round
    other readings   readings of each blade exchanged at random, single values with single values
                     of the same quantity and scans with scans: a sensor's fault at other readings,
                     physics at other times

A placebo gains what the scan says of it (`core.diagnosis.scan`: log Bayes factor to second order,
scatter between blades and single readings that may be misread included), from the residuals of the
model without the effect and with all others. What simulations err by in all blades alike is left
out (`coherent`): it would be held against the effect, and not against one that is turned in half of
them. One that is the effect itself for the most part is none: with I the information matrix of
both, those of

    rho = I_0k / sqrt(I_00 I_kk) > `ALIKE`

are left out. It wins where it gains as much as the effect. Of `COUNT` that are drawn no more than
`ALLOWED` may win, or nothing is claimed; where `LEAST` are not left, nothing can be asked. Nor can
it where the scan does not see the effect by itself (`SEEN`) and the filter's evidence is all there
is: an effect beside which another one has grown, say. What gains nothing would win there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.diagnosis.grammar import Cell, Facts
from core.diagnosis.masks import masks
from core.diagnosis.scan import Scan
from core.diagnosis.scores import Scores
from core.diagnosis.signature import Change, Order, Signatures
from core.diagnosis.verdict import Verdict
from core.rng import stream

Array = NDArray[np.float64]
Drawn = Callable[[np.random.Generator], tuple[Array, Array]]
COUNT = 199
ALLOWED = 0.05
ALIKE = 0.7  # half of the effect's own fit
SEEN = 2.0  # nats, below which the scan's gain says nothing of an effect
LEAST = 19  # of which none wins in 95 of 100 cases by chance
BLADES, READINGS = "other blades", "other readings"


@dataclass(frozen=True, slots=True)
class Placebo:
    """How many placebos of an effect were asked, of one kind, and how many gained as much.

    gained, best   log Bayes factors of the effect and of the best placebo [nat]
    """

    effect: str
    by: str
    count: int
    won: int
    gained: float
    best: float

    @property
    def stands(self) -> bool:
        """Whether the effect may be claimed.

        >>> Placebo("wear", BLADES, 100, 5, 9.0, 9.5).stands
        True
        >>> Placebo("wear", BLADES, 100, 6, 9.0, 9.5).stands
        False
        >>> Placebo("wear", BLADES, 100, 60, -0.5, 1.5).stands
        True
        """
        return self.won <= ALLOWED * self.count or self.gained < SEEN

    @property
    def told(self) -> str:
        """That it does not stand, in words."""
        return (
            f"{self.effect} explains no more than it would at {self.by}: of {self.count} placebos "
            f"{self.won} gain as much, where {ALLOWED:.0%} may"
        )

    def to_json(self) -> dict[str, Any]:
        """Plain JSON."""
        named = {"gained": "gained_nat", "best": "best_nat"}
        return {named.get(k, k): v for k, v in asdict(self).items()} | {"stands": self.stands}


def placebos(
    seen: Scores, cell: Cell, facts: Mapping[str, Facts], changed: Change, seed: int
) -> tuple[Placebo, ...]:
    """Of one effect, of each kind that can be asked.

    seen     under the model with all effects but this one
    changed  g and h (B, n) of the effect if all readings had it, rows in an order (B, n)
    """
    own = masks([cell], seen, facts)[:, :, 0]
    whole = masks([replace(cell, whom="all", value=None)], seen, facts)[:, :, 0]
    here = np.tile(np.arange(own.shape[1]), (len(own), 1))
    real = changed(here)
    kinds = {BLADES: _by_blades(cell, real, own, whole), READINGS: _by_readings(seen, own, changed)}
    found, seen = [], replace(seen, alike=None)
    for by, drawn in kinds.items():
        rng = stream(seed, "placebos", cell.name, by)
        made = {(own * real[0]).tobytes(): tuple(own * one for one in real)}
        for one in (drawn(rng) for _ in range(COUNT)):
            made.setdefault(one[0].tobytes(), one)  # of few blades many are the same
        if len(made) <= LEAST:
            continue
        g, h = (np.stack(part, axis=2) for part in zip(*made.values(), strict=True))
        scan = Scan.of([cell] * len(made), seen, Signatures(g, h))
        information = np.diag(scan.information)
        rho = scan.information[0] / np.sqrt(np.maximum(information[0] * information, 1e-300))
        apart = np.flatnonzero(rho[1:] <= ALIKE) + 1
        if len(apart) >= LEAST:
            gains, best = scan.gains[apart], float(scan.gains[apart].max())
            won, gained = int(np.sum(gains >= scan.gains[0])), float(scan.gains[0])
            found.append(Placebo(cell.name, by, len(apart), won, gained, best))
    return tuple(found)


def _by_blades(
    cell: Cell, real: tuple[Array, Array], own: NDArray[np.bool_], whole: NDArray[np.bool_]
) -> Drawn:
    """g and h where other blades have it, or half of all the other way round."""
    concerned, could = own.any(axis=1), np.flatnonzero(whole.any(axis=1))

    def drawn(rng: np.random.Generator) -> tuple[Array, Array]:
        size = np.zeros(len(own))
        if cell.whom in ("lot", "coating_lot", "blade"):
            size[rng.choice(could, int(concerned.sum()), replace=False)] = 1.0
            mask = size[:, None] * whole
        else:
            size[could] = 1.0
            size[rng.choice(could, len(could) // 2, replace=False)] = -1.0
            mask = size[:, None] * own
        return real[0] * mask, real[1] * mask

    return drawn


def _by_readings(seen: Scores, own: NDArray[np.bool_], changed: Change) -> Drawn:
    """g and h where other readings of the same blades have it."""
    alike = [_alike(seen, b) for b in range(len(own))]

    def drawn(rng: np.random.Generator) -> tuple[Array, Array]:
        order = np.tile(np.arange(own.shape[1]), (len(own), 1))
        for b, groups in enumerate(alike):
            for group in groups:
                for k, other in enumerate(rng.permutation(len(group))):
                    order[b, group[k]] = group[other]
        g, h = changed(order)
        mask = np.take_along_axis(own, order, axis=1)
        return g * mask, h * mask

    return drawn


def _alike(seen: Scores, b: int) -> list[list[Order]]:
    """Rows of a blade's readings that can be exchanged, a list of readings for each kind."""
    rows: dict[int, list[int]] = {}
    for i in np.flatnonzero(seen.real[b]):
        rows.setdefault(int(seen.place[b, i]), []).append(int(i))
    found: dict[tuple[str, int], list[Order]] = {}
    for place, own in rows.items():
        kind = (seen.rows[b].readings[place].quantity, len(own))
        found.setdefault(kind, []).append(np.array(own, dtype=np.intp))
    return [group for group in found.values() if len(group) > 1]


def withstood(verdict: Verdict, found: Sequence[Placebo]) -> Verdict:
    """The verdict, which claims nothing where placebos win."""
    lost = [one.told for one in found if not one.stands]
    if not lost:
        return verdict
    reasons = (*lost, *verdict.reasons)
    return replace(verdict, word="unattributed", names=(), beside=(), reasons=reasons)
