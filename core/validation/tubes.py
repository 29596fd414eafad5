"""Coordinates that straighten a rotor's posterior for a sampler; exact however good they are.

Posteriors of hot rotors are thin tubes that end at a cliff: T1T and TBC thickness act through metal
temperature, the creep deviates follow at fixed readings, and where one of them meets its bound the
tube breaks off. With u on the unit box, q = logit(u), and coordinates e,

    q_shared = mean + sd e
    q_b1     = base_b + ∫_0^e Σ_i d_bi B_i                       the first local parameter
    q_bj     = logit(c_bj) + exp(k_bj) / (c_bj (1 − c_bj)) e_bj    the others

where B_i are smooth bumps that sum to one, base and log d quadratic in the shared coordinates (so
that normal e give the parameter's quantiles, cliffs included), c a polynomial of degree `BEND` in u
of the physical shared parameters and of the blade's parameters before j, clamped smoothly inside
the box, and k quadratic in u of all shared parameters and of those before j: bounded, wherever a
chain goes. The Jacobian is counted exactly, so a bad fit costs gradients, not truth.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from core.calibration.state import RotorState
from core.monomials import multi_indices
from core.smc.particles import normalised
from core.validation.joint import Target
from core.validation.tables import products

Array = NDArray[np.float64]
BEND = 4
SWELL = 2
KNOTS = np.linspace(-1.8, 1.8, 7)  # a node's draws come in groups: further out there are too few
FLAT = 0.2  # of a node's mean slope is the least, where draws are equal
ROUND = 0.25  # of the bumps' shoulders, in units of e
LOG_NORMAL = -0.635  # E log |N(0, 1)|


@dataclass(frozen=True)
class Tubes:
    """The map and a metric for it.

    mean, sd   (S,) moments of the unconstrained shared values
    physical   places of the physical ones among them
    first      (B, I + 1, Q) coefficients of base and of the log d_i
    centre     per further local parameter: (B, M_j) coefficients of c
    edge       per further local parameter: (B,) how far centres stay inside the box
    width      per further local parameter: (B, N_j) coefficients of k
    metric     covariance of the coordinates, local first: NUTS's inverse mass matrix
    """

    mean: Array
    sd: Array
    physical: tuple[int, ...]
    first: Array
    centre: tuple[Array, ...]
    edge: tuple[Array, ...]
    width: tuple[Array, ...]
    metric: Array

    @staticmethod
    def fitted(target: Target, shared: Array, weight: Array, local: Array) -> Tubes:
        """From rough draws on the unit boxes: local (K, m, B, L) at weighted nodes (K, S)."""
        k, m, blades, each = local.shape
        q_s, q_l = (_logit(np.clip(unit, 1e-5, 1 - 1e-5)) for unit in (shared, local))
        mean = weight @ q_s
        sd = np.sqrt(weight @ (q_s - mean) ** 2)
        e_s = (q_s - mean) / sd
        root = np.sqrt(weight)[:, None, None]
        bend = _quadratic(np, e_s)
        levels = np.quantile(q_l[..., 0], norm.cdf(KNOTS), axis=1)  # (I + 1, K, B)
        steps = np.diff(levels, axis=0) / np.diff(KNOTS)[:, None, None]
        steps = np.log(np.maximum(steps, FLAT * steps.mean(axis=0) + 1e-6))
        values = np.concatenate([levels[len(KNOTS) // 2][None], steps]).transpose(1, 0, 2)
        fit = np.linalg.lstsq(bend * root[:, 0], (values * root).reshape(k, -1), rcond=1e-6)[0]
        first = fit.reshape(bend.shape[1], len(KNOTS), blades).transpose(2, 1, 0)
        # all draws together, by the weight of their node
        every = np.repeat(weight / m, m)
        u_s, e_s = np.repeat(shared, m, axis=0), np.repeat(e_s, m, axis=0)
        outer = u_s[:, list(target.inputs)]
        u_l, q_l = local.reshape(k * m, blades, each), q_l.reshape(k * m, blades, each)
        heavy = np.sqrt(every)[:, None]
        e_l, centre, edge, width = np.empty_like(q_l), [], [], []
        for b in range(blades):
            e_l[:, b, 0] = norm.ppf((rank_within(q_l[:, b, 0].reshape(k, m)) + 0.5) / m).ravel()
        for j in range(1, each):
            c, w, near = [], [], []
            for b in range(blades):
                before = u_l[:, b, :j]
                basis = _powers(np, np.concatenate([outer, before], axis=1), BEND)
                swell = _powers(np, np.concatenate([u_s, before], axis=1), SWELL)
                c.append(np.linalg.lstsq(basis * heavy, u_l[:, b, j] * heavy[:, 0], rcond=1e-6)[0])
                miss = u_l[:, b, j] - basis @ c[-1]
                near.append(float(np.clip(np.sqrt(every @ miss**2), 1e-4, 0.2)))
                q, slope = _inside(np, basis @ c[-1], near[-1])
                left = (q_l[:, b, j] - q) / slope
                log_left = np.log(np.abs(left) + 1e-6) - LOG_NORMAL
                w.append(np.linalg.lstsq(swell * heavy, log_left * heavy[:, 0], rcond=1e-6)[0])
                e_l[:, b, j] = left * np.exp(-swell @ w[-1])
            centre.append(np.array(c))
            edge.append(np.array(near))
            width.append(np.array(w))
        # numpyro lays coordinates out by their names in order: local, then shared
        flat = np.clip(np.concatenate([e_l.reshape(k * m, -1), e_s], axis=1), -4, 4)
        cov = np.cov(flat.T, aweights=every)
        metric = 0.95 * cov + 0.05 * np.diag(np.diag(cov))
        return Tubes(
            mean, sd, target.inputs, first, tuple(centre), tuple(edge), tuple(width), metric
        )

    def straight(self, jnp: Any, e: Mapping[str, Any]) -> tuple[Any, Any, Any]:
        """Coordinates e → unconstrained (q_shared, q_local), and each blade's log Jacobian (B,).

        e   {"shared": (S,), "local": (B, L)}; the shared part's log Jacobian is Σ log sd
        """
        q_s = self.mean + self.sd * e["shared"]
        many = e["local"].shape[0]
        u_s = jnp.broadcast_to(_unit(jnp, q_s), (many, len(self.mean)))
        outer = u_s[:, list(self.physical)]
        shape = self.first @ _quadratic(jnp, e["shared"][None])[0]
        slopes = jnp.exp(shape[:, 1:])
        bump, integral = _bumps(jnp, e["local"][:, 0])
        found = [shape[:, 0] + jnp.sum(slopes * integral, axis=1)]
        log_jacobian = jnp.log(jnp.sum(slopes * bump, axis=1))
        parts = zip(self.centre, self.edge, self.width, strict=True)
        for j, (centre, edge, width) in enumerate(parts, 1):
            before = [_unit(jnp, q)[:, None] for q in found]
            basis = _powers(jnp, jnp.concatenate([outer, *before], axis=-1), BEND)
            swell = _powers(jnp, jnp.concatenate([u_s, *before], axis=-1), SWELL)
            q, slope = _inside(jnp, jnp.sum(basis * centre, axis=-1), edge)
            k = jnp.sum(swell * width, axis=-1)
            found.append(q + slope * jnp.exp(k) * e["local"][:, j])
            log_jacobian += k + jnp.log(slope)
        return q_s, jnp.stack(found, axis=-1), log_jacobian


def rough_draws(
    target: Target, state: RotorState, rng: np.random.Generator, per_node: int = 1000
) -> tuple[Array, Array, Array]:
    """A state of ours on the unit boxes for `Tubes.fitted`: (K, S), (K,), (K, m, B, L)."""
    x = [state.arrays["shared/x"]]
    for blade in target.blades:
        local, log_w = (state.arrays[f"blade/{blade}/{part}"] for part in ("local", "log_w"))
        place = [rng.choice(len(w), per_node, p=normalised(w)) for w in log_w]
        x.append(np.stack([one[at] for one, at in zip(local, place, strict=True)]))
    s = len(target.shared)
    shared = np.where(target.logarithmic[:s], np.log(np.maximum(x[0], 1e-300)), x[0])
    size = target.high - target.low
    return (
        (shared - target.low[:s]) / size[:s],
        normalised(state.arrays["shared/log_w"]),
        (np.stack(x[1:], axis=2) - target.low[s:]) / size[s:],
    )


def rank_within(x: Array) -> Array:
    """Ranks 0 … m − 1 along the last axis."""
    return np.asarray(np.argsort(np.argsort(x, axis=-1), axis=-1), float)


def _bumps(jnp: Any, e: Any) -> tuple[Any, Any]:
    """B_i(e) and their integrals from 0, (n, I) each; the outer ones go on for ever."""
    inner = (e[:, None] - KNOTS[1:-1]) / ROUND
    zero = -KNOTS[1:-1] / ROUND
    step = 0.5 * (1 + jnp.tanh(0.5 * inner))
    ramp = ROUND * (jnp.logaddexp(0.0, inner) - np.logaddexp(0.0, zero))
    one, line = jnp.ones_like(step[:, :1]), e[:, None]
    bump = jnp.concatenate([one, step], axis=1) - jnp.concatenate([step, 0 * one], axis=1)
    integral = jnp.concatenate([line, ramp], axis=1) - jnp.concatenate([ramp, 0 * one], axis=1)
    return bump, integral


def _quadratic(jnp: Any, e: Any) -> Any:
    """1, e and the squares of e, clipped softly to ±3: (n, S) → (n, 1 + 2 S)."""
    soft = 3 * jnp.tanh(e / 3)
    return jnp.concatenate([jnp.ones_like(e[:, :1]), soft, soft**2], axis=1)


def _logit(unit: Array) -> Array:
    return np.asarray(np.log(unit) - np.log1p(-unit))


def _unit(jnp: Any, q: Any) -> Any:
    return 0.5 * (1 + jnp.tanh(0.5 * q))


def _inside(jnp: Any, c: Any, edge: Any) -> tuple[Any, Any]:
    """logit of a centre, clamped smoothly to edge … 1 − edge, and the logit's slope there."""
    above = edge * jnp.logaddexp(0.0, c / edge - 1)
    beyond = edge * jnp.logaddexp(0.0, (c - 1) / edge + 1)
    u = edge + above - beyond
    return jnp.log(u) - jnp.log1p(-u), 1 / (u * (1 - u))


def _powers(jnp: Any, u: Any, degree: int) -> Any:
    """Monomials of 2 u − 1 up to a total degree along the last axis."""
    return products(jnp, 2 * u - 1, multi_indices(u.shape[-1], degree))
