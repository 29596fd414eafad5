"""What a blade tells its rotor, and the blade's own particles.

log m_b(s) for many values of the shared parameters at once, by quadrature or at a glance
(`column`), and weighted draws of the local parameters at each of these values (`draws`).
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from hashlib import blake2b
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from core.calibration import draws as drawing
from core.calibration import kernel
from core.calibration.lines import SAME
from core.calibration.space import SharedSpace, locals_of
from core.calibration.target import BladeRows
from core.calibration.vector import LANES
from core.discrepancy import total
from core.errors import CalibrationError
from core.model import Model
from core.network import Parameter
from core.prior import cut_mass, cut_quantile
from core.response import multi_indices

Array = NDArray[np.float64]
MESSAGE_ERROR = 0.002  # nat, rms against a dense reference; more only far from what blades do
PARTS = max(1, os.cpu_count() or 1)
POOL = ThreadPoolExecutor(max_workers=PARTS)


@dataclass(frozen=True, slots=True)
class Packed:
    """Rows of a blade in the layout of the compiled functions."""

    a: Array
    b: Array
    v: Array
    ka2: Array
    kb2: Array
    exponents: NDArray[np.int64]
    dim: int
    local: tuple[int, ...]
    offset: float

    @property
    def rows(self) -> tuple[Array, Array, Array, NDArray[np.int64]]:
        return self.a, self.b, self.v, self.exponents

    @property
    def marked(self) -> Array:
        """kb2, and `SAME` where a row has the b and v of the one before and no kb."""
        out = self.kb2.copy()
        same = np.all(np.diff(self.b, axis=0) == 0.0, axis=1)
        same &= np.all(np.diff(self.v, axis=0) == 0.0, axis=1)
        out[1:][same & (self.kb2[1:] == 0.0)] = SAME
        return out


@dataclass(frozen=True, slots=True)
class Blocks:
    """Shared nodes in blocks of `LANES` that lie close together.

    order    node numbers as the blocks take them; the last one fills the last block
    factors  (N, M, LANES), y and s2 (N, R, LANES)
    rest     what no local parameter moves, (n,) in the nodes' own order
    """

    order: NDArray[np.int64]
    factors: Array
    y: Array
    s2: Array
    rest: Array

    def of(self, part: slice) -> tuple[Array, Array, Array]:
        return self.factors[part], self.y[part], self.s2[part]

    def back(self, blocks: Array) -> Array:
        """Values by block (N, LANES, …) in the nodes' own order (n, …)."""
        flat = blocks.reshape(-1, *blocks.shape[2:])[: len(self.order)]
        out = np.empty_like(flat)
        out[self.order] = flat
        return out


def pack(model: Model, rows: BladeRows) -> Packed:
    """Local inputs in the places (outer, middle, inner), filled from the right.

    Those that the rows do not depend on are left out; where none is left, one place is integrated
    over without effect. `local` are the places of the rest among all local parameters.
    """
    response = rows.polynomials
    touched = locals_of(model, response.names)
    inner = [response.names.index(p.name) for p in touched]
    table = multi_indices(len(response.names), response.degree)
    places = max(3, len(inner))
    exponents = np.zeros((len(table), places), dtype=np.int64)
    exponents[:, places - len(inner) :] = table[:, inner]
    offset = sum(cut_offset(p) for p in touched)
    return Packed(
        np.ascontiguousarray(response.a),
        np.ascontiguousarray(response.b),
        np.ascontiguousarray(response.log_v),
        response.ka**2,
        response.kb**2,
        exponents,
        max(len(inner), 1),
        tuple(locals_of(model).index(p) for p in touched),
        offset,
    )


def cut_offset(parameter: Parameter) -> float:
    """log of what the row of a normal prior lacks: the box's size, and the mass inside it."""
    prior = parameter.prior
    size = math.log(prior.high - prior.low)
    if parameter.population is not None:
        return size
    if prior.kind != "normal":
        return 0.0
    return size - float(np.log(cut_mass(prior.mean, prior.sd, prior.low, prior.high)))


