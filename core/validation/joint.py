"""The joint target of a rotor, with nothing integrated out, for any array module.

All parameters of all blades at once, on the compiled rows of `core.calibration.target`,

    log p(s, l, D) = log p(s) + Σ_b log p(l_b)
                     + Σ_r log N(y_r | Y_r(l, s), sigma_r² + extra_r + (nu y_r)² + s_r(l, s)²)
                     + remainders of scans

with Y_r = a_r e^{b_r} and the surrogate's standard deviation s_r taken at every point. The rows are
evaluated by code of its own (numpy, jax.numpy or pytensor), so that a fault in the compiled
messages shows. Parameters lie on unit boxes: a log-uniform noise is uniform in its logarithm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.calibration.space import locals_of, shared_space
from core.calibration.state import RotorSpec
from core.calibration.target import DEGREE, BladeRows, assemble
from core.errors import InputError
from core.model import Model, Stacked
from core.observation import Inspection
from core.response import Response, multi_indices

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Target:
    """A rotor's joint target as flat arrays.

    shared, local   names; low, high (S + L,) bounds on the working scale, shared ones first
    inputs          places of the physical ones among the shared parameters
    tables          (p, …, M, 3 U) coefficients of a, b and log v of U distinct rows: powers of
                    the shared inputs, then monomials of the local ones with exponents (M, L)
    blade, row      (N,) which blade and which of the U rows a reading belongs to
    noise           (N,) place of its shared sigma, or −1 where `sd` (N,) is known
    remainders      (place of sigma, sd, residual sum of squares, degrees of freedom) of scans
    """

    shared: tuple[str, ...]
    local: tuple[str, ...]
    blades: tuple[str, ...]
    low: Array
    high: Array
    logarithmic: NDArray[np.bool_]
    inputs: tuple[int, ...]
    tables: Array
    exponents: NDArray[np.int64]
    ka2: Array
    kb2: Array
    blade: NDArray[np.int64]
    row: NDArray[np.int64]
    y: Array
    extra: Array
    noise: NDArray[np.int64]
    sd: Array
    remainders: tuple[tuple[int, float, float, int], ...]

    @staticmethod
    def of(model: Model, rotor: RotorSpec, readings: Sequence[Inspection]) -> Target:
        """The target of these readings; blades without any keep their prior.

        Raises InputError for a blade that the rotor does not have and for networks that this
        second writing does not cover.
        """
        by_blade: dict[str, list[Inspection]] = {}
        for reading in readings:
            if reading.blade not in rotor.blades:
                raise InputError("blade", reading.blade, f"is not on {rotor.id}", "install it")
            by_blade.setdefault(reading.blade, []).append(reading)
        found = {b: assemble(model, own) for b, own in sorted(by_blade.items())}
        rows = {b: r for b, r in found.items() if r is not None}
        _covered(model, list(rows.values()))
        space, parameters = shared_space(model, rows.values()), locals_of(model)
        physical = [n for n in space.names if n in model.input_names]
        outer = [model.input_names.index(n) for n in physical]
        inner = [model.input_names.index(p.name) for p in parameters]
        index: dict[bytes, int] = {}
        tables: list[Array] = []
        scales: list[tuple[float, float]] = []
        flat: list[tuple[int, int, float, float, int, float]] = []
        remainders = []
        for b, name in enumerate(rotor.blades):
            if name not in rows:
                continue
            own = rows[name]
            extra = own.extra + (own.relative * own.y) ** 2
            for r, (table, sigma) in enumerate(
                zip(split(own.polynomials, outer, inner), own.sigma, strict=True)
            ):
                ka, kb = float(own.polynomials.ka[r]), float(own.polynomials.kb[r])
                key = table.tobytes() + np.array([ka, kb]).tobytes()
                if key not in index:
                    index[key] = len(tables)
                    tables.append(table)
                    scales.append((ka, kb))
                at, sd = _noise(space.names, sigma)
                flat.append((b, index[key], float(own.y[r]), float(extra[r]), at, sd))
            for d in own.dense:
                remainders.append((*_noise(space.names, d.sigma), d.rss, d.dof))
        boxes = [p.box for p in space.priors] + [p.prior.box for p in parameters]
        blade, row, y, extra_, noise, sd_ = zip(*flat, strict=True)
        return Target(
            space.names,
            tuple(p.name for p in parameters),
            rotor.blades,
            np.array([low for low, _ in boxes]),
            np.array([high for _, high in boxes]),
            np.array([p.log_scale for p in space.priors] + [False] * len(parameters)),
            tuple(space.names.index(n) for n in physical),
            np.concatenate([np.stack([t[k] for t in tables], axis=-1) for k in range(3)], axis=-1),
            multi_indices(len(inner), DEGREE),
            np.array([ka for ka, _ in scales]) ** 2,
            np.array([kb for _, kb in scales]) ** 2,
            np.array(blade),
            np.array(row),
            np.array(y),
            np.array(extra_),
            np.array(noise),
            np.array(sd_),
            tuple(remainders),
        )

    def log_blades(self, jnp: Any, shared: Any, local: Any) -> Any:
        """log p(readings of a blade | shared, local) but for remainders: (S,), (B, L) → (B,).

        Both on the unit boxes. jnp   the array module: numpy, jax.numpy or pytensor.tensor
        """
        u = self._working(shared)
        mean, surrogate = (v[self.blade, self.row] for v in self.rows_at(jnp, shared, local))
        sigma = jnp.where(self.noise < 0, self.sd, jnp.exp(u[np.maximum(self.noise, 0)]))
        var = sigma**2 + self.extra + surrogate
        terms = -0.5 * ((self.y - mean) ** 2 / var + jnp.log(2 * math.pi * var))
        return (np.arange(len(self.blades))[:, None] == self.blade).astype(float) @ terms

    def log_remainders(self, jnp: Any, shared: Any) -> Any:
        """log p of what scans leave beside their rows, which is about their noise alone."""
        u, total = self._working(shared), 0.0
        for at, sd, rss, dof in self.remainders:
            log_sigma = math.log(sd) if at < 0 else u[at]
            total += -0.5 * rss * jnp.exp(-2 * log_sigma) - dof * (
                log_sigma + 0.5 * math.log(2 * math.pi)
            )
        return total

    def log_joint(self, jnp: Any, shared: Any, local: Any) -> Any:
        """log p of everything: the priors are uniform on the unit boxes."""
        of_blades = jnp.sum(self.log_blades(jnp, shared, local))
        return of_blades + self.log_remainders(jnp, shared)

    def _working(self, shared: Any) -> Any:
        s = len(self.shared)
        return self.low[:s] + shared * (self.high[:s] - self.low[:s])

    def rows_at(self, jnp: Any, shared: Any, local: Any) -> tuple[Any, Any]:
        """Mean and surrogate variance of every distinct row: local (n, L) → two (n, U)."""
        table = self.tables
        for i in self.inputs:
            table = jnp.tensordot(powers(jnp, 2 * shared[i] - 1, table.shape[0]), table, 1)
        basis = products(jnp, 2 * local - 1, self.exponents)
        answers, u = basis @ table, len(self.ka2)
        a, b, log_v = answers[:, :u], answers[:, u : 2 * u], answers[:, 2 * u :]
        return a * jnp.exp(b), jnp.exp(2 * b + log_v) * (self.ka2 + a**2 * self.kb2)

    def natural(self, unit: Array, first: int) -> Array:
        """Unit box → natural values; the last axis starts at parameter `first`."""
        own = slice(first, first + unit.shape[-1])
        u = self.low[own] + unit * (self.high[own] - self.low[own])
        return np.asarray(np.where(self.logarithmic[own], np.exp(u), u))


def _covered(model: Model, rows: Sequence[BladeRows]) -> None:
    """Refuse what `Target` does not write out."""
    if isinstance(model.surrogate, Stacked) or model.network.forgetting_h is not None:
        raise InputError("network", model.network.name, "has no reference", "use a plain one")
    for p in model.network.parameters:
        if p.level in ("known", "dormant") or p.population or p.prior.kind == "normal":
            raise InputError("parameter", p.name, "has no reference", "give it a uniform prior")
    if any(one.names or one.sigma or one.left for r in rows for one in r.discrepancy):
        raise InputError("discrepancy", model.network.name, "has no reference", "leave it out")


def _noise(names: Sequence[str], sigma: str | float) -> tuple[int, float]:
    return (names.index(sigma), 1.0) if isinstance(sigma, str) else (-1, float(sigma))


def powers(jnp: Any, z: Any, n: int) -> Any:
    """1, z, …, z^(n−1) along a new last axis."""
    out = [jnp.ones_like(z)]
    for _ in range(n - 1):
        out.append(out[-1] * z)
    return jnp.stack(out, axis=-1)


def products(jnp: Any, z: Any, exponents: NDArray[np.int64]) -> Any:
    """Products of powers: z (n, d), exponents (M, d) → (n, M), by matrices of 0 and 1."""
    degree = int(exponents.max())
    out = 1.0
    for j in range(exponents.shape[1]):
        choice = np.eye(degree + 1)[:, exponents[:, j]]
        out = out * (powers(jnp, z[:, j], degree + 1) @ choice)
    return out


def split(response: Response, outer: Sequence[int], inner: Sequence[int]) -> Array:
    """Rows as tables (R, 3, p + 1, …, M): powers of the inputs `outer`, monomials of `inner`.

    Together these are all inputs. The three are a, b and log v.
    """
    exponents = multi_indices(len(response.names), response.degree)
    local = multi_indices(len(inner), response.degree).tolist()
    where = np.array([local.index(e) for e in exponents[:, list(inner)].tolist()])
    out = np.zeros((len(response), 3, *[response.degree + 1] * len(outer), len(local)))
    place = (*exponents[:, list(outer)].T, where)
    for r in range(len(response)):
        for k, c in enumerate((response.a[r], response.b[r], response.log_v[r])):
            out[r, k][place] = c
    return out
