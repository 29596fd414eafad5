"""Readings of one blade as the posterior of earlier ones foretells them (`residuals`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from core.calibration.space import nominal, shared_prior
from core.calibration.state import RotorState, blade_posterior
from core.calibration.target import BladeRows
from core.curves import IRRATIONAL, spread
from core.discrepancy import total
from core.model import Model
from core.rng import stream

Array = NDArray[np.float64]
DRAWS = 2000


@dataclass(frozen=True)
class Fresh:
    """Values of shared parameters that nobody has read yet: the same for all blades of a draw."""

    model: Model
    seed: int
    drawn: dict[str, Array] = field(default_factory=dict)

    def of_draws(self, name: str) -> Array:
        """(DRAWS,)"""
        if name not in self.drawn:
            uniform = stream(self.seed, "fresh", name).random(DRAWS)
            self.drawn[name] = np.asarray(shared_prior(self.model, name).quantile(uniform))
        return self.drawn[name]


@dataclass(frozen=True)
class Foretold:
    """A blade's rows: y, mean, sd [unit], z, PIT (n,); by_node (K, n); signal, noise (DRAWS, n)."""

    rows: BladeRows
    place: tuple[int, ...]
    y: Array
    mean: Array
    sd: Array
    z: Array
    pit: Array
    covariance: Array
    by_node: Array
    signal: Array
    noise: Array


def foretold(
    model: Model,
    state: RotorState,
    blade: str,
    rows: BladeRows,
    known: Mapping[str, float] | None,
    node: NDArray[np.int64],
    fresh: Fresh,
    rng: np.random.Generator,
) -> Foretold:
    """A blade's rows under a state.

    rows   of the readings that are predicted
    known  the blade's known inputs
    node   (DRAWS,) the shared node of each draw, one for all blades
    """
    get = state.arrays.__getitem__
    posterior = blade_posterior(state.meta, get, blade)
    w, nodes = posterior.particles.w, len(get("shared/log_w"))
    names, fixed = rows.response.names, nominal(model, rows.response.names, known)
    x = np.stack(
        [posterior.column(n) if n not in fixed else np.full(len(w), fixed[n]) for n in names],
        axis=1,
    )
    place = tuple(p for p in rows.of if p >= 0)
    n = len(place)
    f, deviation = (a[:, :n] for a in rows.response.evaluate(x))
    deviation = deviation / np.sqrt(rows.discount[:n])  # forgetting is of readings that are used
    places: dict[str, int] = {}

    def of_particles(name: str) -> Array:
        if name in posterior.names:
            return posterior.column(name)
        at = places.setdefault(name, len(places)) % len(IRRATIONAL)
        return spread(shared_prior(model, name), len(w), at)

    per = len(w) // nodes
    within = np.exp(get(f"blade/{blade}/log_w") - get(f"blade/{blade}/log_w").max(1, keepdims=True))
    reached = np.cumsum(within, axis=1)[node]
    draw = (reached < (rng.random(DRAWS) * reached[:, -1])[:, None]).sum(axis=1)
    chosen = node * per + np.minimum(draw, per - 1)

    def of_draws(name: str) -> Array:
        if name in posterior.names:
            return np.asarray(posterior.column(name)[chosen])
        return fresh.of_draws(name)

    def seen(value: Callable[[str], Array], answer: Array, sd: Array) -> tuple[Array, Array, Array]:
        """Mean, variance beside the noise, and variance of the noise, of each row."""
        count = len(answer)
        gain, offset, noise = (np.empty((count, n)) for _ in range(3))
        for i, one in enumerate(rows.discrepancy[:n]):
            gain[:, i] = 1.0 + total(one.gain, value)
            offset[:, i] = total(one.offset, value)
            sigma = rows.sigma[i]
            noise[:, i] = np.square(value(sigma) if isinstance(sigma, str) else sigma)
        beside = (gain * sd) ** 2 + (rows.relative[:n] * gain * answer) ** 2 + rows.extra[:n]
        return gain * answer + offset, beside, noise

    centre, beside, noise = seen(of_particles, f, deviation)
    v, y = beside + noise, rows.y[:n]
    mean = w @ centre
    off = centre - mean
    covariance = off.T @ (w[:, None] * off) + np.diag(w @ v)
    sd = np.sqrt(np.diag(covariance))
    drawn, drawn_beside, drawn_noise = seen(of_draws, f[chosen], deviation[chosen])
    drawn = drawn + np.sqrt(drawn_beside) * rng.standard_normal(drawn.shape)
    weight = w.reshape(nodes, per)
    share = weight.sum(axis=1, keepdims=True) + 1e-300
    return Foretold(
        rows,
        place,
        y,
        mean,
        sd,
        (y - mean) / sd,
        w @ ndtr((y - centre) / np.sqrt(v)),
        covariance / np.outer(sd, sd),
        np.einsum("kj,kjn->kn", weight / share, off.reshape(nodes, per, n)) / sd,
        (drawn - mean) / sd,
        np.sqrt(drawn_noise) / sd,
    )
