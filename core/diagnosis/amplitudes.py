"""What readings say of the amplitudes of effects that are in the model, at their posterior means.

df/da is the slope of the rows on an amplitude, where the effect concerns them; how it goes with the
residuals is taken over the same particles (`core.diagnosis.scores`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.calibration.state import RotorState, shared_posterior
from core.diagnosis.adopt import amplitude, expected
from core.diagnosis.grammar import Cell, Facts
from core.diagnosis.masks import masks
from core.diagnosis.scores import Scores
from core.model import Model

Array = NDArray[np.float64]
NOTHING = 1e-6  # of the largest slope: what polynomials make of none


@dataclass(frozen=True)
class Amplitude:
    """An effect in the model, in expected sizes.

    mean   of its amplitude
    size   the expected one [its unit]
    slope  df/da of the rows (B, n); pull: Cov[df/da, r] (B, n); zero where it concerns none
    """

    cell: Cell
    mean: float
    size: float
    slope: Array
    pull: Array


def amplitudes(
    before: Model,
    state: RotorState,
    seen: Scores,
    effects: Sequence[Cell],
    facts: Mapping[str, Facts],
    noise: Mapping[str, float],
) -> Iterator[Amplitude]:
    """Of each effect in a state's model.

    before  the model without the effects; state, seen: with them
    """
    shared = shared_posterior(state.meta, state.arrays.__getitem__)
    others = [n for n in state.meta["shared"] if not n.startswith("sigma_obs.")]
    concerned = masks(effects, seen, facts) > 0
    for c, cell in enumerate(effects):
        name, origin = amplitude(cell, before.network)
        size, k = expected(cell, noise), others.index(name)
        mean = float(shared.particles.w @ shared.column(name)) - origin
        g = np.where(concerned[:, :, c], seen.slope[:, :, k], 0.0)
        told = np.abs(g) > NOTHING * np.max(np.abs(g), initial=0.0)  # of a step: those after
        h = np.where(told, seen.pull[:, :, k], 0.0) if seen.pull is not None else np.zeros(g.shape)
        yield Amplitude(cell, mean / size, size, np.where(told, g, 0.0) * size, h * size)
