"""A blade's message between the shared nodes: computed at some of them, and known at the rest.

Where many blades speak of a rotor, its shared parameters are known far better than one blade could
tell: over the nodes, log m_b is a few tenths of a nat high and smooth. Universal kriging,

    log m_b(u) ≈ quadratic(z) + Σ_k alpha_k exp(−|z − z_k|² / 2 l²),    z = whitened u,

through a part of the nodes then gives the others as well as the quadrature does. What it may be
off is known beforehand, by its leave-one-out errors (Dubrule, Math. Geology 15, 1983), so every
blade takes as many nodes as it needs: those that lie farthest from all before come first (so that
the rest lies between them), sixteen at a time, until the root mean square of these errors is below
`TOLERANCE`; a blade that never gets there is computed at all nodes. Length and nugget are the
blade's own, those of the least error.

Of the shared parameters a blade sees those that its readings rest on: one that was never scanned
knows nothing of the scans' noise. Its message goes from node to node by those alone, which takes
sixteen to thirty-two of any number of nodes where all four of the paper's Table 1 took sixty-four.

A blade's column depends on its own readings and the nodes alone, in whatever company it is
computed, and whether at once or first nearly and then in full.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from core.calibration.vector import LANES
from core.monomials import monomials

Array = NDArray[np.float64]
TOLERANCE = 0.003  # nat of leave-one-out error; at the nodes left out it is a tenth of that
NEARLY = 0.03  # nat; as much will do to tell where nodes should stand
STAGES = (1, 2, 3, 4, 6, 8)  # blocks of nodes after which a blade may be done
LENGTHS = (1.0, 1.5, 2.0, 3.0, 4.5, 7.0)
NUGGETS = (1e-9, 1e-7, 1e-5, 1e-3)
SPARE = 4  # nodes more than a quadratic has coefficients, at least


def from_afar(z: Array) -> NDArray[np.intp]:
    """Points (n, d) in an order in which each lies as far as possible from all before it.

    The first is the one nearest to the origin.

    >>> from_afar(np.array([[0.9], [0.1], [-1.0], [0.5]])).tolist()
    [1, 2, 0, 3]
    """
    order = [int(np.argmin(np.sum(z**2, axis=1)))]
    nearest = np.sum((z - z[order[0]]) ** 2, axis=1)
    while len(order) < len(z):
        order.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.sum((z - z[order[-1]]) ** 2, axis=1))
        nearest[order] = -1.0
    return np.array(order)


@dataclass(frozen=True, slots=True)
class Kriging:
    """The linear maps from values at k points to their leave-one-out errors and to other points.

    left_out (c, k, k), others (c, n − k, k), for each choice of a length and a nugget.
    """

    left_out: Array
    others: Array

    @staticmethod
    def between(known: Array, wanted: Array) -> Kriging:
        """From known points z (k, d) to wanted ones (m, d)."""
        here, there = monomials(known, 2), monomials(wanted, 2)
        k, m = here.shape
        square, far = _squares(known, known), _squares(wanted, known)
        left_out, others = [], []
        for length in LENGTHS:
            for nugget in NUGGETS:
                system = np.zeros((k + m, k + m))
                system[:k, :k] = np.exp(-0.5 * square / length**2) + nugget * np.eye(k)
                system[:k, k:], system[k:, :k] = here, here.T
                inverse = np.linalg.inv(system)[:, :k]
                left_out.append(inverse[:k] / np.diag(inverse[:k])[:, None])
                others.append(np.hstack([np.exp(-0.5 * far / length**2), there]) @ inverse)
        return Kriging(np.array(left_out), np.array(others))

    def __call__(self, values: Array) -> tuple[Array, float]:
        """Values at the wanted points from those at the known ones (k,), and the error [nat]."""
        shift = values[0]
        errors = np.sqrt(np.mean((self.left_out @ (values - shift)) ** 2, axis=1))
        best = int(np.argmin(errors))
        return self.others[best] @ (values - shift) + shift, float(errors[best])


def _squares(a: Array, b: Array) -> Array:
    return np.asarray(np.sum((a[:, None, :] - b[None, :, :]) ** 2, axis=2))


class Ladder:
    """Stages in which columns at nodes `unit` (n, d) are computed, and the kriging after each.

    A stage is its number of nodes, the first so many of `order`; the last is all n.
    """

    def __init__(self, unit: Array) -> None:
        n, d = unit.shape
        least = (d + 1) * (d + 2) // 2 + SPARE
        self.stages = [*(k * LANES for k in STAGES if least <= k * LANES < n), n]
        turn = np.linalg.cholesky(np.cov(unit.T).reshape(d, d) + 1e-18 * np.eye(d))
        self._z = np.linalg.solve(turn, (unit - unit.mean(axis=0)).T).T
        self.order = from_afar(self._z)
        self._krigings: dict[int, Kriging] = {}

    def kriging(self, stage: int) -> Kriging:
        """From the nodes of this stage to the others."""
        if stage not in self._krigings:
            known, wanted = self._z[self.order[:stage]], self._z[self.order[stage:]]
            self._krigings[stage] = Kriging.between(known, wanted)
        return self._krigings[stage]

    def column(self, values: Array, stage: int) -> Column:
        """The column (n,), changed, from its values at the nodes of this stage."""
        known, wanted = self.order[:stage], self.order[stage:]
        error = 0.0 if stage == len(values) else np.inf
        if len(wanted) and np.isfinite(values[known]).all():
            values[wanted], error = self.kriging(stage)(values[known])
        return Column(values, stage, error)


@lru_cache(maxsize=8)
def ladder_of(nodes: bytes, dim: int) -> Ladder:
    """The ladder of nodes (n, dim), as bytes: a blade's next reading meets the same nodes."""
    return Ladder(np.frombuffer(nodes).reshape(-1, dim))


