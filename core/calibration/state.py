"""The state that is persisted: a value, versioned by its digest.

A state holds the shared nodes with their weights W_k, one column log m_b(s_k) per blade, and for
each blade its particle set: local values l_ki with weights w_ki that sum to about one at each node
(exactly on average, see `message.BladeMessage.draws`). The
joint particles of a blade are the pairs (l_ki, s_k) with weight W_k w_ki, so a reading of another
blade moves this blade through W alone, and only what changed is written.

Arrays (float64):

    shared/unit (K, d)     nodes on the unit box        shared/log_w (K,)   log weights, normalised
    shared/x    (K, d)     nodes, natural units         shared/log_q (K,)   log placement density
    column/<b>  (K,)       log message of blade b       blade/<b>/log_w (K, m)
    blade/<b>/local (K, m, L)
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.errors import ModelError
from core.smc.particles import Particles, ess, normalised

Array = NDArray[np.float64]
Get = Callable[[str], Array]
ALGORITHM = "panels-1"


@dataclass(frozen=True, slots=True)
class RotorSpec:
    """What an update needs to know of a rotor.

    particles  weighted draws per blade, at least; rounded up to whole groups at each shared node
    known      values of known parameters per blade
    """

    id: str
    blades: tuple[str, ...]
    particles: int = 10_000
    seed: int = 0
    known: Mapping[str, Mapping[str, float]] | None = None


@dataclass(frozen=True)
class RotorState:
    """One version of a rotor's joint posterior."""

    meta: Mapping[str, Any]
    arrays: Mapping[str, Array]

    @property
    def sealed(self) -> bool:
        """True: a function of the event set alone. False: readable, a sealed one follows."""
        return bool(self.meta["sealed"])

    @property
    def digest(self) -> str:
        """SHA-256 over the description and every array."""
        made = sha256(json.dumps(dict(self.meta), sort_keys=True).encode())
        for name in sorted(self.arrays):
            made.update(name.encode() + np.ascontiguousarray(self.arrays[name]).tobytes())
        return made.hexdigest()

    @staticmethod
    def restore(meta: Mapping[str, Any], get: Get) -> RotorState:
        """A stored state; arrays are fetched by name."""
        if meta.get("algorithm_version") != ALGORITHM:
            raise ModelError(
                f"state of algorithm {meta.get('algorithm_version')!r}, expected {ALGORITHM!r}; "
                "rebuild it from the log"
            )
        return RotorState(meta, {name: get(name) for name in meta["arrays"]})


@dataclass(frozen=True, slots=True)
class Posterior:
    """Weighted particles with names; psi (N, P) in natural units."""

    names: tuple[str, ...]
    particles: Particles

    def column(self, name: str) -> Array:
        return np.asarray(self.particles.psi[:, self.names.index(name)])


def shared_posterior(meta: Mapping[str, Any], get: Get) -> Posterior:
    """Posterior of the shared parameters, K particles."""
    return Posterior(tuple(meta["shared"]), Particles(get("shared/x"), get("shared/log_w")))


def blade_posterior(meta: Mapping[str, Any], get: Get, blade: str) -> Posterior:
    """Joint posterior of one blade's local parameters and the shared ones, K·m particles.

    Reads four arrays, whatever the size of the rotor.
    """
    local, log_w = get(f"blade/{blade}/local"), get(f"blade/{blade}/log_w")
    x, shared_log_w = get("shared/x"), get("shared/log_w")
    k, m, dim = local.shape
    psi = np.concatenate([local.reshape(k * m, dim), np.repeat(x, m, axis=0)], axis=1)
    weights = (shared_log_w[:, None] + log_w).reshape(k * m)
    return Posterior((*meta["local"], *meta["shared"]), Particles(psi, weights))


def health(log_w: Array, message_error: float) -> dict[str, float | int]:
    """How well the shared nodes carry the posterior.

    ess, ess_ratio   of the K shared nodes
    mc_error_sd      Monte-Carlo error of a shared mean in posterior standard deviations, if the
                     nodes were independent (they are better spread than that)
    """
    size = ess(log_w)
    return {
        "nodes": len(log_w),
        "ess": round(size, 3),
        "ess_ratio": round(size / len(log_w), 4),
        "mc_error_sd": round(float(1 / np.sqrt(size)), 4),
        "largest_weight": round(float(normalised(log_w).max()), 4),
        "message_error_nat": round(message_error, 5),
    }
