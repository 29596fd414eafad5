"""Monte-Carlo error between seeds: the same readings, other nodes and other draws.

Every published mean is computed with several seeds; its standard deviation between them, in
posterior standard deviations, is what a user's figure owes to chance. A rotor's own estimate from
one seed (`core.calibration.state.health`) takes the shared nodes for independent; they are better
spread than that.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.calibration.online import Workspace, update
from core.calibration.state import RotorSpec, blade_posterior, shared_posterior
from core.errors import InputError
from core.model import Model
from core.prediction import predict
from core.validation.simulate import Variant, simulate

Array = NDArray[np.float64]
LIMIT = 0.1


def spread(
    model: Model,
    variant: Variant,
    *,
    rotor: int,
    seed: int,
    seeds: int,
    particles: int = 10_000,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Standard deviation between `seeds` seeds of each published mean, in posterior sd.

    Means of the shared parameters, of every blade's local ones, and of the predicted elongation of
    every blade at the held-out hour and at the model's last (in sd of the parameters' part). By
    name: the number of means, the largest spread and the root mean square.
    """
    if seeds < 2:
        raise InputError("seeds", seeds, "show no spread", "give eight or more")
    made = simulate(model, variant, rotor, seed)
    work = Workspace()
    found: dict[str, list[tuple[Array, Array]]] = {}
    horizon = model.surrogate.horizon_h
    for number in range(seeds):
        spec = RotorSpec("seeds", tuple(made.local), particles, number)
        state = update(model, spec, made.readings, workspace=work)
        get = state.arrays.__getitem__
        shared = shared_posterior(state.meta, get)
        one: dict[str, list[tuple[float, float]]] = {}
        sd = np.sqrt(np.diag(shared.particles.covariance))
        for name, mean, width in zip(shared.names, shared.particles.mean, sd, strict=True):
            one[name] = [(mean, width)]
        for blade in made.local:
            posterior = blade_posterior(state.meta, get, blade)
            particles_of = posterior.particles
            sd = np.sqrt(np.diag(particles_of.covariance))
            for name in state.meta["local"]:
                i = posterior.names.index(name)
                one.setdefault(name, []).append((particles_of.mean[i], sd[i]))
            band = predict(model, posterior, "elongation", [variant.held_out_h, horizon])
            for k, when in enumerate(("held-out hour", "horizon")):
                pair = float(band.mean[k]), float(band.sd["parameters"][k])
                one.setdefault(f"elongation at the {when}", []).append(pair)
        for name, pairs in one.items():
            mean, width = np.array(pairs).T
            found.setdefault(name, []).append((mean, width))
        if progress is not None:
            progress(number + 1, seeds)
    table: dict[str, Any] = {}
    for name, both in found.items():
        means, widths = np.array(both).transpose(1, 0, 2)  # (seeds, number of means) each
        ratio = means.std(axis=0, ddof=1) / widths.mean(axis=0)
        table[name] = {
            "means": ratio.size,
            "largest": round(float(ratio.max()), 4),
            "rms": round(float(np.sqrt(np.mean(ratio**2))), 4),
        }
    return {
        "limit": LIMIT,
        "passed": all(row["largest"] < LIMIT for row in table.values()),
        "table": table,
    }
