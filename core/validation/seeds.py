"""Monte-Carlo error between seeds: the same readings, other nodes and other draws.

Every published mean is computed with several seeds; its standard deviation between them, in
posterior standard deviations, is what a user's figure owes to chance. A rotor's own estimate from
one seed (`core.calibration.state.health`) takes the shared nodes for independent; they are better
spread than that.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.calibration.online import Workspace, update
from core.calibration.state import (
    Posterior,
    RotorSpec,
    RotorState,
    blade_posterior,
    shared_posterior,
)
from core.errors import InputError
from core.model import Model
from core.prediction import predict
from core.validation.simulate import simulate
from core.validation.variants import Variant

Array = NDArray[np.float64]
LIMIT = 0.1


Pairs = list[tuple[float, float]]


def spread(
    model: Model,
    variant: Variant,
    *,
    rotors: int,
    seed: int,
    seeds: int,
    particles: int = 10_000,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Standard deviation between `seeds` seeds of each published mean, in posterior sd.

    Means of the shared parameters, of every blade's local ones, and of predicted elongation and
    CEEQ of every blade at the held-out hour and at the model's last (in sd of the parameters'
    part), of simulated rotors 0 … `rotors` − 1. By name: the number of means, the largest spread
    and the root mean square.
    """
    if seeds < 2 or rotors < 1:
        raise InputError("seeds, rotors", (seeds, rotors), "show no spread", "give 8 and 1 or more")
    found: dict[str, list[Array]] = {}
    for rotor in range(rotors):
        made, work = simulate(model, variant, rotor, seed), Workspace()
        means: dict[str, list[Pairs]] = {}
        for number in range(seeds):
            spec = RotorSpec("seeds", tuple(made.local), particles, number)
            state = update(model, spec, made.readings, workspace=work)
            for name, pairs in _published(model, variant, state).items():
                means.setdefault(name, []).append(pairs)
            if progress is not None:
                progress(rotor * seeds + number + 1, rotors * seeds)
        for name, runs in means.items():
            mean, sd = np.array(runs).transpose(2, 0, 1)  # (seeds, number of means) each
            found.setdefault(name, []).append(mean.std(axis=0, ddof=1) / sd.mean(axis=0))
    table: dict[str, Any] = {}
    for name, parts in found.items():
        ratio = np.concatenate(parts)
        table[name] = {
            "means": ratio.size,
            "largest": round(float(ratio.max()), 4),
            "rms": round(float(np.sqrt(np.mean(ratio**2))), 4),
        }
    passed = all(row["largest"] < LIMIT for row in table.values())
    return {"limit": LIMIT, "passed": passed, "table": table}


def _published(model: Model, variant: Variant, state: RotorState) -> dict[str, Pairs]:
    """Every (mean, sd) that a user can ask of a state, by name."""
    get = state.arrays.__getitem__
    out: dict[str, Pairs] = {}

    def add(posterior: Posterior, names: Sequence[str]) -> None:
        mean, sd = posterior.particles.mean, np.sqrt(np.diag(posterior.particles.covariance))
        for name in names:
            i = posterior.names.index(name)
            out.setdefault(name, []).append((float(mean[i]), float(sd[i])))

    add(shared_posterior(state.meta, get), state.meta["shared"])
    for blade in state.meta["blades"]:
        posterior = blade_posterior(state.meta, get, blade)
        add(posterior, state.meta["local"])
        times = [variant.held_out_h, model.surrogate.horizon_h]
        for quantity in ("elongation", "ceeq"):
            band = predict(model, posterior, quantity, times)
            rows = zip(times, band.mean, band.sd["parameters"], strict=True)
            for time_h, mean, sd in rows:
                name = f"{quantity} at {time_h:g} h"
                out.setdefault(name, []).append((float(mean), float(sd)))
    return out
