"""What a calibrated model expects inspections ahead to read.

What a model expects of several candidates (`core.planning.candidates`) is taken for normal, with
the particles' own moments,

    m_c = E f_c,     C_cd = Cov(f_c, f_d) + [c = d] E(s_c² + sigma_c²)

f being the blade's answer with the biases of whoever reads. On one blade the covariance is that of
its joint particles; between blades only the shared parameters s are common, so it is the covariance
of E[f_c | s] and E[f_d | s] over the shared nodes. The surrogate's error s_c counts as independent
between readings, as in the calibration.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.calibration.state import Posterior, RotorState, blade_posterior
from core.curves import corrected, inputs_of, noise_of
from core.errors import InputError
from core.model import Model
from core.planning.candidates import Candidate
from core.planning.ready import ready
from core.smc.particles import Particles, normalised

Array = NDArray[np.float64]
TO_COME = "to come"  # a campaign that is none of those that were
SQRT2 = 2.0**0.5


@dataclass(frozen=True)
class Expected:
    """What a model expects of C readings, or of other things that its particles tell.

    mean    (C,); noise: variance of surrogate and readings, (C,)
    blades  by blade its particles' weights (n,) and what they expect less the mean, (n, c)
    nodes   the same given the shared nodes, (K, C), with their weights node_w (K,)
    place   blade of each, and its column there
    """

    mean: Array
    noise: Array
    blades: Mapping[str, tuple[Array, Array]]
    nodes: Array
    node_w: Array
    place: tuple[tuple[str, int], ...]

    @property
    def sd(self) -> Array:
        """Standard deviation of each reading, (C,)."""
        own = [float(self.blades[b][0] @ self.blades[b][1][:, i] ** 2) for b, i in self.place]
        return np.asarray(np.sqrt(np.array(own) + self.noise))

    def covariance(self, which: Sequence[int]) -> Array:
        """Of the readings of these, (k, k)."""
        out = self.cross(self)[np.ix_(which, which)] + np.diag(self.noise[list(which)])
        return np.asarray(0.5 * (out + out.T))

    def cross(self, other: Expected) -> Array:
        """Covariance with what the same state expects of others, without noise, (C, D)."""
        out = (self.nodes * self.node_w[:, None]).T @ other.nodes
        for blade in self.blades.keys() & other.blades.keys():
            (w, f), (_, g) = self.blades[blade], other.blades[blade]
            rows = [i for i, (b, _) in enumerate(self.place) if b == blade]
            columns = [i for i, (b, _) in enumerate(other.place) if b == blade]
            out[np.ix_(rows, columns)] = (f * w[:, None]).T @ g
        return np.asarray(out)


def expected(
    model: Model,
    state: RotorState,
    asked: Sequence[Candidate],
    known: Mapping[str, Mapping[str, float]] | None = None,
    *,
    noise: bool = True,
    most: int | None = None,
) -> Expected:
    """Moments of the readings, by the particles of a state.

    noise  False: the blades themselves, without readings' noise and biases
    most   particles of a blade that are used, as many of each node; None: all

    Raises InputError where there is no candidate.
    """
    if not asked:
        raise InputError("candidates", 0, "cannot be ranked", "give blades, hours and quantities")
    by_blade: dict[str, list[int]] = {}
    for c, one in enumerate(asked):
        by_blade.setdefault(one.blade, []).append(c)
    mean, own_noise = np.zeros(len(asked)), np.zeros(len(asked))
    nodes: list[Array] = [np.zeros(0)] * len(asked)
    place: list[tuple[str, int]] = [("", 0)] * len(asked)
    blades, drawn = {}, {blade: Drawn.of(state, blade, most) for blade in by_blade}
    fewest = min(len(one.w) for one in drawn.values())
    ready(model, fewest, ((one.blade, one.quantity, one.time_h) for one in asked))
    for blade, members in by_blade.items():
        particles = drawn[blade]
        own = [asked[c] for c in members]
        f, v = answered(
            model.for_blade(blade), particles.posterior, own, (known or {}).get(blade), noise=noise
        )
        mean[members], off, given = particles.centred(f)
        own_noise[members] = particles.w @ v
        blades[blade] = (particles.w, off)
        for i, c in enumerate(members):
            place[c], nodes[c] = (blade, i), given[:, i]
    node_w = normalised(state.arrays["shared/log_w"])
    return Expected(mean, own_noise, blades, np.stack(nodes, axis=1), node_w, tuple(place))


@dataclass(frozen=True)
class Drawn:
    """A blade's particles, node by node: weights w (n,) of K nodes with as many draws each."""

    posterior: Posterior
    w: Array
    node_w: Array

    @staticmethod
    def of(state: RotorState, blade: str, most: int | None = None) -> Drawn:
        """All of a state's, or one of so many that they are `most` or fewer, as many of each node.

        A node's draws stand in the order of the blade's outer parameter, ten to a value of it
        (`core.calibration.draws`). Every third of them would be four of the first value and of the
        last, and three of others, the same at all nodes: 5 % too much below its 5 % quantile. So
        every node begins elsewhere.
        """
        found = blade_posterior(state.meta, state.arrays.__getitem__, blade)
        node_w = normalised(state.arrays["shared/log_w"])
        nodes, count = len(node_w), len(found.particles.log_w) // len(node_w)
        each = count if most is None else max(1, most // nodes)
        own = -(-count // -(-count // each))  # one of two, or three, or so many
        begin = np.arange(nodes)[:, None] * SQRT2 % 1.0
        kept = np.floor((np.arange(own) + begin) * (count / own)).astype(np.int64)
        kept = (np.minimum(kept, count - 1) + count * np.arange(nodes)[:, None]).ravel()
        few = Particles(found.particles.psi[kept], found.particles.log_w[kept])
        return Drawn(Posterior(found.names, few), few.w, node_w)

    def centred(self, f: Array) -> tuple[Array, Array, Array]:
        """Mean (c,) of values (n, c), the values less it, and their means at the nodes (K, c)."""
        mean = self.w @ f
        off = f - mean
        inner = self.w.reshape(len(self.node_w), -1)
        sums = np.maximum(inner.sum(axis=1), 1e-300)
        given = np.einsum("km,kmc->kc", inner, off.reshape(*inner.shape, -1)) / sums[:, None]
        return np.asarray(mean), np.asarray(off), np.asarray(given - self.node_w @ given)


def answered(
    model: Model,
    posterior: Posterior,
    asked: Sequence[Candidate],
    known: Mapping[str, float] | None,
    *,
    noise: bool,
) -> tuple[Array, Array]:
    """Of one blade's candidates: f (N, c) with biases, variance of surrogate and noise (N, c)."""
    n = len(posterior.particles.log_w)
    f, v = np.zeros((n, len(asked))), np.zeros((n, len(asked)))
    for quantity in sorted({one.quantity for one in asked}):
        declared, part = model.network.quantity(quantity), model.part(quantity)
        members = [i for i, one in enumerate(asked) if one.quantity == quantity]
        hours = np.unique([asked[i].time_h for i in members])
        nodes = None if declared.kind == "scalar" else [declared.node_among(part.named)]
        x = inputs_of(model, posterior, quantity, known)
        y, s = (a.reshape(n, len(hours)) for a in part.predict(x, quantity, hours, nodes))
        for i in members:
            one = asked[i]
            at = int(np.searchsorted(hours, one.time_h))
            reader = (one.instrument, TO_COME) if noise else None
            gain, offset, sigma_delta, left = corrected(
                model, posterior, declared, np.array([one.time_h]), None, reader
            )
            f[:, i] = gain[:, 0] * y[:, at] + offset[:, 0]
            sd = gain[:, 0] * np.hypot(s[:, at], declared.numerical * y[:, at])
            v[:, i] = sd**2 + sigma_delta[0] ** 2 + (left[0] * gain[:, 0] * y[:, at]) ** 2
            if noise:
                name = one.instrument if declared.by_instrument else None
                own = noise_of(model, posterior, quantity, name) if one.sigma is None else one.sigma
                v[:, i] += np.square(own)
    return f, v
