"""A crept bar by formula: three local parameters, one shared, one quantity with unknown noise."""

from __future__ import annotations

import numpy as np

from core.model import Model
from core.network import Network, Parameter, Quantity
from core.observation import Inspection
from core.prior import Prior
from core.surrogate.formula import FormulaInput, FormulaModel

LOCAL = (("tbc", 2 / 3, 4 / 3), ("alpha", -3.0, 3.0), ("gamma", -3.0, 3.0))


def creep(x: np.ndarray, t: float) -> np.ndarray:
    """Primary + secondary creep of a bar at a metal temperature set by rate and coating [mm]."""
    tbc, rate, alpha, gamma = x.T
    kelvin = 300 * (rate - 0.9) - 66 * (tbc - 1)
    steady = 1.4e-8 * np.exp(0.033 * kelvin)
    primary = 1e-3 * np.exp(0.35 * alpha) * (1 - np.exp(-t * steady / 2e-4))
    return np.asarray(180 * (0.6 * primary + steady * np.exp(0.35 * gamma) * t))


def bar() -> Model:
    shared = Parameter("rate", "shared", Prior("uniform", 0.8, 1.0))
    local = [Parameter(n, "local", Prior("uniform", a, b)) for n, a, b in LOCAL]
    order = (local[0], shared, local[1], local[2])
    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in order)
    quantity = Quantity("y", "mm", "scalar", Prior("log_uniform", 1e-3, 0.2), -5.0, 50.0)
    return Model(
        Network("bar", order, (quantity,)),
        FormulaModel(inputs, {"y": creep}, "bar", positive=("y",)),
    )


def measured(
    blades: int, times: tuple[float, ...], seed: int, sd: float = 0.004
) -> list[Inspection]:
    """Readings of one rotor drawn from the priors at rate 0.92; `seed` is that of the noise."""
    rng, noise = np.random.default_rng(0), np.random.default_rng([1, seed])
    out = []
    for b in range(blades):
        local = [rng.uniform(low, high) for _, low, high in LOCAL]
        x = np.array([[local[0], 0.92, *local[1:]]])
        out += [
            Inspection(f"b{b}t{t:g}", f"b{b}", "y", t, creep(x, t) + sd * noise.standard_normal(1))
            for t in times
        ]
    return out
