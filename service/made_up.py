"""A made-up rotor: one update of it compiles what updates need, before a worker takes any.

Its readings are what the model answers in the middle of the priors, so that the update is an
ordinary one.
"""

from __future__ import annotations

import numpy as np

from core.model import Model
from core.observation import Inspection
from service.ports import RotorSpec


def made_up_rotor(
    model: Model, horizon_h: float
) -> tuple[RotorSpec, Inspection, Inspection] | None:
    """One blade and two readings of it; None: the model has no scalar quantity."""
    quantity = next((q for q in model.network.quantities if q.kind == "scalar"), None)
    if quantity is None:
        return None
    inputs = [model.network.parameter(i.name) for i in model.part(quantity.name).inputs]
    middle = {
        p.name: p.prior.quantile(np.array(0.5)).item() if p.nominal is None else p.nominal
        for p in inputs
    }
    known = {p.name: middle[p.name] for p in inputs if p.level == "known"}
    spec = RotorSpec("warm", ("w",), 256, 0, {"w": known})
    x = np.array([[middle[p.name] for p in inputs]])
    times = horizon_h * np.array([0.5, 0.6])
    values, _ = model.part(quantity.name).predict(x, quantity.name, times)
    first, later = (
        Inspection(f"w{i}", "w", quantity.name, t, values[0, [i]], sigma=quantity.sigma_obs.high)
        for i, t in enumerate(times.tolist())
    )
    return spec, first, later
