"""What a blade's readings say in the paper's schedule: a likelihood, some parameters held.

With the discrepancy y = g Y_m + o of each row (`core.discrepancy`),

    log L = Σ_i log N(y_i | g_i Y_m,i + o_i,
                      sigma_obs² + sigma_delta² + (nu (y_i − o_i))² + g_i² sigma_surrogate²)

from the rows of `core.calibration.target.assemble`, a scan's remainder included. Held parameters
have one value, or M of them over which L is averaged: the rows' polynomials are collapsed to the
free ones once for each.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from core.calibration.scans import Dense
from core.calibration.schedule_filter import LogDensity
from core.calibration.space import locals_of, nominal
from core.calibration.target import assemble
from core.discrepancy import total
from core.model import Model
from core.monomials import multi_indices
from core.observation import Inspection

Array = NDArray[np.float64]


class Readings:
    """Readings of one blade as a likelihood, some parameters held and the others free.

    names    inputs of the model that the rows depend on
    shared   noises and parameters of the discrepancy that the rows see
    """

    def __init__(
        self, model: Model, readings: Sequence[Inspection], given: Mapping[str, float] | None
    ) -> None:
        rows = assemble(model, readings)
        assert rows is not None
        response = rows.polynomials
        self.names, self.shared = response.names, rows.shared
        normal = sum(p.prior.kind == "normal" for p in locals_of(model, response.names))
        count = len(rows.y) - normal  # the rows of normal priors come last: beliefs hold these
        self.low, self.high = response.low, response.high
        self.table = multi_indices(len(response.names), response.degree)
        self.a, self.b, self.v = (c[:count] for c in (response.a, response.b, response.log_v))
        self.ka, self.kb = response.ka[:count], response.kb[:count]
        self.y, self.extra = rows.y[:count], rows.extra[:count]
        self.sigma, self.relative = rows.sigma[:count], rows.relative[:count]
        self.wrong, self.dense = rows.discrepancy[:count], rows.dense
        self.known = nominal(model, response.names, given)

    def holding(self, held: Mapping[str, Array], free: Sequence[str]) -> LogDensity:
        """x (n, d) of the `free` parameters → log of the mean over the M held values of L, (n,)."""
        m = len(next(iter(held.values()))) if held else 1
        fixed = {**{n: np.full(m, v) for n, v in self.known.items()}, **held}
        place = {name: j for j, name in enumerate(free)}
        inner = [j for j, name in enumerate(self.names) if name in place]
        factor = np.ones((m, len(self.table)))
        for j, name in enumerate(self.names):
            if j not in inner:
                z = 2 * (fixed[name] - self.low[j]) / (self.high[j] - self.low[j]) - 1
                factor *= z[:, None] ** self.table[:, j]
        exponents, group = np.unique(self.table[:, inner], axis=0, return_inverse=True)
        gather = np.zeros((len(self.table), len(exponents)))
        gather[np.arange(len(self.table)), group.ravel()] = 1.0
        a, b, v = ((c[:, None] * factor) @ gather for c in (self.a, self.b, self.v))  # (R, M, F)
        low, half = self.low[inner], 0.5 * (self.high[inner] - self.low[inner])
        columns = [place[self.names[j]] for j in inner]

        def log_likelihood(x: Array) -> Array:
            def value(name: str | float) -> Array:
                if not isinstance(name, str):
                    return np.full((1, 1), name)
                return x[:, [place[name]]] if name in place else fixed[name][None]

            basis = _monomials((x[:, columns] - low) / half - 1.0, exponents)
            score = np.zeros((len(x), m))
            doubt = np.exp(basis @ v[0].T)
            for r in range(len(self.y)):
                if r and not np.array_equal(self.v[r], self.v[r - 1]):
                    doubt = np.exp(basis @ v[r].T)
                scale = np.exp(basis @ b[r].T) if np.any(b[r]) else np.ones((1, 1))
                a_r = basis @ a[r].T if np.any(a[r][:, 1:]) else a[r][None, :, 0]
                scale = scale * (1.0 + total(self.wrong[r].gain, value))
                seen = self.y[r] - total(self.wrong[r].offset, value)
                noise = value(self.sigma[r])
                variance = noise**2 + self.extra[r] + (self.relative[r] * seen) ** 2
                if self.ka[r] or self.kb[r]:
                    spread = self.ka[r] ** 2 + (a_r * self.kb[r]) ** 2
                    variance = variance + scale**2 * doubt * spread
                miss = a_r * scale - seen
                score -= 0.5 * (miss**2 / variance + np.log(2 * np.pi * variance))
            for d in self.dense:
                score += _remainder(d, value, score.shape)
            top = score.max(axis=1)
            return np.asarray(top + np.log(np.exp(score - top[:, None]).mean(axis=1)))

        return log_likelihood


def _remainder(
    dense: Dense, value: Callable[[str | float], Array], shape: tuple[int, ...]
) -> Array:
    """Log density of a scan's remainder, where noise and offset are held or free, (n, M)."""
    noise = np.broadcast_to(value(dense.sigma), shape).ravel()
    offset = [np.broadcast_to(value(name), shape).ravel() for name in dense.offset]
    c = np.stack(offset, axis=1) if offset else np.zeros((len(noise), 0))
    return dense.log_density(noise, c).reshape(shape)


def _monomials(z: Array, exponents: NDArray[np.int64]) -> Array:
    """Monomials with these exponents (F, d) at z (n, d): (n, F)."""
    out = np.ones((len(exponents), len(z)))
    for j in range(z.shape[1]):
        powers = np.ones((int(exponents[:, j].max()) + 1, len(z)))
        for k in range(1, len(powers)):
            powers[k] = powers[k - 1] * z[:, j]
        out *= powers[exponents[:, j]]
    return out.T
