"""Blades that were read once, all in the same way: their messages from one table.

At a first outage a hundred blades have one reading each, of the same quantity at the same hour.
Given the shared parameters s, the model's answer is then one function Y(l) of three local
parameters for all of them, and

    m_b(s) = ∫ N(y_b | Y(l), sigma² + V(l)) p(l) dl = Σ_k P(Y in bin k | s) N(y_b | Y_k, …)

rests on the distribution of Y and V over the box alone: a histogram of fine bins of Y, by classes
of V (`tetrahedra`), at each s, which serves any number of readings. It costs as much as about eight
messages by quadrature and replaces a hundred. Classes, because beside the end of what the model can
say the likelier places are the uncertain ones: a single mean of V was off by 0.1 nat there.

The histogram is made twice, the second time with cells, bins and classes twice as wide. All that is
wrong with it is of second order in the widths, so that (4 fine − coarse) / 3 is of higher order
(Richardson) and the difference tells where that holds: a reading at which the extrapolation goes
further than `DOUBT` (far outside of what the model can say, or a noise much narrower than a bin)
has its message by quadrature, as any other blade.

Against dense product rules columns are off by 3e-4 nat rms, 2e-3 at most (eleven rotors, kriging
included). What is left is smooth in s, which the quadrature of a thin sheet is not: it splits
panels differently from node to node (up to 6e-3 nat rms, 0.07 at most), so that kriging across the
nodes (`smooth`) fails for half of such blades.

Where nodes are only looked for, the coarse histogram alone will do (an eighth of the price).

A table follows from the model and s, whoever was read. Whether there are enough blades alike
(`MANY_ALIKE`) follows from the set of readings; columns by table and by quadrature are kept apart.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from core.calibration.layout import monomials_of
from core.calibration.message import PARTS, POOL, BladeMessage, side_by_side, split
from core.calibration.tetrahedra import CORNERS, answers, histogram, seen

Array = NDArray[np.float64]
MANY_ALIKE = 30  # blades alike from which on a table is made
CELLS = (32, 16, 16)  # of the box, even numbers: every second point is the coarse grid's
BINS = 1024
CLASSES = 8  # of the surrogate's variance, by its logarithm
DOUBT = 0.03  # nat that Richardson's correction may be
KEPT = 300  # nodes whose tables are kept, 60 kB each
FAMILIES = 4  # families of which any are kept


@dataclass(frozen=True, slots=True)
class Table:
    """Distribution of a model's answer at one shared value, by bins.

    width   of the fine bins; the coarse ones are twice as wide
    coarse  middle, mean variance V and share of the bins that are not empty, (3, N)
    fine    alike; None where a rough look is enough
    """

    width: float
    coarse: Array
    fine: Array | None

    def messages(self, y: Array, s2: Array) -> tuple[Array, Array]:
        """log ∫ N(y | Y(l), s2 + V(l)) dl over the box, for readings (B,); and the correction,
        which is zero where there is no fine histogram."""
        fine, coarse = np.empty(len(y)), np.empty(len(y))
        if self.fine is None:
            seen(self.coarse, 2 * self.width, y, s2, coarse)
            return coarse, np.zeros(len(y))
        seen(self.fine, self.width, y, s2, fine)
        seen(self.coarse, 2 * self.width, y, s2, coarse)
        correction = (fine - coarse) / 3
        return fine + correction, correction


def binned(y: Array, s2: Array, step: int, apart: int, low: float, width: float) -> Array:
    """Bins of answers y with variances s2 on a grid: middle, variance and share, (3, N).

    The widths follow from `step`: of cells, of bins, and of classes of the variance. Points of the
    grid are `apart` fine cells from each other.
    """
    share, variance = np.empty((2, max(CLASSES // step, 1), BINS // step))
    histogram(y, s2, step // apart, CORNERS, low, step * width, share, variance)
    met = share > 0.0
    return np.array([low + (np.nonzero(met)[1] + 0.5) * step * width, variance[met], share[met]])


@dataclass
class Family:
    """What alike blades share: the model's answer as a function of local and shared parameters."""

    of: BladeMessage
    tables: OrderedDict[bytes, Table] = field(default_factory=OrderedDict)

    def columns(
        self, messages: Sequence[BladeMessage], unit: Array, rough: bool = False
    ) -> list[Array]:
        """log m_b at nodes `unit` (n, d) of blades of this family, (n,) each."""
        tables = self._tables(unit, rough)
        read = [m.readings(unit) for m in messages]
        y, s2 = (np.array([one[j][:, 0] for one in read]).T.copy() for j in range(2))
        out, correction = np.empty(y.shape), np.empty(y.shape)

        def work(part: slice) -> None:
            for k in range(part.start, part.stop):
                out[k], correction[k] = tables[k].messages(y[k], s2[k])

        side_by_side(work, split(len(unit), PARTS))
        found = [c + one[2] + m.offset for c, one, m in zip(out.T, read, messages, strict=True)]
        doubted = ~(np.abs(correction.T) <= DOUBT)  # or not a number
        due = [b for b in range(len(messages)) if doubted[b].any()]

        def exact(b: int) -> Array:
            return BladeMessage.column(messages[b], unit[doubted[b]], parts=1)  # by quadrature

        for b, values in zip(due, POOL.map(exact, due), strict=True):
            found[b][doubted[b]] = values
        return found

    def _tables(self, unit: Array, rough: bool) -> list[Table]:
        """The tables at nodes (n, d); those that are missing are made side by side."""
        keys = [node.tobytes() + bytes(rough) for node in unit]
        missing = [k for k, key in enumerate(keys) if key not in self.tables]
        made: list[Table | None] = [None] * len(missing)
        m = self.of
        x = m.space.to_x(unit[missing])
        factors = monomials_of(m.model, m.rows, m.space, x, m.fixed)

        def work(part: slice) -> None:
            for k in range(part.start, part.stop):
                made[k] = self._table(factors[k], rough)

        if missing:
            side_by_side(work, split(len(missing), PARTS))
        fresh = {keys[k]: table for k, table in zip(missing, made, strict=True) if table}
        found = [fresh.get(key) or self.tables[key] for key in keys]
        self.tables.update(fresh)
        while len(self.tables) > KEPT:
            self.tables.popitem(last=False)
        return found

    def _table(self, factors: Array, rough: bool) -> Table:
        """The table where the monomials of the inputs that are not local are `factors` (M,)."""
        p, apart = self.of.packed, 2 if rough else 1  # of the grid's points, in fine cells
        grid = tuple(n // apart + 1 for n in CELLS)
        y, s2 = np.empty(grid), np.empty(grid)
        own = (p.a[0], p.b[0], p.v[0], p.exponents, factors, p.ka2[0], p.kb2[0])
        answers(*own, y, s2)
        low = float(y.min())
        width = max(float(y.max()) - low, 1e-300) / BINS
        coarse = binned(y, s2, 2, apart, low, width)
        return Table(width, coarse, None if rough else binned(y, s2, 1, 1, low, width))


class AlikeMessage(BladeMessage):
    """The message of a blade of a family, by the family's table."""

    tabled = True

    def __init__(self, message: BladeMessage, family: Family) -> None:
        super().__init__(message.model, message.rows, message.space, message.fixed)
        self.family = family

    @cached_property
    def name(self) -> str:
        """Columns by table are kept apart from those by quadrature."""
        return f"{super().name} by table"

    def column(self, unit: Array, rough: bool = False, parts: int = PARTS) -> Array:
        """As of any blade; a rough look is one at the coarse histogram."""
        return self.family.columns([self], unit, rough)[0]


def family_key(message: BladeMessage) -> bytes | None:
    """What a family shares; None for a blade with other than one reading, or of other models."""
    if type(message) is not BladeMessage or len(message.rows.y) != 1 or message.rows.dense:
        return None
    p, space = message.packed, message.space
    if p.dim != 3:
        return None
    response = message.rows.polynomials
    known = (response.names, sorted(message.fixed.items()), space.names, space.priors)
    digest = blake2b(repr(known).encode(), digest_size=16)
    for part in (p.a, p.b, p.v, p.ka2, p.kb2, p.exponents, response.low, response.high):
        digest.update(np.ascontiguousarray(part).tobytes())
    return digest.digest()


def meet(messages: Iterable[BladeMessage]) -> None:
    """One table for each blade that could have one: what it takes is compiled from then on."""
    for message in messages:
        if family_key(message) is not None:
            unit = np.full((1, message.space.dim), 0.5)
            for rough in (True, False):
                Family(message).columns([message], unit, rough)


def gathered(
    messages: Mapping[str, BladeMessage], families: dict[bytes, Family]
) -> dict[str, BladeMessage]:
    """Messages of blades of which there are many alike by table, all others as they are.

    families   those met before, which are added to
    """
    keys = {b: family_key(m) for b, m in messages.items()}
    found = dict(messages)
    for key in {k for k in keys.values() if k is not None}:
        blades = [b for b in messages if keys[b] == key]
        if len(blades) < MANY_ALIKE:
            continue
        family = families.setdefault(key, Family(messages[blades[0]]))
        found |= {b: AlikeMessage(messages[b], family) for b in blades}
    for old in list(families)[:-FAMILIES]:
        del families[old]
    return found
