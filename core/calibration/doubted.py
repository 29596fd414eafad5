"""Blades for which the noise of all readings may have made up: who is tried with a floor.

A reading of s noises among n of them, alone with a noise that all share, widens it to
σ² (1 + s²/n) and is then z = s / √(1 + s²/n) sds off. With the others at their own noise again and
the blade at its floor f (`bounded`), the evidence gains

    (n/2) log(1 / (1 − z²/n)) − (½ chi²_R(e^−20) + DOUBT),

what the others gain by their smaller noise, less what a gross error costs; and about z²/2 more, for
the blade's other readings were left by the fit for the wrong one and miss by as much again. z² is
told by a look at the blade's visits, each foreseen from its other readings (`cavity`). Blades that
look exchanged are doubted together. It is an estimate, and a placement of the nodes may be spent in
vain: what is taken is decided by the evidence itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from core.calibration.health import most_of
from core.calibration.looked import Looked
from core.calibration.message import BladeMessage
from core.calibration.noisier import kind


def doubted(
    messages: Mapping[str, BladeMessage],
    looked: Looked,
    doubt: float,
) -> list[tuple[str, ...]]:
    """Groups of blades that may be gross errors, the likeliest first.

    looked  at all visits: which pairs look exchanged, which visits are noisier than told
    doubt   −log of the probability of a gross error [nat]
    """
    count = sum(len(m.rows.of) - m.rows.of.count(-1) for m in messages.values())
    worst = {}
    for blade, own in looked.looks.items():
        out = looked.paired | {blade}
        sizes = (one.misfit / looked.scatter.variance([kind(one)], out) for one in own.values())
        worst[blade] = max(sizes, default=0.0)
    pairs = [tuple(one["blades"]) for one in looked.exchanged]
    paired = {blade for pair in pairs for blade in pair}
    groups = [*pairs, *((b,) for b in sorted(worst) if b not in paired)]
    gains = []
    for group in groups:
        z2 = sum(worst[b] for b in group)
        cost = sum(0.5 * most_of(len(messages[b].rows.y)) + doubt for b in group)
        gains.append((gain(z2, count, cost), group))
    return [group for least, group in sorted(gains, key=lambda g: (-g[0], g[1])) if least > 0]


def gain(z2: float, count: int, cost: float) -> float:
    """By how much the evidence may be for a gross error [nat].

    >>> [round(gain(z**2, n, 32.0), 1) for n, z in ((108, 6.6), (108, 4.0), (600, 5.0))]
    [17.7, -15.3, -6.7]
    """
    if z2 >= count:
        return math.inf
    return -0.5 * count * math.log1p(-z2 / count) - (cost - 0.5 * z2)
