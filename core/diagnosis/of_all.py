"""What inspecting every blade at once would tell of rivals.

The mutual information of rival and readings, and what the shares of the evidence would be, as for
a few readings (`core.diagnosis.separate`), of a whole campaign (`core.planning.campaigns`): by
`DRAWS` draws from each rival's expectation, the same standard-normal numbers for all rivals.

Effects that a few readings of elongation leave alike often differ in the blades' shapes, or in what
all blades together say to a tenth of one reading's noise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from core.calibration.message import POOL
from core.diagnosis.separate import Rival, Told, afterwards, scored
from core.planning.campaigns import Campaign, awaited
from core.planning.moments import Awaited

Array = NDArray[np.float64]
DRAWS = 512


def told_by(p: Array, each: Sequence[Awaited], seed: int = 0) -> Told:
    """What a campaign tells, by what each of K rivals expects of it; p (K,) their shares."""
    out = np.zeros(3)
    for k, rival in enumerate(each):
        y = rival.drawn(DRAWS, np.random.default_rng(seed))
        after = afterwards(p, np.stack([one.log_density(y) for one in each]))
        out += p[k] * np.array([np.mean(values) for values in scored(p, after, k)])
    return Told(max(float(out[0]), 0.0), float(out[1]), float(out[2]))


def of_all(
    rivals: Sequence[Rival],
    asked: Sequence[Campaign],
    known: Mapping[str, Mapping[str, float]] | None = None,
    say: Callable[[str], None] = lambda what: None,
) -> tuple[tuple[Campaign, Told], ...]:
    """Campaigns by what they would tell of the rivals, largest first; of those that tell as much to
    a hundredth of a nat the one that is sooner.

    Instruments that no rival tells apart are asked about once, by none's name.
    """
    p = np.maximum(np.array([r.weight for r in rivals], float), 1e-12)
    p /= p.sum()
    kinds = dict.fromkeys(
        one if _told_apart(rivals, one.quantity) else replace(one, instrument=None) for one in asked
    )
    found = []
    for one in kinds:
        say(f"what {one.quantity} of all blades would tell")
        found.append((one, told_by(p, _awaited_by(rivals, one, known))))
    return tuple(sorted(found, key=lambda item: (-round(item[1].gain, 2), item[0].ahead_h)))


def _awaited_by(
    rivals: Sequence[Rival], asked: Campaign, known: Mapping[str, Mapping[str, float]] | None
) -> list[Awaited]:
    """What each expects, side by side."""
    return list(POOL.map(lambda r: awaited(r.model, r.state, asked, known), rivals))


def _told_apart(rivals: Sequence[Rival], quantity: str) -> bool:
    """Whether it matters who reads a quantity."""
    own = [r.model.network for r in rivals]
    biased = any(b.quantity == quantity and b.instrument is not None for n in own for b in n.biases)
    return biased or any(n.quantity(quantity).by_instrument for n in own)
