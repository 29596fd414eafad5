"""Whether all blades that an effect is said of have it, or only some of them.

With the effect in the model at the amplitude a that all blades agree on, let blade b have a + d
in place of a. Its readings say of d, its own parameters integrated out and to second order
(`core.diagnosis.scores`),

    c_b ~ N(I_b d, phi I_b),      c_b = gᵀ q_b + h_b,      I_b = gᵀ Q_b g,      g = df/da

where phi is one if the noise is known. It is not: it is calibrated along, and takes amplitudes that
differ for its own, so that blades scatter less about theirs than they should. If a share s of the
blades had the effect, nobody knows which, and the others nothing, those would have a / s. With

    l_b(d, phi) = −(c_b − I_b d)² / (2 phi I_b) − ½ log phi

all blades, or a share of them, have the evidence

    E_1 = log mean_phi exp Σ_b l_b(0, phi)
    E_s = log mean_phi exp Σ_b log[ (1 − s) e^{l_b(−a, phi)} + s e^{l_b(a/s − a, phi)} ]

over phi evenly on a logarithmic scale (`PHI`). "Some" is any of `SHARES`, each as likely as the
other. Beforehand "all" is `ALL` times as likely: gas, air, lots, coatings, visits and instruments
are what blades have in common, so that where readings tell nothing, an effect is of all of them.

    K = log mean_s e^{E_s} − E_1,      P(all | readings) = ALL / (ALL + e^K)

An effect is claimed of all where that is `NAMED`. Half a noise in every blade, and three halves in
a third of them, are the same to a mean and nearly the same to a scatter, which few readings of a
blade with parameters of its own hardly show; so there the answer is that it is open, K ≈ 0, and
where all have two noises it is not, K < −6. Blades that have it may share what no fact tells.

Of fewer than `LEAST_BLADES` blades nothing is asked, nor of amplitudes of more than `WIDE` expected
sizes, where the law is far from linear: each half of the blades has to find these by itself
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
from core.diagnosis.verdict import NAMED, WIDE, Verdict

Array = NDArray[np.float64]
SHARES = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])  # more are nearly all
ALL = 10.0  # times as likely in all as in some, before anything is read
PHI = np.geomspace(0.35, 2.0, 25)
SHOWN = 12  # blades in words


@dataclass(frozen=True, slots=True)
class Concerned:
    """Which blades have an effect that is said of `blades` of them.

    nat    K, of some against all; share: the likeliest, if some; cause: of the effect
    those  blades that rather have it than not, if some, the surest first; none where all may be
           claimed
    """

    effect: str
    blades: int
    nat: float
    share: float
    cause: str = ""
    those: tuple[str, ...] = ()

    @property
    def all(self) -> float:
        """P(all | readings)."""
        return ALL / (ALL + math.exp(min(self.nat, 700.0)))

    @property
    def stands(self) -> bool:
        """Whether it may be claimed of all.

        >>> [Concerned("zero", 99, nat, 0.3).stands for nat in (-1.2, 0.5, 9.0)]
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
            f"{self.nat:z.1f} nat more, about {self.share:.0%} of them, "
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
        told = Concerned(one.cell.name, len(at), nat, share, one.cell.cause)
        names = tuple(seen.blades[at[i]] for i in order)
        found.append(told if told.stands else replace(told, those=names))
    return tuple(found)


def shared_out(c: Array, own: Array, a: float) -> tuple[float, float, Array]:
    """K, the likeliest share if some have it, and the probability of each blade to be one.

    c, own  of the blades' amplitudes about a, (B,)

    Ten blades that show one amplitude of four sds, and the same mean in two of them:

    >>> alike, two = np.linspace(-6.0, 6.0, 10), np.r_[16.0 * np.full(2, 4.0), -16.0 * np.ones(8)]
    >>> [round(shared_out(c, np.full(10, 16.0), 1.0)[0]) for c in (alike, two)]
    [-23, 163]
    """
    shares, phi = SHARES[:, None, None], PHI[:, None]
    scale = 2.0 * phi * own

    def density(d: Array | float) -> Array:
        return np.asarray(-((c - own * d) ** 2) / scale - 0.5 * np.log(phi))

    have = np.log(shares) + density(a / shares - a)
    both = np.logaddexp(np.log1p(-shares) + density(-a), have)
    some = np.logaddexp.reduce(both.sum(axis=2), axis=1)
    every = np.logaddexp.reduce(density(0.0).sum(axis=1))
    best = int(np.argmax(some))
    likely = both[best].sum(axis=1)
    weight = np.exp(likely - likely.max())
    has = weight @ np.exp(have[best] - both[best]) / weight.sum()
    nat = float(np.logaddexp.reduce(some) - math.log(len(some)) - every)
    return nat, float(SHARES[best]), has


def heard(verdict: Verdict, told: tuple[Concerned, ...]) -> Verdict:
    """A verdict once it is known which blades have the effects in the model.

    Where one is not in all, nothing is claimed. One of which it is open is not claimed, others
    beside it are; of names that share the evidence it is said.
    """
    unsure = [one for one in told if not one.stands]
    reasons = tuple(one.told() for one in unsure)
    said = replace(verdict, concerns=told, reasons=(*verdict.reasons, *reasons))
    if not unsure or verdict.word not in ("effect", "not separable"):
        return said
    alone = replace(said, word="unattributed", names=(), beside=(), reasons=reasons)
    if any(one.all <= 1.0 - NAMED for one in unsure):
        return alone
    if verdict.word == "not separable":
        return said
    open_ = {name for one in unsure for name in (one.effect, one.cause)}
    left = tuple(name for name in verdict.names if name not in open_)
    return replace(said, names=left) if left else alone
