"""The joint target of a rotor, with nothing integrated out, for any array module.

All parameters of all blades at once, on the compiled rows of `core.calibration.target`,

    log p(s, l, D) = log p(s) + Σ_b log p(l_b)
                     + Σ_r log N(y_r | g_r(s) Y_r(l, s) + o_r(s), sigma_r² + extra_r
                                       + (nu (y_r − o_r))² + (g_r s_r(l, s))²)
                     + remainders of scans

with Y_r = a_r e^{b_r}, the surrogate's standard deviation s_r taken at every point, and a gain
g = 1 + Σ and an offset o that are linear in the discrepancies' parameters. The rows are evaluated
by code of its own (numpy, jax.numpy or pytensor), so that a fault in the compiled messages shows.
Parameters lie on unit boxes: a log-uniform noise is uniform in its logarithm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.answers import Stacked
from core.calibration.responses import DEGREE
from core.calibration.scans import Dense
from core.calibration.space import locals_of, shared_space
from core.calibration.state import RotorSpec
from core.calibration.target import BladeRows, assemble
from core.discrepancy import Term
from core.errors import InputError
from core.model import Model
from core.monomials import multi_indices
from core.observation import Inspection
from core.prior import cut_mass
from core.validation.tables import powers, products, split

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
    relative        (N,) error in proportion to the model's answer
    gain, offset    (N, S) coefficients of g − 1 and o in the shared parameters
    normal          (place, mean, sd, log of the mass within the box) of shared normal priors
    remainders      of scans: place of sigma, sd, and the scan's own numbers
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
    relative: Array
    gain: Array
    offset: Array
    normal: tuple[tuple[int, float, float, float], ...]
    remainders: tuple[tuple[int, float, Dense], ...]

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
        flat: list[tuple[int | float | Array, ...]] = []
        remainders = []
        for b, name in enumerate(rotor.blades):
            if name not in rows:
                continue
            own = rows[name]
            for r, (table, sigma) in enumerate(
                zip(split(own.polynomials, outer, inner), own.sigma, strict=True)
            ):
                ka, kb = float(own.polynomials.ka[r]), float(own.polynomials.kb[r])
                key = table.tobytes() + np.array([ka, kb]).tobytes()
                if key not in index:
                    index[key] = len(tables)
                    tables.append(table)
                    scales.append((ka, kb))
                flat.append(
                    (
                        b,
                        index[key],
                        own.y[r],
                        own.extra[r],
                        *_noise(space.names, sigma),
                        own.relative[r],
                        _linear(space.names, own.discrepancy[r].gain),
                        _linear(space.names, own.discrepancy[r].offset),
                    )
                )
            for d in own.dense:
                remainders.append((*_noise(space.names, d.sigma), d))
        boxes = [p.box for p in space.priors] + [p.prior.box for p in parameters]
        blade, row, y, extra, noise, sd, relative, gain, offset = map(
            np.array, zip(*flat, strict=True)
        )
        normal = (
            (j, p.mean, p.sd, float(np.log(cut_mass(p.mean, p.sd, *p.box))))
            for j, p in enumerate(space.priors)
            if p.kind == "normal"
        )
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
            blade,
            row,
            y,
            extra,
            noise,
            sd,
            relative,
            gain,
            offset,
            tuple(normal),
            tuple(remainders),
        )

    def log_blades(self, jnp: Any, shared: Any, local: Any) -> Any:
        """log p(rows of a blade | shared, local), which is without remainders: (S,), (B, L) → (B,).

        Both on the unit boxes. jnp   the array module: numpy, jax.numpy or pytensor.tensor
        """
        u = self._working(shared)
        mean, surrogate = (v[self.blade, self.row] for v in self.rows_at(jnp, shared, local))
        sigma = jnp.where(self.noise < 0, self.sd, jnp.exp(u[np.maximum(self.noise, 0)]))
        gain, y = 1 + self.gain @ u, self.y - self.offset @ u
        var = sigma**2 + self.extra + (self.relative * y) ** 2 + gain**2 * surrogate
        terms = -0.5 * ((y - gain * mean) ** 2 / var + jnp.log(2 * math.pi * var))
        return (np.arange(len(self.blades))[:, None] == self.blade).astype(float) @ terms

    def log_shared(self, jnp: Any, shared: Any) -> Any:
        """log p of what no local parameter moves: priors that are not uniform on the unit box, and
        what scans leave beside their rows, which is about their noise and their offset alone."""
        u, total = self._working(shared), 0.0
        for j, mean, sd, log_mass in self.normal:
            size = math.log((self.high[j] - self.low[j]) / (sd * math.sqrt(2 * math.pi)))
            total += size - log_mass - 0.5 * ((u[j] - mean) / sd) ** 2
        for at, sd, d in self.remainders:
            var = (sd**2 if at < 0 else jnp.exp(2 * u[at])) + d.extra
            rss = d.rss
            if d.offset:
                miss = u[np.array([self.shared.index(n) for n in d.offset])] - d.centre
                rss += miss @ d.bend @ miss
            total += d.turned - 0.5 * rss / var - 0.5 * d.dof * jnp.log(2 * math.pi * var)
        return total

    def log_joint(self, jnp: Any, shared: Any, local: Any) -> Any:
        """log p of everything; all other priors are uniform on the unit boxes."""
        return jnp.sum(self.log_blades(jnp, shared, local)) + self.log_shared(jnp, shared)

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
    terms = [t for r in rows for one in r.discrepancy for t in (*one.gain, *one.offset)]
    if any(len(names) != 1 for _, names in terms):
        raise InputError("discrepancy", "paper", "has no reference", "declare another kind")


def _noise(names: Sequence[str], sigma: str | float) -> tuple[int, float]:
    return (names.index(sigma), 1.0) if isinstance(sigma, str) else (-1, float(sigma))


def _linear(names: Sequence[str], terms: Sequence[Term]) -> Array:
    """Coefficients of a sum of shared parameters, (S,)."""
    out = np.zeros(len(names))
    for coefficient, (name,) in terms:
        out[names.index(name)] += coefficient
    return out
