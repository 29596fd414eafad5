"""Readings that scatter more than their noise says.

The noise that comes with a reading (`sigma`) is believed: it is not inferred, as `sigma_obs` is.
Where it is stated too small a blade's own parameters follow the noise, no blade contradicts, every
band is too narrow, and pairs of blades look exchanged, for whatever is improbable is far likelier
the other way round. What it really is can be seen from the visits of all blades, each foreseen from
the blade's other readings (`cavity`): of visit i of q_i coordinates

    z_i = χ²_i / χ²_{q_i}(1 − β),        s² = their (1 − β)-quantile over all visits of a kind

is about one where noise and model are right, whatever a blade's own parameters; readings that are
wrong, of less than a share β of the visits, move it little. Where noises are k times what is stated
s is about k at most, more in the tail than in the middle: what blades' own parameters follow
is in no visit that others foresee. So β is ¼ and 1/10, and the larger s counts.

Of n visits that are independent a share β is beyond s² χ²_q(1 − β) with a probability of
P(Bin(n, P(χ²_q > s² χ²_q(1 − β))) ≥ β n). As m visits of a blade are foreseen from one another they
are counted as m − 1. From `FACTOR` and a probability of `CHANCE` on, both β together, visits are
noisier than told, and what is improbable in others is held to be s² times less so (`exchanged`,
`doubted`): in exchanges by what the visits of all other blades say, in a blade by the same, for a
wrong reading puts off all visits of its blade. It is told where it is so without any one blade, by
the least s. Where the noise is inferred it takes all that up, and nothing is told; what is left is
a model that lacks an effect of each visit.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.stats import binom, chi2

from core.calibration.cavity import Seen, Visit

Looks = Mapping[str, Mapping[Visit, Seen]]
Kind = tuple[tuple[str, ...], bool]  # quantities, and whether a noise is stated
BEYOND = 0.25, 0.1  # shares of the visits
FACTOR = 1.5  # times the noise, from which on it is told
CHANCE = 1e-4  # that a sound rotor is told of


@dataclass(frozen=True, slots=True)
class Row:
    """A visit: χ² of q coordinates, and as what share of an independent one it counts."""

    blade: str
    misfit: float
    size: int
    share: float


@dataclass(frozen=True)
class Scatter:
    """All visits that others of their blade foresee, by kind."""

    of: Mapping[Kind, Sequence[Row]]

    def variance(self, kinds: Collection[Kind], without: Collection[str] = ()) -> float:
        """By how much a look at these overstates what is improbable: the largest s²; else 1."""
        return max((self._variance(which, frozenset(without)) for which in kinds), default=1.0)

    def told(self, without: Collection[str]) -> list[dict[str, Any]]:
        """For a state's health; `without` blades of which something else is told."""
        found = []
        for which in sorted(self.of):
            (names, stated), out = which, frozenset(without)
            if self._variance(which, out) == 1.0:
                continue
            rows = [row for row in self.of[which] if row.blade not in out]
            least = min(self._variance(which, out | {row.blade}) for row in rows)
            if least > 1.0:
                one = {"quantities": [*names], "stated": stated, "times": round(least**0.5, 2)}
                found.append(one | {"visits": len(rows)})
        return found

    def _variance(self, which: Kind, without: frozenset[str]) -> float:
        rows = [row for row in self.of.get(which, ()) if row.blade not in without]
        count = int(sum(row.share for row in rows))
        if count == 0:
            return 1.0
        return max(_beyond(share, rows, count) for share in BEYOND)


def _beyond(share: float, rows: Sequence[Row], count: int) -> float:
    """s² by this β; 1 where it is no larger than by chance."""
    s2 = float(np.quantile([row.misfit / _most(row.size, share) for row in rows], 1.0 - share))
    if not s2 >= FACTOR**2:
        return 1.0
    sizes = Counter(row.size for row in rows)
    past = sum(n * chi2.sf(s2 * _most(size, share), size) for size, n in sizes.items())
    chance = binom.sf(math.ceil(share * count) - 1, count, past / len(rows))
    return s2 if chance <= CHANCE / len(BEYOND) else 1.0


def kind(seen: Seen) -> Kind:
    """What a visit is of."""
    names = tuple(sorted({reading.quantity for reading in seen.readings}))
    return names, any(reading.sigma is not None for reading in seen.readings)


def scatter(looked: Looks, accused: Collection[str]) -> Scatter:
    """Of all blades but those that contradict.

    looked  at each blade's visits, foreseen from its others (`exchanged.looks`)
    """
    found: dict[Kind, list[Row]] = {}
    for blade in sorted(looked.keys() - set(accused)):
        visits = [one for one in looked[blade].values() if one.others]
        for one in visits:
            row = Row(blade, one.misfit, len(one.value), 1.0 - 1.0 / len(visits))
            found.setdefault(kind(one), []).append(row)
    return Scatter(found)


def in_words(one: Mapping[str, Any]) -> str:
    """What a state says of a kind.

    >>> print(in_words({"quantities": ["elongation"], "stated": True, "times": 2.18, "visits": 72}))
    72 visits (elongation) scatter 2.2 times as much as their stated noise about what the blades' other readings foresee: sigma is stated too small, or the model lacks an effect; bands are too narrow until that is mended
    """  # noqa: E501
    what, stated = ", ".join(one["quantities"]), one["stated"]
    why = "sigma is stated too small, or the model" if stated else "the model"
    return (
        f"{one['visits']} visits ({what}) scatter {one['times']:.2g} times as much as their "
        f"{'stated' if stated else 'inferred'} noise about what the blades' other readings foresee:"
        f" {why} lacks an effect; bands are too narrow until that is mended"
    )


@lru_cache(maxsize=1024)
def _most(size: int, share: float) -> float:
    return float(chi2.isf(share, size))
