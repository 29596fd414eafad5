"""A smooth blade by formula, and the service's science on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from core.builtin.paper_network import rotor_blade_network
from core.model import Model
from core.surrogate.formula import FormulaInput, FormulaModel
from service.science import CoreScience

TRUE = np.array([[1.1, 0.87, 0.4, -0.5]])


def elongation(x: NDArray[np.float64], time_h: float) -> NDArray[np.float64]:
    """tbc, t1t, alpha, gamma → mm."""
    tbc, t1t, alpha, gamma = x.T
    heat = np.exp(8.0 * (t1t - 0.9) - 1.5 * (tbc - 1.0))
    primary = 0.08 * np.exp(0.15 * alpha) * time_h / (time_h + 3000.0)
    return np.asarray(heat * (primary + 0.3 * np.exp(0.2 * gamma) * time_h / 50_000.0))


def formula_science() -> CoreScience:
    network = rotor_blade_network()
    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in network.parameters)
    formula = FormulaModel(
        inputs, {"elongation": elongation}, "smooth", 50_000.0, positive=("elongation",)
    )
    return CoreScience(model=Model(network, formula))