def monomials_of(
    model: Model, rows: BladeRows, space: SharedSpace, x: Array, fixed: dict[str, float]
) -> Array:
    """Monomials of all inputs that are not local, at shared values x (n, d): (n, M)."""
    response = rows.polynomials
    table = multi_indices(len(response.names), response.degree)
    out = np.ones((len(x), len(table)))
    inner = {p.name for p in locals_of(model)}
    for j, name in enumerate(response.names):
        if name in inner:
            continue
        value = (
            x[:, space.names.index(name)] if name in space.names else np.full(len(x), fixed[name])
        )
        z = 2 * (value - response.low[j]) / (response.high[j] - response.low[j]) - 1
        out *= z[:, None] ** table[None, :, j]
    return out


def _readings(rows: BladeRows, space: SharedSpace, x: Array) -> tuple[Array, Array, Array]:
    """Readings (n, R), their noise variances (n, R), and what no local parameter moves (n,).

    y = g Y_m + o + noise enters as (y − o) / g, its variance as that over g². The last array is the
    log density of the scans' remainders, and −Σ log g.
    """

    def value(name: str | float) -> Array:
        return x[:, space.names.index(name)] if isinstance(name, str) else np.full(len(x), name)

    y = np.tile(rows.y, (len(x), 1))
    s2 = np.stack([value(sigma) ** 2 for sigma in rows.sigma], axis=1) + rows.extra
    rest = np.zeros(len(x))
    for r, one in enumerate(rows.discrepancy):
        gain = 1.0 + total(one.gain, value)
        y[:, r] = (y[:, r] - total(one.offset, value)) / gain
        s2[:, r] /= gain**2
        rest -= np.log(gain)
    s2 = (s2 + (rows.relative * y) ** 2) * rows.discount
    for r, name, low, high in rows.populations:
        y[:, r] = value(name)
        rest -= np.log(cut_mass(y[:, r], np.sqrt(s2[:, r]), low, high))
    for d in rows.dense:
        offset = [value(name) for name in d.offset]
        rest += d.log_density(value(d.sigma), np.stack(offset, axis=1) if offset else x[:, :0])
    return y, s2, rest


def split(n: int, parts: int) -> list[slice]:
    edges = np.linspace(0, n, min(parts, n) + 1).astype(int)
    return [slice(int(a), int(b)) for a, b in pairwise(edges) if b > a]


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
        return _readings(self.rows, self.space, self.space.to_x(unit))

    def column(self, unit: Array, rough: bool = False, parts: int = PARTS) -> Array:
        """log m_b at nodes `unit` (n, d) of the unit box, (n,); `parts` of them side by side."""
        blocks, p = self._blocks(unit), self.packed
        out, marked = np.empty((len(blocks.factors), LANES)), p.marked

        def work(part: slice) -> None:
            given = (*p.rows, *blocks.of(part), p.ka2, marked)
            if p.dim == 3:
                kernel.volume_messages(*given, rough, out[part])
            else:
                (kernel.plane_messages if p.dim == 2 else kernel.line_messages)(*given, out[part])

        side_by_side(work, split(len(out), parts))
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
        blocks, p = self._blocks(unit), self.packed
        n, marked = len(blocks.factors), p.marked
        share = drawing.SHARE if p.dim == 3 else 1
        assert per_node % share == 0, "particles per node must be whole groups"
        u = drawing.even_points(rng, n * LANES, per_node, share, p.dim)
        u = u.reshape(n, LANES, per_node, 3)
        out, log_w = np.empty((n, LANES, per_node, 3)), np.empty((n, LANES, per_node))

        def work(part: slice) -> None:
            given = (*p.rows, *blocks.of(part), p.ka2, marked)
            if p.dim == 3:
                kernel.volume_draws(*given, u[part], out[part], log_w[part])
            else:
                kernel.fewer_draws(*given, p.dim, u[part], out[part], log_w[part])

        side_by_side(work, split(n, parts))
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

    def _blocks(self, unit: Array) -> Blocks:
        """What the compiled functions need of the nodes, in blocks of like ones."""
        x = self.space.to_x(unit)
        factors = monomials_of(self.model, self.rows, self.space, x, self.fixed)
        y, s2, rest = self.readings(unit)
        order = np.argsort(unit[:, 0], kind="stable")
        blocks = -(-len(unit) // LANES)
        padded = np.concatenate([order, np.repeat(order[-1:], blocks * LANES - len(order))])

        def laid(values: Array) -> Array:
            parts = values[padded].reshape(blocks, LANES, -1)
            return np.ascontiguousarray(parts.transpose(0, 2, 1))

        return Blocks(order, laid(factors), laid(y), laid(s2), rest)


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
