"""A quantity's prediction as the service tells it: each direction of a deformation by itself.

The bands of one direction are those of `core.prediction`; nothing is assumed of how the directions
of a deformation go together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from core.calibration.state import Posterior
from core.model import Model
from core.prediction import predict
from service.ports import Array, NoiseFrom


@dataclass(frozen=True, slots=True)
class Bands:
    """A prediction; for a 3-D deformation the arrays are (T, 3)."""

    time_h: Array
    mean: Array
    sd: Mapping[str, Array]
    lower: Array
    upper: Array
    quantiles: Mapping[float, Array]
    instrument: str | None
    noise_from: NoiseFrom


def bands_of(
    model: Model,
    posterior: Posterior,
    quantity: str,
    times: Sequence[float],
    node: int | None,
    probability: float,
    *,
    instrument: str | None,
    known: Mapping[str, float] | None,
) -> Bands:
    """The prediction of a blade's model with its posterior."""
    components = [0, 1, 2] if model.network.quantity(quantity).kind == "vector" else [None]
    parts = [
        predict(
            model,
            posterior,
            quantity,
            times,
            node,
            probability,
            component=component,
            instrument=instrument,
            known=known,
        )
        for component in components
    ]
    noise = model.network.quantity(quantity).sigma_of(parts[0].instrument)

    def joined(arrays: list[Array]) -> Array:
        return arrays[0] if len(arrays) == 1 else np.stack(arrays, axis=1)

    return Bands(
        parts[0].time_h,
        joined([p.mean for p in parts]),
        {name: joined([p.sd[name] for p in parts]) for name in parts[0].sd},
        joined([p.lower for p in parts]),
        joined([p.upper for p in parts]),
        {q: joined([p.quantiles[q] for p in parts]) for q in parts[0].quantiles},
        parts[0].instrument,
        "readings" if noise in posterior.names else "prior",
    )
