"""The evidence of a rotor a second time, by importance sampling from NUTS's draws.

    p(D) = ∫ p(s) Π_b ∫ p(l_b) p(D_b | l_b, s) dl_b ds

Shared points come from a multivariate t fitted to the chains in the coordinates they were sampled
in (`core.validation.tubes`); at each, every blade's inner integral is a mean of likelihood over
density of its own points, from a t fitted to the chains, too, following the shared ones linearly.
No quadrature, no node of ours. The error is the standard error between shared points, each of which
has inner points of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp

from core.rng import stream
from core.smc.particles import ess
from core.validation.nuts import Reference, jax_and_numpyro

Array = NDArray[np.float64]
FREEDOM = 5.0


@dataclass(frozen=True, slots=True)
class Evidence:
    """log p(D), its standard error, and the share of effective shared points."""

    value: float
    error: float
    ess_ratio: float


def log_evidence(
    reference: Reference, *, seed: int, points: int = 400, inner: int = 1000
) -> Evidence:
    """The log evidence of a reference's target, `inner` points per blade at each shared point."""
    jax, _ = jax_and_numpyro()
    jnp, target, tubes = jax.numpy, reference.target, reference.tubes
    s, b, each = len(target.shared), len(target.blades), len(target.local)
    flat = reference.coordinates.reshape(-1, b * each + s)
    local, shared = flat[:, :-s].reshape(-1, b, each), flat[:, -s:]
    middle = shared.mean(axis=0)
    rng = stream(seed, "evidence", *target.blades)
    x, log_q = _t(rng, np.cov(shared.T), points)
    # each blade's coordinates given the shared ones: linear, with what that leaves
    slope = np.linalg.lstsq(shared - middle, (local - local.mean(axis=0)).reshape(-1, b * each))[0]
    left = local - local.mean(axis=0) - ((shared - middle) @ slope).reshape(-1, b, each)
    covariances = [np.cov(left[:, i].T) for i in range(b)]

    @jax.jit  # type: ignore[untyped-decorator]
    def at(e_s: Array, e_l: Array, log_inner: Array) -> Any:
        """log p(s, D) at one shared point: e_l (inner, B, L), log_inner (inner, B)."""

        def one(e: Array) -> tuple[Array, Array]:
            q_s, q_l, log_jacobian = tubes.straight(jnp, {"shared": e_s, "local": e})
            u_s, u_l = jax.nn.sigmoid(q_s), jax.nn.sigmoid(q_l)
            log_jacobian += jnp.sum(jax.nn.log_sigmoid(q_l) + jax.nn.log_sigmoid(-q_l), axis=1)
            rest = jnp.sum(jax.nn.log_sigmoid(q_s) + jax.nn.log_sigmoid(-q_s))
            rest += target.log_shared(jnp, u_s)
            return target.log_blades(jnp, u_s, u_l) + log_jacobian, rest

        inside, rest = jax.vmap(one)(e_l)
        means = jax.scipy.special.logsumexp(inside - log_inner, axis=0) - jnp.log(inner)
        return jnp.sum(means) + rest[0]

    log_p = np.empty(points)
    for n in range(points):
        draws = [_t(rng, c, inner) for c in covariances]
        centre = local.mean(axis=0) + (x[n] @ slope).reshape(b, each)
        e_l = centre + np.stack([z for z, _ in draws], axis=1)
        log_inner = np.stack([q for _, q in draws], axis=1)
        log_p[n] = float(at(middle + x[n], e_l, log_inner))
    log_w = log_p - log_q + np.sum(np.log(tubes.sd))
    value = float(logsumexp(log_w) - np.log(points))
    relative = np.exp(log_w - value)
    error = float(relative.std(ddof=1) / np.sqrt(points))
    return Evidence(value, error, ess(log_w) / points)


def _t(rng: np.random.Generator, covariance: Array, n: int) -> tuple[Array, Array]:
    """n draws of a centred multivariate t with scale matrix `covariance`, and log densities."""
    chol = np.linalg.cholesky(np.atleast_2d(covariance))
    d = len(chol)
    z = rng.standard_normal((n, d)) / np.sqrt(rng.chisquare(FREEDOM, (n, 1)) / FREEDOM)
    log_norm = gammaln((FREEDOM + d) / 2) - gammaln(FREEDOM / 2) - 0.5 * d * np.log(FREEDOM * np.pi)
    log_q = log_norm - 0.5 * (FREEDOM + d) * np.log1p((z**2).sum(axis=1) / FREEDOM)
    return z @ chol.T, log_q - np.sum(np.log(np.diag(chol)))
