"""What a blade tells its rotor, and the blade's own particles.

log m_b(s) for many values of the shared parameters at once, by quadrature or at a glance
(`column`), and weighted draws of the local parameters at each of these values (`draws`).
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from core.calibration import draws as drawing
from core.calibration import kernel
from core.calibration.target import BladeRows, SharedSpace, locals_of
from core.discrepancy import total
from core.errors import CalibrationError
from core.model import Model
from core.response import multi_indices

Array = NDArray[np.float64]
_POOL = ThreadPoolExecutor(max_workers=max(1, os.cpu_count() or 1))


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
    offset: float


def pack(model: Model, rows: BladeRows) -> Packed:
    """Local inputs in the places (outer, middle, inner), filled from the right."""
    response = rows.response
    inner = [response.names.index(p.name) for p in locals_of(model)]
    table = multi_indices(len(response.names), response.degree)
    exponents = np.zeros((len(table), 3), dtype=np.int64)
    exponents[:, 3 - len(inner) :] = table[:, inner]
    offset = sum(
        math.log(p.prior.high - p.prior.low) for p in locals_of(model) if p.prior.kind == "normal"
    )
    return Packed(
        np.ascontiguousarray(response.a),
        np.ascontiguousarray(response.b),
        np.ascontiguousarray(response.log_v),
        response.ka**2,
        response.kb**2,
        exponents,
        len(inner),
        offset,
    )


def _factors(
    model: Model, rows: BladeRows, space: SharedSpace, x: Array, fixed: dict[str, float]
) -> Array:
    """Monomials of all inputs that are not local, at shared values x (n, d): (n, M)."""
    response = rows.response
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
    s2 += (rows.relative * y) ** 2
    for d in rows.dense:
        offset = [value(name) for name in d.offset]
        rest += d.log_density(value(d.sigma), np.stack(offset, axis=1) if offset else x[:, :0])
    return y, s2, rest


def _split(n: int) -> list[slice]:
    parts = min(_POOL._max_workers, n)
    edges = np.linspace(0, n, parts + 1).astype(int)
    return [slice(int(a), int(b)) for a, b in pairwise(edges) if b > a]


class BladeMessage:
    """The message of one blade's readings, as a function of the shared parameters."""

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
    def packed(self) -> Packed:
        """The rows in the compiled functions' layout, made when first needed."""
        return pack(self.model, self.rows)

    def column(self, unit: Array, rough: bool = False) -> Array:
        """log m_b at nodes `unit` (n, d) of the unit box, (n,)."""
        out = np.empty(len(unit))
        rest = self._at(unit, kernel.messages, (rough,), (out,))
        return out + rest + self.packed.offset

    def draws(
        self, unit: Array, per_node: int, rng: np.random.Generator, column: Array
    ) -> tuple[Array, Array]:
        """Weighted local parameters at each node.

        Returns values (K, per_node, L) and log weights (K, per_node). A weight is L / q divided by
        the exact message `column` (K,), so that a node's weights sum to one on average; dividing by
        their own sum instead would bias every mean by the order of 1 / per_node.
        """
        k, p = len(unit), self.packed
        u, z = rng.random((k, per_node, 6)), rng.standard_normal((k, per_node, 2))
        share = drawing.SHARE if p.dim == 3 else 1
        groups = per_node // share
        assert groups * share == per_node, "particles per node must be whole groups"
        strata = (np.arange(groups) + rng.random((k, groups))) / groups
        u[:, :, 0] = np.repeat(strata, share, axis=1)
        out, log_w = np.empty((k, per_node, 3)), np.empty((k, per_node))
        rest = self._at(unit, drawing.draws, (), (u, z, out, log_w))
        constant = p.offset - 0.5 * len(self.rows.y) * math.log(2 * math.pi) - p.dim * math.log(2.0)
        log_w += constant - math.log(per_node) + (rest - column)[:, None]
        if not np.all(log_w < np.inf):  # neither NaN nor an unbounded weight
            raise CalibrationError(
                f"{int(np.sum(~(log_w < np.inf)))} draws of a blade have no weight; its readings: "
                f"{self.rows.y.tolist()[:12]}"
            )
        return _natural(self.model, out[:, :, 3 - p.dim :]), log_w

    def _at(
        self,
        unit: Array,
        function: Callable[..., None],
        options: tuple[object, ...],
        per_node: tuple[Array, ...],
    ) -> Array:
        """Run a compiled function at every node, nodes shared out to threads.

        per_node   arrays that it reads or fills, by node
        Returns the log density of the scans' remainders at each node, (n,).
        """
        x, p = self.space.to_x(unit), self.packed
        factors = _factors(self.model, self.rows, self.space, x, self.fixed)
        y, s2, rest = _readings(self.rows, self.space, x)
        rows = (p.a, p.b, p.v, p.exponents)

        def work(part: slice) -> None:
            own = (array[part] for array in per_node)
            function(*rows, factors[part], y[part], s2[part], p.ka2, p.kb2, p.dim, *options, *own)

        list(_POOL.map(work, _split(len(x))))
        return rest


def prior_draws(
    model: Model, nodes: int, per_node: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Local parameters of a blade without a reading: its prior, the same at every node."""
    parameters = locals_of(model)
    strata = rng.random((nodes * per_node, len(parameters)))
    n = len(strata)
    for j in range(len(parameters)):
        strata[:, j] = (rng.permutation(n) + strata[:, j]) / n
    values = np.stack([p.prior.quantile(strata[:, j]) for j, p in enumerate(parameters)], axis=1)
    return (
        values.reshape(nodes, per_node, len(parameters)),
        np.full((nodes, per_node), -math.log(per_node)),
    )


def _natural(model: Model, scaled: Array) -> Array:
    low = np.array([p.prior.low for p in locals_of(model)])
    high = np.array([p.prior.high for p in locals_of(model)])
    return np.asarray(low + 0.5 * (scaled + 1) * (high - low))
