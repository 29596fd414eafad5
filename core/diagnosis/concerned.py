"""Whether all blades that an effect is said of have it, or only some of them.

With the effect in the model at the amplitude a that all blades agree on, let blade b have a + d
in place of a. Its readings' log likelihood, its own parameters integrated out, changes by

    l_b(d) = c_b d − I_b d² / 2,      c_b = gᵀ q_b + h_b,      I_b = gᵀ Q_b g,      g = df/da

to second order (`core.diagnosis.scores`). If a share s of the blades had it, nobody knows which,
and the others nothing, those would have a / s, and the readings of all

    K_s = Σ_b log[ (1 − s) e^{l_b(−a)} + s e^{l_b(a/s − a)} ]

nats more or less than if all have it. "Some" is any of `SHARES`, each as likely as the other.
Beforehand "all" is `ALL` times as likely: lots, coatings, visits and instruments are known, and an
effect follows them more often than nothing that anybody knows.

    K = log mean_s e^{K_s},      P(all | readings) = ALL / (ALL + e^K)

An effect is claimed of all where that is `NAMED`. Half a noise in every blade, and three halves in
a third of them, are the same to a mean and nearly the same to a scatter, which few readings of a
blade with parameters of its own hardly show; so there the answer is that it is open, K ≈ 0, and
where all have two noises it is not, K < −10. Blades that have it may share what no fact tells.

Of fewer than `LEAST_BLADES` blades nothing is asked, nor of amplitudes of more than `WIDE` expected
sizes, where l_b is far from a parabola: each half of the blades has to find these by itself
(`core.diagnosis.parted`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.diagnosis.amplitudes import Amplitude
from core.diagnosis.scatter import LEAST_BLADES
from core.diagnosis.scores import Scores
from core.diagnosis.verdict import NAMED, WIDE

Array = NDArray[np.float64]
SHARES = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])  # more are nearly all
ALL = 3.0  # times as likely as "some", before anything is read
SHOWN = 12  # blades in words


@dataclass(frozen=True, slots=True)
class Concerned:
    """Which blades have an effect that is said of `blades` of them.

    nat    K, of some against all; share: the likeliest, if some
    those  blades that rather have it than not, if some, the surest first; none where all may be
           claimed
    """

    effect: str
    blades: int
    nat: float
    share: float
    those: tuple[str, ...]

    @property
    def all(self) -> float:
        """P(all | readings)."""
        return ALL / (ALL + math.exp(min(self.nat, 700.0)))

    @property
    def stands(self) -> bool:
        """Whether it may be claimed of all.

        >>> [Concerned("wear", 99, nat, 0.3, ()).stands for nat in (-1.2, 0.0, 9.0)]
        [True, False, False]
        """
        return self.all >= NAMED

    def told(self) -> str:
        """In words, where it may not."""
        if self.all > 1.0 - NAMED:
            return (
                f"whether {self.effect} is in all {self.blades} blades or in some of them is open: "
                f"all have {self.all:.0%} of the evidence, {NAMED:.0%} are asked for"
            )
        more = f" and {len(self.those) - SHOWN} others" if len(self.those) > SHOWN else ""
        return (
            f"{self.effect} is not in all {self.blades} blades: that some have it has "
            f"{self.nat:.1f} nat more, about {self.share:.0%} of them, "
            f"{', '.join(self.those[:SHOWN])}{more} rather than the rest"
        )

    def to_json(self) -> dict[str, Any]:
        """Plain JSON."""
        told = {name: getattr(self, name) for name in ("effect", "blades", "all", "share")}
        return told | {"some_nat": self.nat, "those": list(self.those), "stands": self.stands}


def concerned(seen: Scores, effects: Iterable[Amplitude]) -> tuple[Concerned, ...]:
    """Of the effects in a state's model that several blades have."""
    found = []
    for one in effects:
        g = one.slope
        own = np.einsum("bi,bij,bj->b", g, seen.information, g)
        at = np.flatnonzero(own > 0)
        if len(at) < LEAST_BLADES or one.cell.whom == "blade" or abs(one.mean) > WIDE:
            continue
        c = np.einsum("bi,bi->b", g, seen.q) + one.pull.sum(axis=1)
        nat, share, has = shared_out(c[at], own[at], one.mean)
        order = [i for i in np.argsort(-has, kind="stable") if has[i] > 0.5]
        told = Concerned(one.cell.name, len(at), nat, share, ())
        names = tuple(seen.blades[at[i]] for i in order)
        found.append(told if told.stands else replace(told, those=names))
    return tuple(found)


def shared_out(c: Array, own: Array, a: float) -> tuple[float, float, Array]:
    """K, the likeliest share if some have it, and the probability of each blade to be one.

    c, own  of the blades' amplitudes about a, (B,)

    Ten blades that show one amplitude of four sds, and the same mean in two of them:

    >>> alike, two = np.zeros(10), np.r_[16.0 * np.full(2, 4.0), -16.0 * np.ones(8)]
    >>> [round(shared_out(c, np.full(10, 16.0), 1.0)[0]) for c in (alike, two)]
    [-42, 313]
    """
    without = -c * a - 0.5 * own * a**2
    ratio = np.array([math.log(s / (1.0 - s)) for s in SHARES])[:, None]
    d = (a / SHARES - a)[:, None]
    log_odds = ratio + c * d - 0.5 * own * d**2 - without
    log_none = np.log1p(-SHARES)[:, None] + without
    each = np.sum(log_none + np.logaddexp(0.0, log_odds), axis=1)
    best = int(np.argmax(each))
    nat = float(np.logaddexp.reduce(each) - math.log(len(each)))
    has = 1.0 / (1.0 + np.exp(-np.clip(log_odds[best], -700.0, 700.0)))
    return nat, float(SHARES[best]), has
