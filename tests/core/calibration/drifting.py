"""Y_m = 3 + s t + l (0.5 + t), s shared, l local, and readings that it misses in a known way."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from core.model import Model
from core.network import Discrepancy, Network, Parameter, Quantity
from core.observation import Inspection
from core.prior import Prior
from core.surrogate.formula import FormulaInput, FormulaModel

S = Prior("normal", 1.4, 2.6, 2.0, 0.2)
LOCAL_SD = 0.1
KINDS = {
    "constant": Discrepancy("constant", sd=0.3),
    "paper": Discrepancy("paper", sd=0.04),
    "gp": Discrepancy("gp", sd=0.05, length_h=2.0),
}
HORIZON = 2.0
Wrong = Callable[[np.ndarray, float], np.ndarray]


def physics(x: np.ndarray, t: float) -> np.ndarray:
    return np.asarray(3 + x[:, 0] * t + x[:, 1] * (0.5 + t))


def drifting(
    discrepancy: Discrepancy, numerical: float = 0.0, by_instrument: bool = False
) -> Model:
    parameters = (
        Parameter("s", "shared", S),
        Parameter("l", "local", Prior.gaussian(0.0, LOCAL_SD)),
    )
    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in parameters)
    noise = Prior("log_uniform", 5e-3, 0.5)
    quantities = tuple(
        Quantity(
            name,
            "mm",
            "scalar",
            noise,
            -50.0,
            50.0,
            numerical=numerical,
            discrepancy=discrepancy,
            by_instrument=by_instrument,
        )
        for name in ("y", "z")
    )
    return Model(
        Network("drifting", parameters, quantities),
        FormulaModel(inputs, {"y": physics, "z": physics}, "drifting", HORIZON),
    )


def measured(
    wrong: Wrong,
    seed: int,
    *,
    s: float = 2.1,
    blades: int = 8,
    times: Sequence[float] = (0.0, 0.5, 1.0, 1.5),
    noise: float = 0.02,
    told: float | None = None,
) -> list[Inspection]:
    """Readings Y_m + wrong(Y_m, t) + noise; `told`: the noise that the readings name."""
    rng = np.random.default_rng(seed)
    out = []
    for b in range(blades):
        x = np.array([[s, LOCAL_SD * rng.standard_normal()]])
        for i, t in enumerate(times):
            clean = physics(x, t)
            value = clean + wrong(clean, t) + noise * rng.standard_normal(1)
            out.append(Inspection(f"r{b}-{i}", f"b{b}", "y", t, value, sigma=told))
    return out
