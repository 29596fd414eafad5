"""From when on an effect in the model would leave the simulation's runs, and is held at their end.

A drift that a diagnosis adopts stays inside the runs at every reading; where it goes on, inputs may
reach the end of the runs and stay there (`core.surrogate.reach`). A forecast of such hours is too
mild, so the verdict says from when on that is, and of how many blades. Blades and amplitudes count
at their posterior means: a warning, not a band.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from core.archive import Input
from core.calibration.state import RotorState, blade_posterior
from core.model import Model
from core.surrogate.driven import Driven

Array = NDArray[np.float64]
HOURS = 151  # at which a course is looked at


def leaving_runs(model: Model, state: RotorState, blades: Sequence[str]) -> list[str]:
    """In words, one for each input that leaves its runs in some of the blades; hours are theirs."""
    answers = model.surrogate
    if not isinstance(answers, Driven):
        return []
    held = [d for d in model.network.drifts if d.held]
    box = {i.name: i for i in answers.base.inputs}
    hours = np.linspace(0.0, answers.horizon_h, HOURS)
    told = []
    for name in dict.fromkeys(d.input for d in held):
        out = [h for b in blades if (h := _out(model, state, b, box[name], hours)) is not None]
        if out:
            effects = " and ".join(d.name for d in held if d.input == name)
            told.append(
                f"from {min(out):,.0f} h on {effects} would take {name} of {len(out)} of "
                f"{len(blades)} blades out of the runs, {box[name].low:g} … {box[name].high:g}: "
                "there it is held at their end, and what is said of later hours is too mild"
            )
    return told


def _out(model: Model, state: RotorState, blade: str, own: Input, hours: Array) -> float | None:
    """The first of these hours at which a blade's input is outside; None: at none."""
    drifts = [
        d for one in model.network.drifts if one.input == own.name and (d := one.of_blade(blade))
    ]
    if not drifts:
        return None
    found = blade_posterior(state.meta, state.arrays.__getitem__, blade)
    means = {p.name: p.nominal or 0.0 for p in model.network.parameters}
    means |= dict(zip(found.names, found.particles.mean.tolist(), strict=True))
    course = np.full(len(hours), means[own.name])
    for d in drifts:
        course = d.moved(course, means[d.name], d.shape.at(hours))
    slack = 1e-9 * (own.high - own.low)
    outside = (course < own.low - slack) | (course > own.high + slack)
    return float(hours[np.argmax(outside)]) if outside.any() else None
