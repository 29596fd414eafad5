"""What a blade tells its rotor, and the blade's own particles.

log m_b(s) for many values of the shared parameters at once, exactly (`column`), roughly
(`glance`) or, inside a small box of shared values, by interpolation (`Interpolant`): one blade's
message is a hundred times broader than the rotor's posterior, so that inside the posterior's box a
few Chebyshev points hold it to a thousandth of a nat; the last coefficients say how well.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.calibration import draws as drawing
from core.calibration import kernel
from core.calibration.target import BladeRows, SharedSpace, locals_of
from core.errors import CalibrationError
from core.model import Model
from core.response import multi_indices

Array = NDArray[np.float64]
_POOL = ThreadPoolExecutor(max_workers=max(1, os.cpu_count() or 1))
TOLERANCE = 0.003  # nat, of the interpolated message
SIZES = (3, 5, 9, 17)


@dataclass(frozen=True, slots=True)
class Packed:
    """Rows of a blade in the layout of the compiled functions."""

    a: Array
    b: Array
    v: Array
    y: Array
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
        rows.y,
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


def _noise(rows: BladeRows, space: SharedSpace, x: Array) -> tuple[Array, Array]:
    """Noise variances (n, R), and the log density of the scans' remainders (n,)."""
    s2 = np.empty((len(x), len(rows.sigma)))
    for r, sigma in enumerate(rows.sigma):
        s2[:, r] = (x[:, space.names.index(sigma)] if isinstance(sigma, str) else sigma) ** 2
    s2 += rows.extra
    rest = np.zeros(len(x))
    for d in rows.dense:
        s = (
            x[:, space.names.index(d.sigma)]
            if isinstance(d.sigma, str)
            else np.full(len(x), d.sigma)
        )
        rest -= 0.5 * d.rss / s**2 + 0.5 * d.dof * np.log(2 * np.pi * s**2)
    return s2, rest


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
        speaks = {p.name for p in model.network.of_level("shared")} | set(rows.shared_sigmas)
        self.dims = tuple(j for j, name in enumerate(space.names) if name in speaks)

    @cached_property
    def packed(self) -> Packed:
        """The rows in the compiled functions' layout, made when first needed."""
        return pack(self.model, self.rows)

    def column(self, unit: Array, rough: bool = False) -> Array:
        """log m_b at nodes `unit` (n, d) of the unit box, (n,)."""
        x = self.space.to_x(unit)
        factors = _factors(self.model, self.rows, self.space, x, self.fixed)
        s2, rest = _noise(self.rows, self.space, x)
        p, out = self.packed, np.empty(len(x))

        def work(part: slice) -> None:
            kernel.messages(
                p.a,
                p.b,
                p.v,
                p.exponents,
                factors[part],
                p.y,
                s2[part],
                p.ka2,
                p.kb2,
                p.dim,
                rough,
                out[part],
            )

        list(_POOL.map(work, _split(len(x))))
        return out + rest + p.offset

    def interpolant(self, low: Array, high: Array, spend: int) -> Interpolant | None:
        """Chebyshev interpolant on a box of unit coordinates; None where `spend` points fail."""
        size = [3 if self.space.names[j].startswith("sigma") else 5 for j in self.dims]
        level = [SIZES.index(s) for s in size]
        known: dict[tuple[float, ...], float] = {}
        while True:
            axes = [np.cos(np.pi * np.arange(SIZES[k]) / (SIZES[k] - 1)) for k in level]
            grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(level))
            if len(grid) > spend:
                return None
            keys = [tuple(np.round(g, 12)) for g in grid]
            missing = [i for i, key in enumerate(keys) if key not in known]
            unit = np.tile(0.5 * (low + high), (len(missing), 1))
            for c, j in enumerate(self.dims):
                unit[:, j] = low[j] + 0.5 * (grid[missing, c] + 1) * (high[j] - low[j])
            for i, value in zip(missing, self.column(unit), strict=True):
                known[keys[i]] = float(value)
            values = np.array([known[key] for key in keys]).reshape([len(a) for a in axes])
            made = Interpolant.through(values, self.dims, low, high)
            worst = int(np.argmax(made.tails))
            if made.tails[worst] < TOLERANCE:
                return made
            if level[worst] + 1 == len(SIZES):
                return None
            level[worst] += 1

    def draws(
        self, unit: Array, per_node: int, rng: np.random.Generator, column: Array
    ) -> tuple[Array, Array]:
        """Weighted local parameters at each node.

        Returns values (K, per_node, L) and log weights (K, per_node). A weight is L / q divided by
        the exact message `column` (K,), so that a node's weights sum to one on average; dividing by
        their own sum instead would bias every mean by the order of 1 / per_node.
        """
        x = self.space.to_x(unit)
        factors = _factors(self.model, self.rows, self.space, x, self.fixed)
        s2, rest = _noise(self.rows, self.space, x)
        k, p = len(x), self.packed
        u, z = rng.random((k, per_node, 6)), rng.standard_normal((k, per_node, 2))
        share = drawing.SHARE if p.dim == 3 else 1
        groups = per_node // share
        assert groups * share == per_node, "particles per node must be whole groups"
        strata = (np.arange(groups) + rng.random((k, groups))) / groups
        u[:, :, 0] = np.repeat(strata, share, axis=1)
        out, log_w = np.empty((k, per_node, 3)), np.empty((k, per_node))

        def work(part: slice) -> None:
            drawing.draws(
                p.a,
                p.b,
                p.v,
                p.exponents,
                factors[part],
                p.y,
                s2[part],
                p.ka2,
                p.kb2,
                p.dim,
                u[part],
                z[part],
                out[part],
                log_w[part],
            )

        list(_POOL.map(work, _split(k)))
        constant = p.offset - 0.5 * len(p.y) * math.log(2 * math.pi) - p.dim * math.log(2.0)
        log_w += constant - math.log(per_node) + (rest - column)[:, None]
        if not np.all(log_w < np.inf):  # neither NaN nor an unbounded weight
            raise CalibrationError(
                f"{int(np.sum(~(log_w < np.inf)))} draws of a blade have no weight; its readings: "
                f"{self.rows.y.tolist()[:12]}"
            )
        return _natural(self.model, out[:, :, 3 - p.dim :]), log_w


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


