"""Reference posteriors by NUTS: the joint target of a rotor, sampled by an independent method.

The target (`core.validation.joint`) in float64, on the line by u = sigmoid(q) with the exact
Jacobian, in the coordinates of `core.validation.tubes`; all parameters of all blades at once by the
No-U-Turn Sampler (Hoffman & Gelman 2014) of numpyro with a dense mass matrix. Needs the extra
``reference`` (numpyro and jax), which nothing else does. The coordinates and the mass matrix are
fitted to our own posterior's draws, which the chains are free to leave. They start from independent
normal coordinates, about as wide as the posterior: from twice as wide some chains never came back.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.errors import CalibrationError, ModelError
from core.rng import seed_of
from core.validation.joint import Target
from core.validation.tubes import Tubes

Array = NDArray[np.float64]


def jax_and_numpyro() -> tuple[ModuleType, ModuleType]:
    """jax and numpyro in float64; raises ModelError that names the extra."""
    try:
        import jax
        import numpyro
    except ImportError as error:
        raise ModelError(
            f"{error.name} is not installed: reference posteriors need the extra 'reference'; "
            "run: pip install 'bladetwin[reference]'"
        ) from error
    numpyro.enable_x64()
    return jax, numpyro


def potential(target: Target, tubes: Tubes, jax: ModuleType) -> Any:
    """−log p of the coordinates {"shared": (S,), "local": (B, L)}; but for a constant."""

    def value(e: Mapping[str, Any]) -> Any:
        *q, log_jacobian = tubes.straight(jax.numpy, e)
        total = target.log_joint(jax.numpy, *(jax.nn.sigmoid(part) for part in q))
        for part in q:
            total += jax.numpy.sum(jax.nn.log_sigmoid(part) + jax.nn.log_sigmoid(-part))
        return -total - jax.numpy.sum(log_jacobian)

    return value


@dataclass(frozen=True)
class Reference:
    """Draws of a rotor's posterior by NUTS.

    shared (C, N, S), local (C, N, B, L): C chains of N draws in natural units; coordinates
    (C, N, B·L + S) as sampled, local first; `report` holds the seed, settings, versions,
    divergences, gradient evaluations and seconds.
    """

    target: Target
    tubes: Tubes
    shared: Array
    local: Array
    coordinates: Array
    report: Mapping[str, Any]

    def blade(self, blade: str) -> Array:
        """Joint draws of one blade: local, then shared parameters, (C, N, L + S)."""
        own = self.local[:, :, self.target.blades.index(blade)]
        return np.concatenate([own, self.shared], axis=2)


def sample(
    target: Target,
    *,
    seed: int,
    tubes: Tubes,
    chains: int = 32,
    warmup: int = 200,
    draws: int = 1000,
    target_accept: float = 0.85,
    depth: int = 8,
) -> Reference:
    """Chains of NUTS; one process, chains side by side.

    The mass matrix is that of `tubes`; the warm-up finds the step size. `depth`: a tree doubles at
    most so often.
    Raises ModelError without the extra, CalibrationError where a chain is not a number.
    """
    jax, numpyro = jax_and_numpyro()
    begin, run = jax.random.split(jax.random.PRNGKey(seed_of(seed, "nuts", *target.blades) % 2**63))
    s, many, each = len(target.shared), len(target.blades), len(target.local)
    e = np.asarray(jax.random.normal(begin, (chains, s + many * each)))
    kernel = numpyro.infer.NUTS(
        potential_fn=potential(target, tubes, jax),
        target_accept_prob=target_accept,
        max_tree_depth=depth,
        dense_mass=True,
        inverse_mass_matrix=jax.numpy.asarray(tubes.metric),
        adapt_mass_matrix=False,
    )
    mcmc = numpyro.infer.MCMC(
        kernel,
        num_warmup=warmup,
        num_samples=draws,
        num_chains=chains,
        chain_method="vectorized",
        progress_bar=False,
    )
    wall, cpu = time.monotonic(), time.process_time()
    start = {"local": e[:, s:].reshape(chains, many, each), "shared": e[:, :s]}
    mcmc.run(run, init_params=start, extra_fields=("num_steps", "diverging"))
    found = mcmc.get_samples(group_by_chain=True)
    extra = mcmc.get_extra_fields(group_by_chain=True)
    q = jax.vmap(jax.vmap(lambda at: tubes.straight(jax.numpy, at)[:2]))(found)
    shared, local = (np.asarray(jax.nn.sigmoid(part)) for part in q)
    if not (np.isfinite(shared).all() and np.isfinite(local).all()):
        raise CalibrationError("a chain of NUTS left the numbers; look at the readings")
    steps = np.asarray(extra["num_steps"])
    report = {
        "seed": seed,
        "chains": chains,
        "warmup": warmup,
        "draws": draws,
        "target_accept": target_accept,
        "divergences": int(np.sum(extra["diverging"])),
        "gradients_per_draw": round(float(steps.mean()), 1),
        "trees_at_their_limit": round(float(np.mean(steps >= 2**depth - 1)), 4),
        "seconds": round(time.monotonic() - wall, 2),
        "cpu_seconds": round(time.process_time() - cpu, 2),
        "versions": {name: version(name) for name in ("numpyro", "jax", "numpy")},
    }
    flat = np.asarray(found["local"]).reshape(chains, draws, -1)
    coordinates = np.concatenate([flat, np.asarray(found["shared"])], axis=2)
    natural = target.natural(shared, 0), target.natural(local, s)
    return Reference(target, tubes, *natural, coordinates, report)
