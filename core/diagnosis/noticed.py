"""From which size on an effect would have been noticed: what `adequate` is worth.

That nothing was found says much where it would have been, and nothing where it could not. So each
family that concerns several blades is planted into dealt sets (`dealing`), which have what blades
scatter by and nothing in common. An effect of amplitude a with signature g moves a blade's score by

    q → q + a Q g⊥

(`scores`: g⊥ is what the shared parameters do not imitate), and the same test is asked whether it
alarms: the mean Bayes factor of all families against its level in sets dealt from residuals which
have the effect as well, for that is what the test would have had to deal. The least amplitude for
which `ENOUGH` of the sets alarm is found by halving about a guess, up to `MOST` times the expected
size: what would have to be larger is not looked for by the grammar either, and such readings cannot
contradict the model. What a rotor tells of its own scatter is uncertain, and with it the level:
sizes of like rotors differ by a seventh, so that `ENOUGH` of its sets have to alarm for
`PROBABILITY` of rotors to do (0.95 and with heavy tails 0.92 of them did: `tests/claims`).

A rotor that has the effect is calibrated with it, though. Its blades' parameters follow farther
than to first order, and what is left counts in part as noise: in finite-element fleets the score
moved by 0.91 of a Q g⊥ for a campaign's offset, by 0.70 to 0.77 for wear, fouling and a step of the
gas. So the least of these, `LEFT`, is what is planted: sizes are told on the safe side.

Where a family runs in several ways (courses, hours of a step, campaigns) the cell with the most
information and the one with the least are planted, so that two sizes are told; one where these
hardly differ. To second order, as the scan is. Families of one blade are left out: in clean fleets
theirs hardly ever alarm.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.calibration.message import POOL
from core.diagnosis.adopt import WIDTH, amplitude_of, expected
from core.diagnosis.dealing import Deck, dealt_sets
from core.diagnosis.densities import amplitude_unit
from core.diagnosis.grammar import Cell
from core.diagnosis.scan import Scan
from core.diagnosis.signature import Signatures
from core.diagnosis.verdict import ALARM, DEALT
from core.model import Model

Array = NDArray[np.float64]
PROBABILITY, ENOUGH = 0.9, 0.95
LEFT = 0.7  # of a score, once the model is calibrated with what moves it
PLANTED, DEALS = 60, 60  # sets that an effect is planted in; that tell how it lifts the level
LEAST, MOST = 0.05, WIDTH  # in expected sizes
ALIKE = 1.2  # information of cells by so little apart tells no size apart
NEAR, HALVINGS = 1.6, 3  # factor about a guess; to 12 % from there, as the sets themselves are
NOTHING = (
    "no effect of the sizes that are expected would have been noticed: these readings are too few "
    "to contradict the model"
)


@dataclass(frozen=True, slots=True)
class Noticed:
    """Sizes of a family's effects that would have been noticed.

    easiest, hardest  the cells that readings tell most and least of, the same where there is one
    least, most       their amplitudes, in the unit of the family's; none: larger than is looked for
    """

    easiest: Cell
    hardest: Cell
    least: float | None
    most: float | None

    def to_json(self, model: Model) -> dict[str, Any]:
        """Plain JSON; units are the model's."""
        cell, family = self.easiest, self.easiest.family
        told = {"family": family.name, "whom": cell.whom, "kind": family.kind}
        told |= {"on": family.target, "target": family.of, "how": family.how}
        told |= {"of": amplitude_of(cell), "unit": amplitude_unit(cell, model)}
        ends = {"least": self.least, "easiest": _which(cell)}
        return told | ends | {"most": self.most, "hardest": _which(self.hardest)}


def noticed(
    scan: Scan, noise: Mapping[str, float], seed: int, dealt: int = DEALT, *, could: bool = True
) -> tuple[Noticed, ...]:
    """What a scan without an alarm would have noticed, in the order of its families.

    noise  from which offsets without a size have theirs, by quantity
    seed   that of the test; it deals the same sets
    could  whether the readings can contradict the model at all: else of no size
    """
    if all(cell.whom == "blade" for cell in scan.cells):
        return ()
    trial = Trial.of(scan, seed, dealt)
    several, own = trial.scan, dict[int, float | None]()

    def size(i: int) -> float | None:
        if i not in own:
            own[i] = trial.size(i, noise) if could else None
        return own[i]

    told, out = np.diag(several.information), []
    for places in several.families.values():
        order = sorted(places, key=lambda i: (-told[i], i))
        first, last = order[0], order[-1]
        last = first if told[last] * ALIKE > told[first] else last
        cells = several.cells[first], several.cells[last]
        out.append(Noticed(*cells, size(first), size(last)))
    return tuple(out)


