"""From when on a blade has too little of an adopted effect.

A drift that a diagnosis adopts stays inside the runs at every reading; where it goes on, an input
may reach the end of the runs and stay there (`core.surrogate.reach`). And what grows has a course
until an hour of its own (`core.diagnosis.grammar.UNTIL`), and stays as it is by then: a model of
wider runs goes on for longer. Such hours have too little of the effect. Parameters count at their
posterior means: a warning, not a band.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from core.calibration.state import Posterior
from core.drift import Bias, Drift
from core.model import Model
from core.network import Network
from core.surrogate.driven import Driven

HOURS = 151  # at which a course is looked at
UNTIL = np.linspace(0.0, 1.0, 9)  # shares of an hour, where every particle's is
Array = NDArray[np.float64]


def held_from(
    model: Model, posterior: Posterior, blade: str, known: Mapping[str, float] | None = None
) -> dict[str, float]:
    """By input that reaches the end of its runs, the first of `HOURS` hours of the blade [h] at
    which it would have left them; known: inputs of the blade that are given."""
    answers, network = model.surrogate, model.network
    if not isinstance(answers, Driven):
        return {}
    moving = [d for one in network.drifts if one.held and (d := one.of_blade(blade)) is not None]
    if not moving:
        return {}
    means = {p.name: p.nominal or 0.0 for p in network.parameters}
    means |= dict(zip(posterior.names, posterior.particles.mean.tolist(), strict=True))
    means |= known or {}
    hours = np.linspace(0.0, answers.horizon_h, HOURS)
    found: dict[str, float] = {}
    for own in answers.base.inputs:
        if own.name not in {d.input for d in moving}:
            continue
        course = np.full(HOURS, means[own.name])
        for one in network.drifts:
            if one.input == own.name and (d := one.of_blade(blade)) is not None:
                course = d.moved(course, means[d.name], d.shape.at(hours))
        slack = 1e-9 * (own.high - own.low)
        outside = (course < own.low - slack) | (course > own.high + slack)
        if outside.any():
            found[own.name] = float(hours[np.argmax(outside)])
    return found


def courses_end(network: Network, blade: str, horizon_h: float) -> dict[str, float]:
    """By adopted effect of the blade that still grows where its course ends, before the model's
    last hour: that hour of the blade [h], from which on the effect stays as it is."""
    found: dict[str, float] = {}
    effects: list[Drift | Bias] = [d for d in network.drifts if d.held]
    effects += [b for b in network.biases if b.lasting]
    for one in effects:
        if (own := one.of_blade(blade)) is None or len(own.shape.points) < 2:
            continue
        (before, less), (end, most) = own.shape.points[-2:]
        if before < end < horizon_h and less != most:
            found[one.name] = max(end, 0.0)
    return found


def held_by(
    model: Model,
    posterior: Posterior,
    blade: str,
    of: str,
    hour: float,
    known: Mapping[str, float] | None = None,
) -> float:
    """The probability that the input `of` the blade would have left its runs by this hour [h]."""
    answers, network = model.surrogate, model.network
    moving = [d for o in network.drifts if o.input == of and (d := o.of_blade(blade)) is not None]
    if not isinstance(answers, Driven) or not any(d.held for d in moving):
        return 0.0
    w, given = posterior.particles.w, known or {}

    def column(name: str) -> Array:
        if name in posterior.names and name not in given:
            return posterior.column(name)
        return np.full(len(w), given.get(name, network.parameter(name).nominal or 0.0))

    course = np.repeat(column(of)[:, None], len(UNTIL), axis=1)
    for d in moving:
        course = d.moved(course, column(d.name)[:, None], d.shape.at(hour * UNTIL))
    own = next(i for i in answers.base.inputs if i.name == of)
    slack = 1e-9 * (own.high - own.low)
    outside = ((course < own.low - slack) | (course > own.high + slack)).any(axis=1)
    return float(w @ outside)
