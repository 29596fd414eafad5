"""Whether a large effect holds: calibrated from each half of the readings by itself.

`halves` asks a posterior for the difference between two halves to first order, with a prior of
`WIDE` expected sizes. An amplitude beyond these (a dormant input with a wide prior of its own that
wakes) is outside of what that prior takes for possible, and what the readings say of it is far
from linear: over its posterior the answer changes more than in proportion. There the rotor is
calibrated twice, by the readings of one half and by those of the other. The two posteriors share
their priors alone, and

    (a_1 − a_2) / √(s_1² + s_2²)

is near a standard normal if there is one amplitude. It tells less than the first order does where
that is right: each half has to find the other parameters for itself.

What is large and not the same everywhere may still be there everywhere: creep that accelerates in
every specimen, at each one's own rate. So where a large amplitude is not one, each half is asked
whether it has the effect at all, by its evidence with and without,

    gained_k = ln p(y_k | all effects) − ln p(y_k | all but this one),

and so is every other effect beside it: a law that is off in its amplitude leaves a misfit behind
for which a lesser effect may be taken, and in a half with an amplitude of its own that misfit is
smaller. What both halves find, each by itself, is no accident of either.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from core.calibration.online import Workspace, update
from core.calibration.state import Posterior, RotorSpec, shared_posterior
from core.diagnosis.verdict import Held
from core.model import Model
from core.observation import Inspection

BLADES, HOURS = "in two halves of the blades", "early and late"


@dataclass(frozen=True, slots=True)
class Part:
    """What a half of the readings makes of a model."""

    log_evidence: float
    shared: Posterior


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


@dataclass(frozen=True)
class Parted:
    """A rotor's readings in halves, and what each half by itself makes of a model.

    heed  as of a `Workspace`
    """

    spec: RotorSpec
    readings: Sequence[Inspection]
    heed: Callable[[], None] = lambda: None
    _known: dict[tuple[str, str], tuple[Part, Part]] = field(
        default_factory=dict, compare=False, repr=False
    )

    def amplitudes(
        self, model: Model, effect: str, name: str, origin: float, size: float, by: str
    ) -> Held:
        """Of the amplitude `name` of a model with the effect, in each half, in expected sizes.

        origin   the amplitude where there is no effect
        """
        found: list[tuple[float, float]] = []
        for half in self.halves(model, by):
            a, w = (half.shared.column(name) - origin) / size, half.shared.particles.w
            mean = float(w @ a)
            found.append((mean, float(w @ (a - mean) ** 2)))
        (first, v), (second, u) = found
        return Held(by, (first, second), float(np.sqrt(v + u)), effect, alone=True)

    def gained(self, model: Model, less: Model, by: str) -> tuple[float, float]:
        """Nats by which each half has a model rather than one that lacks an effect of it."""
        (a, b), (c, d) = self.halves(model, by), self.halves(less, by)
        return a.log_evidence - c.log_evidence, b.log_evidence - d.log_evidence

    def halves(self, model: Model, by: str) -> tuple[Part, Part]:
        """Each half's evidence and posterior of the shared parameters."""
        key = (model.digest, by)
        if key not in self._known:
            first, second = (self._calibrated(model, half) for half in parts(self.readings, by))
            self._known[key] = first, second
        return self._known[key]

    def _calibrated(self, model: Model, half: Sequence[Inspection]) -> Part:
        state = update(model, self.spec, half, workspace=Workspace(heed=self.heed))
        shared = shared_posterior(state.meta, state.arrays.__getitem__)
        return Part(state.meta["log_evidence"], shared)
