"""Whether a large amplitude holds: calibrated from each half of the readings by itself.

`halves` asks a posterior for the difference between two halves to first order, with a prior of
`WIDE` expected sizes. An amplitude beyond these (a dormant input with a wide prior of its own that
wakes) is outside of what that prior takes for possible, and what the readings say of it is far
from linear: over its posterior the answer changes more than in proportion. There the rotor is
calibrated twice, by the readings of one half and by those of the other. The two posteriors share
their priors alone, and

    (a_1 − a_2) / √(s_1² + s_2²)

is near a standard normal if there is one amplitude. It tells less than the first order does where
that is right: each half has to find the other parameters for itself.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from core.calibration.online import Workspace, update
from core.calibration.state import RotorSpec, shared_posterior
from core.diagnosis.verdict import Held
from core.model import Model
from core.observation import Inspection

BLADES, HOURS = "in two halves of the blades", "early and late"


def parts(readings: Sequence[Inspection], by: str) -> tuple[list[Inspection], list[Inspection]]:
    """Readings of every other blade in the order of names and of the rest, or by their median hour.

    >>> one = [Inspection(i, i, "y", float(t), np.array([0.0])) for t, i in enumerate("abc")]
    >>> [[r.id for r in part] for by in (BLADES, HOURS) for part in parts(one, by)]
    [['a', 'c'], ['b'], ['a', 'b'], ['c']]
    """
    odd = set(sorted({r.blade for r in readings})[1::2])
    middle = float(np.median([r.time_h for r in readings]))
    second = [r.blade in odd if by == BLADES else r.time_h > middle for r in readings]
    return (
        [r for r, late in zip(readings, second, strict=True) if not late],
        [r for r, late in zip(readings, second, strict=True) if late],
    )


def parted(
    model: Model,
    spec: RotorSpec,
    readings: Sequence[Inspection],
    name: str,
    origin: float,
    size: float,
    by: str,
) -> Held:
    """The amplitude `name` of a model with the effect in each half, in expected sizes.

    origin   the amplitude where there is no effect
    """
    found: list[tuple[float, float]] = []
    for half in parts(readings, by):
        state = update(model, spec, half, workspace=Workspace())
        shared = shared_posterior(state.meta, state.arrays.__getitem__)
        a, w = (shared.column(name) - origin) / size, shared.particles.w
        mean = float(w @ a)
        found.append((mean, float(w @ (a - mean) ** 2)))
    (first, v), (second, u) = found
    return Held(by, (first, second), float(np.sqrt(v + u)))