@dataclass(frozen=True, slots=True)
class Interpolant:
    """Chebyshev coefficients of log m_b on a box; `tails` (nat) is the size of the last ones."""

    coefficients: Array
    dims: tuple[int, ...]
    low: Array
    high: Array
    tails: tuple[float, ...]

    @staticmethod
    def through(values: Array, dims: Sequence[int], low: Array, high: Array) -> Interpolant:
        c: Any = values
        tails = []
        for axis in range(values.ndim):
            n = values.shape[axis]
            points = np.cos(np.pi * np.arange(n) / (n - 1))
            inverse = np.linalg.inv(np.polynomial.chebyshev.chebvander(points, n - 1))
            c = np.moveaxis(np.tensordot(inverse, np.moveaxis(c, axis, 0), axes=1), 0, axis)
        for axis in range(values.ndim):
            last = np.take(c, [values.shape[axis] - 1], axis=axis)
            tails.append(float(np.abs(last).sum()))
        return Interpolant(np.asarray(c), tuple(dims), low, high, tuple(tails))

    def __call__(self, unit: Array) -> Array:
        """log m_b at nodes inside the box, (n,)."""
        z = [2 * (unit[:, j] - self.low[j]) / (self.high[j] - self.low[j]) - 1 for j in self.dims]
        basis = [
            np.polynomial.chebyshev.chebvander(zj, self.coefficients.shape[i] - 1)
            for i, zj in enumerate(z)
        ]
        letters = "abcdefgh"[: len(basis)]
        spec = ",".join(f"n{c}" for c in letters) + f",{letters}->n"
        return np.asarray(np.einsum(spec, *basis, self.coefficients, optimize=True))