@dataclass(frozen=True, slots=True)
class Column:
    """A column as far as it is known: values (n,), at how many nodes computed, and its error [nat].

    The error is that of leaving nodes out, zero where all of them are computed.
    """

    values: Array
    computed: int = 0
    error: float = np.inf


Stages = Generator[tuple[list[int], Array], Sequence[Array], list[Column]]


def stages(
    begun: Sequence[Column | None],
    unit: Array,
    tolerance: float = TOLERANCE,
    seen: Sequence[int] | None = None,
) -> Stages:
    """Columns at nodes `unit` (n, d) to within `tolerance`, each from where it was left.

    Asks for exact columns of some blades, by number, at some nodes, and is sent them.

    begun    what is known of each blade's column; None: nothing
    seen     numbers of the coordinates that the columns depend on; None: all
    """
    ladder = _ladder(unit, seen)
    columns, before = [one or Column(np.empty(len(unit))) for one in begun], 0
    for stage in ladder.stages:
        fresh = ladder.order[before:stage]
        due = [i for i, c in enumerate(columns) if c.error > tolerance and c.computed < stage]
        if due:
            for i, values in zip(due, (yield due, unit[fresh]), strict=True):
                column = columns[i].values.copy()
                column[fresh] = values
                columns[i] = ladder.column(column, stage)
        before = stage
    return columns


Asked = tuple[int, list[int], Array]  # whose stages; of which blades; at which nodes


def together(
    runs: Sequence[Stages], compute: Callable[[list[Asked]], Sequence[Sequence[Array]]]
) -> list[list[Column]]:
    """Several kinds of blades stage by stage: what all of them ask for is computed at once."""
    found: list[list[Column]] = [[] for _ in runs]
    answers: dict[int, Sequence[Array] | None] = dict.fromkeys(range(len(runs)))
    while answers:
        asked = list[Asked]()
        for k, answer in answers.items():
            try:
                asked.append((k, *(next(runs[k]) if answer is None else runs[k].send(answer))))
            except StopIteration as end:
                found[k] = end.value
        made = compute(asked) if asked else ()
        answers = {k: values for (k, *_), values in zip(asked, made, strict=True)}
    return found


def as_near(column: Column, unit: Array, seen: Sequence[int] | None = None) -> Column:
    """The column as it was when it was first known to `NEARLY`, before it was known any better.

    Where nodes should stand is told by such columns, and must not depend on what else is kept.
    """
    ladder = _ladder(unit, seen)
    for stage in ladder.stages:
        if stage >= column.computed:
            break
        found = ladder.column(column.values.copy(), stage)
        if found.error <= NEARLY:
            return found
    return column


def _ladder(unit: Array, seen: Sequence[int] | None) -> Ladder:
    own = unit if seen is None else unit[:, list(seen)]
    return ladder_of(np.ascontiguousarray(own).tobytes(), own.shape[1])
