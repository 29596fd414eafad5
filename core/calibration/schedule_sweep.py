"""The turns of the paper's schedule: what is held, what is calibrated, and what moved.

See `core.calibration.schedule` for the algorithm and how its words are read.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from core.calibration.schedule_filter import Belief, LogDensity, carried
from core.calibration.schedule_readings import Readings
from core.calibration.space import SharedSpace, locals_of, shared_prior
from core.calibration.state import RotorSpec
from core.model import Model
from core.observation import Inspection
from core.prior import Prior
from core.rng import stream

if TYPE_CHECKING:
    from core.calibration.schedule import Schedule

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Sweep:
    """One turn of the loop.

    mean, sd    of the shared parameters, natural units
    moved       largest change of mean and variance, in prior sd and variance
    plain_ess   what one weighting of the particles would have left, shared and worst blade: in
                the first sweep from the prior, then from the sweep before
    acceptance  of the moves, least over all beliefs
    """

    instant: str
    number: int
    mean: Mapping[str, float]
    sd: Mapping[str, float]
    moved: float
    plain_ess: float
    plain_ess_blade: float
    acceptance: float


class Run:
    """The beliefs at work."""

    def __init__(self, model: Model, rotor: RotorSpec, schedule: Schedule) -> None:
        self.model, self.rotor, self.schedule = model, rotor, schedule
        physical = [(p.name, p.prior) for p in model.network.of_level("shared")]
        self.physical = frozenset(name for name, _ in physical)
        self.shared = self._prior("shared", physical)
        own = [(p.name, p.prior) for p in locals_of(model)]
        self.local = {b: self._prior(b, own) for b in rotor.blades}
        self.joint: dict[str, Belief] = {}
        self.trace: list[Sweep] = []
        self.converged: dict[str, bool] = {}

    def _stream(self, *key: str | int) -> np.random.Generator:
        return stream(self.rotor.seed, "schedule", self.rotor.id, *key)

    def _prior(self, key: str, named: Sequence[tuple[str, Prior]]) -> Belief:
        names, priors = [n for n, _ in named], [p for _, p in named]
        return Belief.prior(names, priors, self.rotor.particles, self._stream(key, "prior", *names))

    def _with_noise(self, key: str, belief: Belief, names: Iterable[str]) -> Belief:
        """The belief, and the priors of sigma_obs and theta that it meets first."""
        met = sorted(set(names).difference(belief.space.names, self.physical))
        if not met:
            return belief
        new = [(name, shared_prior(self.model, name)) for name in met]
        return belief.beside(self._prior(key, new), self._stream(key, "beside", *met))

    def _with_noises(self, seen: Mapping[str, Readings]) -> None:
        if self.schedule.noise == "rotor":
            met = [name for read in seen.values() for name in read.shared]
            self.shared = self._with_noise("shared", self.shared, met)
        else:
            for b, read in seen.items():
                self.local[b] = self._with_noise(b, self.local[b], read.shared)

    def _readings(self, blade: str, readings: Sequence[Inspection]) -> Readings:
        return Readings(self.model, readings, (self.rotor.known or {}).get(blade))

    def sweep(self, label: str, readings: Sequence[Inspection]) -> None:
        """Multi-component data: local and shared parameters in turn until they stay."""
        by_blade = grouped(readings)
        if not by_blade:
            return
        s = self.schedule
        seen = {b: self._readings(b, own) for b, own in by_blade.items()}
        self._with_noises(seen)
        enter_shared = self.shared.log_density
        enter_local = {b: self.local[b].log_density for b in seen}
        draws = s.draws if s.fix == "draws" else None
        self.converged[label] = False
        for number in range(1, s.sweeps + 1):
            again = s.prior == "last sweep"
            held = self.shared.held(draws, self._stream(label, "hold"))
            least, acceptance = np.inf, 1.0
            for b, read in seen.items():
                before = self.local[b].log_density if again else enter_local[b]
                term = read.holding(held, self.local[b].space.names)
                target = product(self.local[b], before, term)
                step = carried(self.local[b], target, self._stream(label, number, b))
                self.local[b], least = step.belief, min(least, step.plain_ess)
                acceptance = min(acceptance, step.acceptance)
                self.joint.pop(b, None)
            old = self.shared
            before = old.log_density if again else enter_shared
            terms = [
                read.holding(
                    self.local[b].held(draws, self._stream(label, "hold", b)), old.space.names
                )
                for b, read in seen.items()
            ]
            target = product(old, before, *terms)
            step = carried(old, target, self._stream(label, number, "shared"))
            self.shared = step.belief
            moved = change(old, self.shared)
            mean, sd = self.shared.x.mean(axis=0), self.shared.x.std(axis=0)
            names = self.shared.space.names
            self.trace.append(
                Sweep(
                    label,
                    number,
                    dict(zip(names, mean.tolist(), strict=True)),
                    dict(zip(names, sd.tolist(), strict=True)),
                    moved,
                    step.plain_ess,
                    float(least),
                    min(acceptance, step.acceptance),
                )
            )
            if moved <= s.threshold:
                self.converged[label] = True
                return

    def _jointly(self, key: tuple[str, ...], b: str, read: Readings) -> Belief:
        """Local and shared parameters of one blade in one step, from its and the shared belief."""
        if b in self.joint:
            prior = self.joint[b]
        else:
            prior = self.local[b].beside(self.shared, self._stream(*key, b, "pairs"))
        prior = self._with_noise(b, prior, read.shared)
        term = read.holding({}, prior.space.names)
        target = product(prior, prior.log_density, term)
        return carried(prior, target, self._stream(*key, b, "joint")).belief

    def together_with(self, label: str, readings: Sequence[Inspection]) -> None:
        """Single-component data: one quantity of one blade after the other."""
        for quantity in [q.name for q in self.model.network.quantities]:
            for b, own in grouped([i for i in readings if i.quantity == quantity]).items():
                self.joint.pop(b, None)  # the shared parameters have moved on since
                read = self._readings(b, own)
                self._with_noises({b: read})
                found = self._jointly((label, quantity), b, read)
                self.local[b], self.shared = split(found, self.local[b].space.names)
                self.joint[b] = found

    def branches(self, readings: Sequence[Inspection]) -> None:
        """Single-component data: each quantity of a blade goes on from multi-component data."""
        for quantity in [q.name for q in self.model.network.quantities]:
            for b, own in grouped([i for i in readings if i.quantity == quantity]).items():
                self.joint[b] = self._jointly(("branch", quantity), b, self._readings(b, own))


def grouped(readings: Sequence[Inspection]) -> dict[str, list[Inspection]]:
    """Readings by blade, blades in order."""
    found: dict[str, list[Inspection]] = {}
    for reading in readings:
        found.setdefault(reading.blade, []).append(reading)
    return dict(sorted(found.items()))


def product(belief: Belief, before: LogDensity, *terms: LogDensity) -> LogDensity:
    """log of a prior density times likelihoods, on the belief's unit box."""

    def log_density(u: Array) -> Array:
        x = belief.space.to_x(u)
        return np.asarray(before(u) + sum(term(x) for term in terms))

    return log_density


def change(old: Belief, new: Belief) -> float:
    """Largest change of mean and variance, in prior standard deviations and variances."""
    if old.space.dim == 0:
        return 0.0
    (m0, v0), (m1, v1) = old.moments, new.moments
    sd = np.array(
        [
            p.sd / (p.high - p.low) if p.kind == "normal" else 12**-0.5  # on the unit box
            for p in old.space.priors
        ]
    )
    return float(max((np.abs(m1 - m0) / sd).max(), (np.abs(v1 - v0) / sd**2).max()))


def split(joint: Belief, local: Sequence[str]) -> tuple[Belief, Belief]:
    """The marginals of a joint step: of the parameters named first, and of the others."""
    d, space = len(local), joint.space
    return (
        Belief.fitted(SharedSpace(space.names[:d], space.priors[:d]), joint.u[:, :d]),
        Belief.fitted(SharedSpace(space.names[d:], space.priors[d:]), joint.u[:, d:]),
    )