@dataclass(frozen=True)
class Trial:
    """The test of a scan without cells of one blade, on sets with an effect.

    share  of its families among all, and so of the false alarms
    sets   dealt ones, to be planted in; level: of the readings as they are; few: of those of `deck`
    deck   `DEALS` sets, dealt from readings with an effect
    """

    scan: Scan
    share: float
    deck: Deck
    sets: Array
    level: float
    few: float

    @staticmethod
    def of(scan: Scan, seed: int, dealt: int = DEALT) -> Trial:
        """Of the scan of a rotor with several blades' families, or of any."""
        scan, share = _of_several(scan), float(np.mean(~scan.of_one_blade))
        sets, deck = dealt_sets(scan.seen, dealt, seed), Deck.of(scan.seen, DEALS, seed)
        level, few = (_level(scan, of, share) for of in (sets, deck.sets(scan.seen.q)))
        return Trial(scan, share, deck, sets[:PLANTED], level, few)

    def size(self, i: int, noise: Mapping[str, float]) -> float | None:
        """The amplitude of a cell, by its place, that is noticed in `ENOUGH` of the sets."""
        seen = self.scan.seen
        along = seen.efficient(self.scan.g[:, :, [i]])[:, :, 0]
        moved = LEFT * np.einsum("bij,bj->bi", seen.information, along)
        if (guess := self._guess(i)) > MOST * NEAR:
            guess = MOST  # nearly nothing is told of it
        low, high = guess / NEAR, min(NEAR * guess, MOST)
        while not self.alarms(high * moved):
            if high >= MOST:
                return None
            low, high = high, min(NEAR**2 * high, MOST)
        while low > LEAST and self.alarms(low * moved):
            low, high = low / NEAR**2, low
        for _ in range(HALVINGS):
            middle = math.sqrt(low * high)
            low, high = (low, middle) if self.alarms(middle * moved) else (middle, high)
        return high * expected(self.scan.cells[i], noise)

    def alarms(self, moved: Array) -> bool:
        """Whether `ENOUGH` of the sets alarm with an effect that moves scores (B, n)."""
        deals = self.deck.sets(self.scan.seen.q + moved)
        higher = _level(self.scan, deals, self.share) - self.few
        left = math.floor((1.0 - ENOUGH) * len(self.sets) + 1e-9)
        for q in self.sets:  # most are done after a few
            left -= _one(self.scan, q + moved) < self.level + higher
            if left < 0:
                return False
        return True

    def _guess(self, i: int) -> float:
        """By the cell alone: as many sds as its Bayes factor needs, and some for chance."""
        own = float(self.scan.information[i, i])
        sds = math.sqrt(2.0 * max(self.level + 0.5 * math.log1p(own), 0.5)) + 1.0
        return sds / (LEFT * math.sqrt(own)) if own > 0 else math.inf


def _level(scan: Scan, sets: Array, share: float) -> float:
    """What a share `ALARM` of sets reaches, that of these families."""
    return float(np.quantile(_together(scan, sets), 1.0 - ALARM * share, method="higher"))


def _together(scan: Scan, sets: Array) -> Array:
    """log of the families' mean Bayes factor of sets (K, B, n), times the families' number."""
    return np.array(list(POOL.map(partial(_one, scan), sets)))


def _one(scan: Scan, q: Array) -> float:
    return float(np.logaddexp.reduce(scan.of_set(q)))


def _of_several(scan: Scan) -> Scan:
    """Without what concerns one blade."""

    def part(places: list[int]) -> Signatures:
        return Signatures(scan.g[:, :, places], scan.h[:, :, places])

    kept = [i for i, cell in enumerate(scan.cells) if cell.whom != "blade"]
    free = {n: part(list(at)) for n, at in scan.free.items() if not n.endswith(", blade")}
    return Scan.of([scan.cells[i] for i in kept], scan.seen, part(kept), free)


def noticed_json(found: Sequence[Noticed], model: Model) -> dict[str, Any]:
    """All of them, with the probabilities they go by."""
    each = [one.to_json(model) for one in found]
    return {"probability": PROBABILITY, "alarm": ALARM, "families": each}


def in_words(found: Sequence[Noticed]) -> tuple[str, ...]:
    """That nothing would have been noticed, where that is so."""
    return (NOTHING,) if found and all(one.least is None for one in found) else ()


def _which(cell: Cell) -> str:
    """A cell among those of its family: whom of them, its course, its hour."""
    step = None if cell.step_h is None else f"at {cell.step_h:,.0f} h"
    told = [cell.value, step or (cell.shape if len(cell.family.shapes) > 1 else None)]
    return ", ".join(one for one in told if one)
