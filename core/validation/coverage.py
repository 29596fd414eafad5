"""Simulated rotors: does a 95 % interval hold the truth 95 times in a hundred?

Each rotor is drawn from the network's own priors (every local and shared parameter, the noise as
well), its readings from the model plus noise, and calibrated; what counts is where the truth falls
in the posterior. With the prior as the source of truths, the probability integral transform of the
truth in its posterior is uniform if, and only if, the calibration is right (Cook, Gelman & Rubin
2006; Talts et al. 2018). No rotor is dropped. `exaggerate` scales the posterior's spread: the
negative control, which must fail.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.calibration.online import update
from core.calibration.state import RotorSpec, blade_posterior, shared_posterior
from core.model import Model
from core.network import Prior
from core.observation import Inspection
from core.prediction import predict
from core.rng import stream
from core.smc.particles import normalised

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Study:
    """PIT values of the truths by name, of all rotors; `ess_ratio` of each rotor."""

    pit: dict[str, Array]
    ess_ratio: Array

    def share(self, name: str, probability: float) -> float:
        """Share of truths inside the central interval of this probability."""
        tail = (1 - probability) / 2
        u = self.pit[name]
        return float(np.mean((u >= tail) & (u <= 1 - tail)))

    def spread(self, name: str, probability: float) -> float:
        """Binomial standard error of `share` at its nominal value."""
        return float(np.sqrt(probability * (1 - probability) / len(self.pit[name])))


def simulate(
    model: Model, rotor: int, blades: int, times: Sequence[float], seed: int, quantity: str
) -> tuple[dict[str, float], dict[str, dict[str, float]], list[Inspection], Array]:
    """A rotor from the priors: shared truth, local truths, readings, and held-out clean values."""
    rng = stream(seed, "simulated", rotor)
    network = model.network
    declared = network.quantity(quantity)

    def drawn(prior: Prior) -> float:
        return float(prior.quantile(rng.random(1))[0])

    shared = {p.name: drawn(p.prior) for p in network.of_level("shared")}
    shared[declared.sigma_name] = drawn(declared.sigma_obs)
    local = {
        f"B{b:03d}": {p.name: drawn(p.prior) for p in network.of_level("local")}
        for b in range(blades)
    }
    x = np.array([[{**shared, **v}[name] for name in model.input_names] for v in local.values()])
    clean, _ = model.surrogate.predict(x, quantity, np.array([*times]))
    noise = shared[declared.sigma_name] * rng.standard_normal(clean.shape)
    values = clean * (1 + declared.numerical * rng.standard_normal(clean.shape)) + noise
    readings = [
        Inspection(f"{blade}-{i}", blade, quantity, float(t), np.array([values[b, i]]))
        for b, blade in enumerate(local)
        for i, t in enumerate(times[:-1])
    ]
    return shared, local, readings, values[:, -1]


def pit(values: Array, w: Array, truth: float, exaggerate: float = 1.0) -> float:
    """Posterior probability below the truth."""
    mean = float(w @ values)
    return float(w @ (mean + exaggerate * (values - mean) < truth))


def run(
    model: Model,
    *,
    rotors: int,
    blades: int,
    times: Sequence[float],
    seed: int,
    quantity: str = "elongation",
    particles: int = 2000,
    exaggerate: float = 1.0,
    progress: Callable[[int, int], None] | None = None,
) -> Study:
    """Simulate and calibrate `rotors` rotors; the last of `times` is held out."""
    found: dict[str, list[float]] = {}
    ratios = []
    for r in range(rotors):
        shared, local, readings, held = simulate(model, r, blades, times, seed, quantity)
        spec = RotorSpec(f"simulated-{r}", tuple(local), particles, seed)
        state = update(model, spec, readings)
        ratios.append(state.meta["health"]["ess_ratio"])
        get = state.arrays.__getitem__
        posterior = shared_posterior(state.meta, get)
        for name, truth in shared.items():
            u = pit(posterior.column(name), posterior.particles.w, truth, exaggerate)
            found.setdefault(name, []).append(u)
        for b, (blade, values) in enumerate(local.items()):
            one = blade_posterior(state.meta, get, blade)
            w = normalised(one.particles.log_w)
            for name, truth in values.items():
                found.setdefault(name, []).append(pit(one.column(name), w, truth, exaggerate))
            band = predict(model, one, quantity, [times[-1]])
            inside = band.quantiles
            levels = np.array(sorted(inside))
            at = np.array([inside[float(p)][0] for p in levels])
            u = np.interp(held[b], at, levels, left=0.0, right=1.0)
            found.setdefault("held-out reading", []).append(float(u))
        if progress is not None:
            progress(r + 1, rotors)
    return Study({k: np.array(v) for k, v in found.items()}, np.array(ratios))
