"""Steps 3 and 4 of the paper's example: few blades go on from the posterior of all (`paper`).

The posterior of step 2 as if these blades were silent is the prior of the shared parameters, at
their readings of both kinds. Its log density is known exactly at step 2's nodes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.calibration.draws import SHARE
from core.calibration.lead import start_of
from core.calibration.message import BladeMessage
from core.calibration.space import SharedSpace, locals_of, shared_space
from core.calibration.state import Arrays, Posterior, RotorSpec, RotorState
from core.calibration.stored import StoredPosterior
from core.calibration.target import assemble
from core.calibration.workspace import message_of
from core.model import Model
from core.observation import Inspection
from core.rng import seed_of, stream
from core.smc.particles import Particles, ess, log_sum_exp
from core.smc.placement import descend, pooled, sobol
from core.smc.proposal import Proposal

Array = NDArray[np.float64]
LEVELS = {"multi": "elongation", "scanned": "deformation", "destroyed": "ceeq"}
SHARED_ARRAYS = ("shared/unit", "shared/x", "shared/log_q")
ROUND, NODES = 256, 512  # nodes of a round of the placement, and in the end
EFFECTIVE, DOUBT = 150.0, 0.5  # of these, and nat of the prior's surface, that are enough


def without(model: Model, state: RotorState, silent: Iterable[str]) -> StoredPosterior:
    """The posterior of a sealed state as if some blades had no reading, as a prior."""
    arrays, silent = state.arrays, frozenset(silent)
    log_p = arrays["shared/log_p"].copy()
    for blade in sorted(silent & state.meta["readings"].keys()):
        log_p -= arrays[f"column/{blade}"]
    log_w = log_p - arrays["shared/log_q"]
    own = {name: arrays[name] for name in SHARED_ARRAYS}
    own |= {"shared/log_p": log_p, "shared/log_w": log_w - log_sum_exp(log_w)}
    meta = {
        **state.meta,
        "readings": {b: d for b, d in state.meta["readings"].items() if b not in silent},
        "log_evidence": log_sum_exp(log_w) - float(np.log(len(log_w))),
    }
    return StoredPosterior.of(model, RotorState(meta, Arrays(own, own, own.__getitem__)))


@dataclass(frozen=True)
class Above:
    """Posteriors of the blades of a step that goes on from step 2, local and shared parameters.

    health   nodes, their effective number, error of the prior's surface [nat]
    """

    posterior: Mapping[str, Posterior]
    health: Mapping[str, Any]


def above(
    model: Model, rotor: RotorSpec, state: RotorState, readings: Sequence[Inspection], level: str
) -> Above:
    """Step 3 (``scanned``) or 4 (``destroyed``) on a state of step 2.

    Few blades and up to seven shared parameters: nodes are many and messages exact
    (`placement.pooled`), so that standard deviations are known to 2 %. `online.update` on the same
    prior places a quarter as many, of which a normal in seven dimensions leaves a third at most.
    """
    own = {r.blade for r in readings if r.quantity == LEVELS[level]}
    prior = without(model, state, own)
    rows = {}
    for blade in sorted(own):
        both = (LEVELS["multi"], LEVELS[level])
        made = assemble(model, [r for r in readings if r.blade == blade and r.quantity in both])
        assert made is not None
        rows[blade] = made
    space = shared_space(model, rows.values(), prior)
    messages = {b: message_of(model, r, space, {}) for b, r in rows.items()}

    def columns(unit: Array) -> dict[str, Array]:
        return {b: m.column(unit) for b, m in messages.items()}

    def target(unit: Array) -> Array:
        return np.asarray(space.log_prior(unit) + sum(columns(unit).values()))

    d, seed = space.dim, seed_of(rotor.seed, rotor.id, level, "nodes") % 2**63
    scouts = 32 if d <= 4 else 128
    begin = descend(target, _start(space, prior, messages), sobol(scouts, d, seed))
    place = pooled(target, begin, sobol(ROUND, d, seed), ROUND)
    unit, log_q = place.nodes(sobol(NODES, d, seed))
    said = columns(unit)
    log_w = space.log_prior(unit) + sum(said.values()) - log_q
    size = ess(log_w)
    shared, per_node = space.to_x(unit), SHARE * -(-rotor.particles // (SHARE * NODES))
    posterior = {}
    for blade, message in messages.items():
        rng = stream(rotor.seed, rotor.id, level, message.digest)
        local, own_w = message.draws(unit, per_node, rng, said[blade])
        psi = np.concatenate(
            [local.reshape(-1, local.shape[2]), np.repeat(shared, per_node, axis=0)], axis=1
        )
        names = (*(p.name for p in locals_of(model)), *space.names)
        posterior[blade] = Posterior(names, Particles(psi, (log_w[:, None] + own_w).ravel()))
    return Above(
        posterior,
        {
            "nodes": NODES,
            "ess": round(size, 1),
            "ess_ratio": round(size / NODES, 4),
            "prior_nat": round(prior.error_nat, 5),
            "status": "ok" if size >= EFFECTIVE and prior.error_nat < DOUBT else "degenerate",
        },
    )


def _start(
    space: SharedSpace, prior: StoredPosterior, messages: Mapping[str, BladeMessage]
) -> Proposal:
    """The prior's moments for what it passes on, `lead.start_of` for the rest."""
    begin = start_of(space, messages)
    assert begin.chol is not None
    mean, covariance = begin.mean.copy(), begin.chol @ begin.chol.T
    at = [space.names.index(n) for n in prior.names]
    mean[at], covariance[np.ix_(at, at)] = prior.moments
    return Proposal(mean, np.asarray(np.linalg.cholesky(covariance), float), space.heavy)
