"""The state that is persisted: a value, versioned by its digest.

A state holds the shared nodes with their weights W_k, one column log m_b(s_k) per blade, and for
each blade its particle set: local values l_ki with weights w_ki that sum to about one at each node
(exactly on average, see `message.BladeMessage.draws`). The
joint particles of a blade are the pairs (l_ki, s_k) with weight W_k w_ki, so a reading of another
blade moves this blade through W alone, and only what changed is written.

Arrays (float64):

    shared/unit (K, d)     nodes on the unit box        shared/log_w (K,)   log weights, normalised
    shared/x    (K, d)     nodes, natural units         shared/log_q (K,)   log placement density
    shared/log_p (K,)      log target at the nodes
    column/<b>  (K,)       log message of blade b       blade/<b>/log_w (K, m)
    blade/<b>/local (K, m, L)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from core.digest import array_digest, state_digest
from core.errors import ModelError
from core.smc.particles import Particles, ess, normalised

Array = NDArray[np.float64]
Get = Callable[[str], Array]
ALGORITHM = "panels-19"
DRAWS = "panels-15"  # since when draws are what they are: those of sound rotors stay
FAMILY, NUMBER = ALGORITHM.rsplit("-", 1)
SUPERSEDED = tuple(f"{FAMILY}-{number}" for number in range(1, int(NUMBER)))


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


class Arrays(Mapping[str, Array]):
    """The arrays of a state by name: its own ones, and below them those of a stored state.

    What lies below is fetched when it is first looked at: an update that touches one blade reads
    and writes what that blade needs, whatever the size of the rotor.
    """

    EMPTY: ClassVar[Arrays]

    def __init__(self, names: Iterable[str], own: Mapping[str, Array], get: Get) -> None:
        self._names = frozenset(names)
        self._found = {n: a for n, a in own.items() if n in self._names}
        self._get = get

    def __getitem__(self, name: str) -> Array:
        if name not in self._found:
            if name not in self._names:
                raise KeyError(name)
            self._found[name] = self._get(name)
        return self._found[name]

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(self._names))

    def __len__(self) -> int:
        return len(self._names)

    @property
    def held(self) -> Mapping[str, Array]:
        """Those that are in memory: its own, and what was fetched so far."""
        return self._found

    def over(self, own: Mapping[str, Array], kept: Iterable[str]) -> Arrays:
        """The arrays of the next state: its `own`, and the `kept` ones of this state."""
        kept = frozenset(kept)
        missing = kept - self._names
        if missing:
            raise KeyError(f"no such arrays in the state before: {sorted(missing)[:5]}")
        return Arrays(kept | own.keys(), {**self._found, **own}, self._get)


def _nothing(name: str) -> Array:
    raise KeyError(name)


Arrays.EMPTY = Arrays((), {}, _nothing)


@dataclass(frozen=True)
class RotorState:
    """One version of a rotor's joint posterior.

    fresh   names of the arrays that the update made; all others are those of the state before it
    """

    meta: Mapping[str, Any]
    arrays: Arrays
    fresh: frozenset[str] = field(default=frozenset(), compare=False)

    @property
    def sealed(self) -> bool:
        """True: a function of the event set alone. False: readable, a sealed one follows."""
        return bool(self.meta["sealed"])

    @property
    def digest(self) -> str:
        """SHA-256 over the description and every array (which loads them all)."""
        return state_digest(self.meta, {n: array_digest(a) for n, a in self.arrays.items()})

    @staticmethod
    def restore(meta: Mapping[str, Any], get: Get) -> RotorState:
        """A stored state; arrays are fetched by name when they are looked at."""
        if meta.get("algorithm_version") != ALGORITHM:
            raise ModelError(
                f"state of algorithm {meta.get('algorithm_version')!r}, expected {ALGORITHM!r}; "
                "rebuild it from the log"
            )
        return RotorState(meta, Arrays(meta["arrays"], {}, get))


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

    Reads four arrays, whatever the size of the rotor. Raises ModelError where the draws do not
    have a value of each local parameter.
    """
    local, log_w = get(f"blade/{blade}/local"), get(f"blade/{blade}/log_w")
    x, shared_log_w = get("shared/x"), get("shared/log_w")
    k, m, dim = local.shape
    if dim != len(meta["local"]):
        raise ModelError(
            f"blade {blade}: draws of {dim} local parameters, the state names "
            f"{len(meta['local'])}: {', '.join(meta['local'])}; rebuild it from the log"
        )
    psi = np.concatenate([local.reshape(k * m, dim), np.repeat(x, m, axis=0)], axis=1)
    weights = (shared_log_w[:, None] + log_w).reshape(k * m)
    return Posterior((*meta["local"], *meta["shared"]), Particles(psi, weights))


def health(log_w: Array, message_error: float, message_tilt: float) -> dict[str, float | int]:
    """How well the shared nodes carry the posterior.

    ess, ess_ratio   of the K shared nodes
    mc_error_sd      Monte-Carlo error of a shared mean in posterior standard deviations, if the
                     nodes were independent (they are better spread than that)
    message_error_nat, message_tilt_nat   error of log p at a node, which the evidence has, and of
                     its differences between nodes, which is all that the posterior feels
    """
    size = ess(log_w)
    return {
        "nodes": len(log_w),
        "ess": round(size, 3),
        "ess_ratio": round(size / len(log_w), 4),
        "mc_error_sd": round(float(1 / np.sqrt(size)), 4),
        "largest_weight": round(float(normalised(log_w).max()), 4),
        "message_error_nat": round(message_error, 5),
        "message_tilt_nat": round(message_tilt, 5),
    }
