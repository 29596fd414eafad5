"""What a blade tells its rotor, and the blade's own particles.

log m_b(s) for many values of the shared parameters at once, by quadrature or at a glance
(`column`), and weighted draws of the local parameters at each of these values (`draws`).
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from hashlib import blake2b
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from core.calibration import draws as drawing
from core.calibration import kernel
from core.calibration.layout import Blocks, Packed, blocks_of, pack, readings_at
from core.calibration.space import SharedSpace, locals_of
from core.calibration.target import BladeRows
from core.calibration.vector import LANES
from core.errors import CalibrationError
from core.model import Model
from core.prior import cut_quantile

Array = NDArray[np.float64]
MESSAGE_ERROR = 0.002  # nat, rms against a dense reference; more only far from what blades do
CHAIN = 8  # blocks in a row of which each leads the next, at most (`survey`)
PARTS = max(1, os.cpu_count() or 1)
POOL = ThreadPoolExecutor(max_workers=PARTS)


def split(n: int, parts: int, chain: int = 1) -> list[slice]:
    """At most so many parts of n, broken only between chains.

    >>> split(20, 2, 8)
    [slice(0, 8, None), slice(8, 20, None)]
    """
    chains = -(-n // chain)
    edges = np.linspace(0, chains, min(parts, chains) + 1).astype(int) * chain
    return [slice(int(a), min(int(b), n)) for a, b in pairwise(edges) if b > a]


def side_by_side(work: Callable[[slice], None], parts: list[slice]) -> None:
    if len(parts) == 1:
        work(parts[0])
    else:
        list(POOL.map(work, parts))


class BladeMessage:
    """The message of one blade's readings, as a function of the shared parameters.

    `smooth`: what its quadrature leaves is small enough to go from node to node by kriging.
    `cheap`: thousands of nodes are affordable. `tabled`: an exact message costs no more than a
    rough one.
    """

    smooth = True
    cheap = False
    tabled = False

    def __init__(
        self, model: Model, rows: BladeRows, space: SharedSpace, fixed: dict[str, float]
    ) -> None:
        self.model, self.rows, self.space, self.fixed = model, rows, space, fixed

    @cached_property
    def name(self) -> str:
        """What the message rests on beside the nodes: model, readings, known inputs, space."""
        known = repr(sorted(self.fixed.items()))
        return f"{self.model.digest} {self.rows.digest} {known} {'/'.join(self.space.names)}"

    @cached_property
    def seen(self) -> tuple[int, ...]:
        """Numbers of the shared parameters that the message depends on; all, where it is none."""
        names = {*self.rows.polynomials.names, *self.rows.shared}
        names |= {name for _, name, *_ in self.rows.populations}
        found = tuple(j for j, name in enumerate(self.space.names) if name in names)
        return found or tuple(range(self.space.dim))

    @cached_property
    def digest(self) -> str:
        """Of the readings, and of the known inputs where there are any."""
        if not self.fixed:
            return self.rows.digest
        text = self.rows.digest + repr(sorted(self.fixed.items()))
        return blake2b(text.encode(), digest_size=16).hexdigest()

    @cached_property
    def packed(self) -> Packed:
        """The rows in the compiled functions' layout, made when first needed."""
        return pack(self.model, self.rows)

    @property
    def offset(self) -> float:
        """log of what the rows of normal priors lack."""
        return self.packed.offset

    def readings(self, unit: Array) -> tuple[Array, Array, Array]:
        """Readings (n, R), noise variances (n, R) and what no local parameter moves (n,)."""
        return readings_at(self.rows, self.space, self.space.to_x(unit))

    def blocks(self, unit: Array) -> Blocks:
        """The nodes in the compiled functions' layout."""
        return blocks_of(self.model, self.rows, self.space, unit, self.fixed)

    def column(self, unit: Array, rough: bool = False, parts: int = PARTS) -> Array:
        """log m_b at nodes `unit` (n, d) of the unit box, (n,); `parts` of them side by side."""
        blocks, p = self.blocks(unit), self.packed
        out, marked = np.empty((len(blocks.factors), LANES)), p.marked
        chain = CHAIN if rough else 0

        def work(part: slice) -> None:
            given = (*p.rows, *blocks.of(part), p.ka2, marked)
            if p.dim == 3:
                kernel.volume_messages(*given, chain, out[part])
            else:
                (kernel.plane_messages if p.dim == 2 else kernel.line_messages)(*given, out[part])

        side_by_side(work, split(len(out), parts, max(chain, 1)))
        return blocks.back(out) + blocks.rest + self._constant

    @property
    def _constant(self) -> float:
        """Constants of the normal densities and of the uniform priors on [-1, 1]."""
        p = self.packed
        return p.offset - 0.5 * len(p.ka2) * math.log(2 * math.pi) - p.dim * math.log(2.0)

    def error(self, unit: Array) -> tuple[float, float]:
        """Root mean square errors of a column: its own, and of differences between nodes [nat]."""
        return MESSAGE_ERROR, MESSAGE_ERROR

    def draws(
        self,
        unit: Array,
        per_node: int,
        rng: np.random.Generator,
        column: Array,
        parts: int = PARTS,
    ) -> tuple[Array, Array]:
        """Weighted local parameters at each node; `parts` of the nodes side by side.

        Returns values (K, per_node, L) and log weights (K, per_node). A weight is L / q divided by
        the exact message `column` (K,), so that a node's weights sum to one on average; dividing by
        their own sum instead would bias every mean by the order of 1 / per_node.
        """
        blocks, p = self.blocks(unit), self.packed
        n, marked = len(blocks.factors), p.marked
        chain = min(CHAIN, -(-n // 2))  # two of them, for a single blade's draws
        share = drawing.SHARE if p.dim == 3 else 1
        assert per_node % share == 0, "particles per node must be whole groups"
        u = drawing.even_points(rng, n * LANES, per_node, share, p.dim)
        u = u.reshape(n, LANES, per_node, 3)
        out, log_w = np.empty((n, LANES, per_node, 3)), np.empty((n, LANES, per_node))

        def work(part: slice) -> None:
            given = (*p.rows, *blocks.of(part), p.ka2, marked)
            if p.dim == 3:
                kernel.volume_draws(*given, chain, u[part], out[part], log_w[part])
            else:
                kernel.fewer_draws(*given, p.dim, u[part], out[part], log_w[part])

        side_by_side(work, split(n, parts, chain))
        shift = self._constant - math.log(per_node) + (blocks.rest - column)[:, None]
        weights = blocks.back(log_w) + shift
        if not np.all(weights < np.inf):  # neither NaN nor an unbounded weight
            raise CalibrationError(
                f"{int(np.sum(~(weights < np.inf)))} draws of a blade have no weight; its "
                f"readings: {self.rows.y.tolist()[:12]}"
            )
        touched = natural(self.model, p.local, blocks.back(out)[:, :, 3 - len(p.local) :])
        if len(p.local) == len(locals_of(self.model)):
            return touched, weights
        values, _ = prior_draws(self.model, self.space, unit, per_node, rng)
        values[:, :, p.local] = touched
        return values, weights


def prior_draws(
    model: Model, space: SharedSpace, unit: Array, per_node: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Local parameters of a blade without a reading: its prior, at each node `unit` (K, d).

    With a population, that of the node; else the same at every node.
    """
    parameters, x = locals_of(model), space.to_x(unit)
    n, shape = len(unit) * per_node, (len(unit), per_node)
    strata = rng.random((n, len(parameters)))
    for j in range(len(parameters)):
        strata[:, j] = (rng.permutation(n) + strata[:, j]) / n
    values = np.empty((*shape, len(parameters)))
    for j, p in enumerate(parameters):
        level = strata[:, j].reshape(shape)
        if p.population is None:
            values[:, :, j] = p.prior.quantile(level)
        else:
            mean, sd = (x[:, [space.names.index(name)]] for name in p.hyperparameters)
            values[:, :, j] = cut_quantile(level, mean, sd, p.prior.low, p.prior.high)
    return values, np.full(shape, -math.log(per_node))


def natural(model: Model, places: Sequence[int], scaled: Array) -> Array:
    priors = [locals_of(model)[j].prior for j in places]
    low, high = np.array([p.low for p in priors]), np.array([p.high for p in priors])
    return np.asarray(low + 0.5 * (scaled + 1) * (high - low))
