"""A blade's rows and shared nodes in the layout of the compiled functions (`kernel`).

The nodes go in blocks of `LANES` that lie close together. What a block holds of the shared inputs,
their monomials, is the same for all blades that were read at the same times, and is kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from core.calibration.lines import SAME
from core.calibration.space import SharedSpace, locals_of
from core.calibration.target import BladeRows
from core.calibration.vector import LANES
from core.discrepancy import total
from core.model import Model
from core.monomials import multi_indices
from core.network import Parameter
from core.prior import cut_mass

Array = NDArray[np.float64]


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
    return _monomials(*_outer(model, rows, space, x, fixed), rows.polynomials.degree)


def _outer(
    model: Model, rows: BladeRows, space: SharedSpace, x: Array, fixed: dict[str, float]
) -> tuple[Array, tuple[int, ...], int]:
    """Inputs that are not local, scaled to [-1, 1], (n, k); their places among the d inputs; d."""
    response, inner = rows.polynomials, {p.name for p in locals_of(model)}
    outer = tuple(j for j, name in enumerate(response.names) if name not in inner)
    z = np.empty((len(x), len(outer)))
    for k, j in enumerate(outer):
        name = response.names[j]
        value = x[:, space.names.index(name)] if name in space.names else fixed[name]
        z[:, k] = 2 * (value - response.low[j]) / (response.high[j] - response.low[j]) - 1
    return z, outer, len(response.names)


def _monomials(z: Array, outer: tuple[int, ...], d: int, degree: int) -> Array:
    table = multi_indices(d, degree)
    powers = np.ones((degree + 1, *z.shape))
    for k in range(1, degree + 1):
        powers[k] = powers[k - 1] * z
    out = np.ones((len(table), len(z)))
    for k, j in enumerate(outer):
        out *= powers[table[:, j], :, k]
    return np.ascontiguousarray(out.T)


def _laid(values: Array, padded: NDArray[np.int64]) -> Array:
    """Values of the nodes (n, m) in blocks (N, m, LANES)."""
    parts = values[padded].reshape(len(padded) // LANES, LANES, -1)
    return np.ascontiguousarray(parts.transpose(0, 2, 1))


@lru_cache(maxsize=16)
def _factors(z: bytes, outer: tuple[int, ...], d: int, degree: int, padded: bytes) -> Array:
    """The monomials in blocks: the same for all blades that were read at the same times."""
    order = np.frombuffer(padded, dtype=np.int64)
    values = np.frombuffer(z).reshape(-1, len(outer)) if outer else np.empty((order.max() + 1, 0))
    return _laid(_monomials(values, outer, d, degree), order)


def readings_at(rows: BladeRows, space: SharedSpace, x: Array) -> tuple[Array, Array, Array]:
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


def blocks_of(
    model: Model, rows: BladeRows, space: SharedSpace, unit: Array, fixed: dict[str, float]
) -> Blocks:
    """What the compiled functions need of the nodes `unit` (n, d), in blocks of like ones."""
    x = space.to_x(unit)
    y, s2, rest = readings_at(rows, space, x)
    order = np.argsort(unit[:, 0], kind="stable")
    blocks = -(-len(unit) // LANES)
    padded = np.concatenate([order, np.repeat(order[-1:], blocks * LANES - len(order))])
    z, outer, d = _outer(model, rows, space, x, fixed)
    factors = _factors(z.tobytes(), outer, d, rows.polynomials.degree, padded.tobytes())
    return Blocks(order, factors, _laid(y, padded), _laid(s2, padded), rest)
