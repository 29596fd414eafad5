"""A network with six local parameters, by formula: a blade that creeps in three stages.

    y = e + a (1 − exp(−t / tau)) + g t + q t³ [mm],

with an elastic offset e, a transient of amplitude a and time tau, a steady rate g and a tertiary
term q, each scattered from blade to blade, and all rates raised by the metal temperature, which
the rotor's firing rate and the blade's coating set. No simulation stands behind it: it is there to
check what many local parameters do to the calibration.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from core.model import Model
from core.network import Network, Parameter, Quantity
from core.prior import Prior
from core.surrogate.formula import FormulaInput, FormulaModel

Array = NDArray[np.float64]


def three_stages(x: Array, t: float) -> Array:
    """Elongation [mm] of inputs (n, 7), in the network's order, after t hours → (n,)."""
    rate, coating, elastic, amplitude, time, steady, tertiary = x.T
    warmth = np.exp(3.0 * (rate - 0.9) - 0.9 * (coating - 1.0))
    hours = t / 1e4
    transient = 0.5 * np.exp(0.25 * amplitude) * warmth
    transient = transient * (1 - np.exp(-4.0 * np.exp(0.2 * time) * hours))
    steadily = 0.5 * np.exp(0.3 * steady) * warmth * hours
    return np.asarray(
        1.0 + 0.05 * elastic + transient + steadily
        + 0.02 * np.exp(0.3 * tertiary) * warmth * hours**3
    )  # fmt: skip


def six_locals() -> Model:
    """One shared parameter and the noise, six local parameters, one quantity."""
    deviates = ("elastic", "amplitude", "time", "steady", "tertiary")
    parameters = (
        Parameter("rate", "shared", Prior("uniform", 0.8, 1.0)),
        Parameter("coating", "local", Prior("uniform", 2 / 3, 4 / 3)),
        *(Parameter(name, "local", Prior("uniform", -3.0, 3.0)) for name in deviates),
    )
    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in parameters)
    quantity = Quantity("elongation", "mm", "scalar", Prior("log_uniform", 3e-3, 0.1), -5.0, 50.0)
    return Model(
        Network("six-locals", parameters, (quantity,)),
        FormulaModel(
            inputs, {"elongation": three_stages}, "three-stages", positive=("elongation",)
        ),
    )
