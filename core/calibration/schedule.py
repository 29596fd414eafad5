"""The paper's schedule (Algorithm 1, Sec. 3.2 and 4), kept for comparison; `online.update` is ours.

::

    while the mean or the variance of psi_global moves by more than the threshold
        hold psi_global;  calibrate psi_local of every blade      (multi-component data)
        hold psi_local;   calibrate psi_global, with sigma_obs and theta
    calibrate psi_local of one blade and psi_global together      (single-component data)

*Offline* all multi-component data come first, then the single-component data; *online* both come
outage by outage, the last posterior being the next prior.

**What it computes.** Held at a point, the turns climb to a mode of the joint posterior, as
coordinate descent does: slowly along a ridge (T1T against the TBC thickness), where the threshold
stops them early. The spread of a parameter is then that of its *conditional* posterior, all others
known. In a linear-Gaussian network with precision matrix Lambda its variance is 1 / Lambda_ss, and
should be (Lambda^-1)_ss.

**What was read into the paper's words** (each a field of `Schedule`; where two readings give other
answers, both are there):

- *fix*: "fix psi_local at their posterior" holds them at the posterior mean ("posterior estimates",
  Sec. 3.2; the comparison with expectation maximisation), one value. Other reading (``"draws"``):
  the distribution is held, and the likelihood averaged over `draws` of its particles. The mean is
  the default since the algorithm fixes values; draws are wider but use each reading twice.
- *prior*: each sweep starts from the prior with which the loop was entered. Other reading
  (``"last sweep"``): "the posterior distributions from this calibration are then used as prior
  distributions", so every sweep multiplies the same likelihood in again and no spread is left. The
  default is the one under which the comparison with expectation maximisation holds. "Fix psi_global
  at their priors" is read as *at their current distribution* after the first sweep: else the loop
  would have nothing to repeat.
- *offline*: all outages' multi-component data at once ("all the available data", Sec. 3.2 and 5).
  The listing has a loop over time around the sweeps: ``"in turn"``.
- *single*: single-component data re-calibrate one after the other, each posterior the prior of the
  next (Algorithm 1). Other reading (``"branches"``): Sec. 4, step 4, starts the CEEQ again from the
  multi-component posterior, so each blade's re-calibration is an end of its own and hands no shared
  parameter on.
- *noise*: sigma_obs and theta of a quantity are one value for the rotor, calibrated with
  psi_global. Other reading (``"blade"``): with psi_local, as figures of single blades show them.
- *threshold*: change of mean and variance from one sweep to the next, on the prior's unit box, in
  prior standard deviations and variances, all parameters of the shared step; 0.01, at most 50
  sweeps. The paper gives neither.
- *discrepancy*: delta ~ N(Y_m (theta1 − theta2 psi), 1e-5²); "y" is the model's output, as only it
  exists in a prediction; psi is one named input; theta have the prior `theta`. None: no delta.
- An outage is a campaign where the reading names one, else an operating hour. Which quantities are
  multi-component is declared (`multi`), the others are single-component in the network's order.
- The particle filter: see `schedule_filter`. After a joint step only its particles are known; as
  the next prior they count as a normal density within the bounds. A blade's local particles and the
  shared ones are independent in the result, except where a joint step was the blade's last.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from core.calibration.schedule_filter import Belief, LogDensity, Readings, carried
from core.calibration.state import Posterior, RotorSpec
from core.calibration.target import locals_of, nominal
from core.errors import InputError
from core.model import Model
from core.network import Prior
from core.observation import Inspection
from core.rng import stream
from core.smc.particles import Particles

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Schedule:
    """Algorithm 1 and how its words are read; see the module's text."""

    strategy: Literal["offline", "online"] = "offline"
    fix: Literal["mean", "draws"] = "mean"
    draws: int = 100
    prior: Literal["entering", "last sweep"] = "entering"
    offline: Literal["at once", "in turn"] = "at once"
    single: Literal["in turn", "branches"] = "in turn"
    noise: Literal["rotor", "blade"] = "rotor"
    multi: tuple[str, ...] = ("elongation",)
    threshold: float = 0.01
    sweeps: int = 50
    discrepancy: str | None = None
    theta: Prior = field(default_factory=lambda: Prior("uniform", -0.5, 0.5))

    def __post_init__(self) -> None:
        for name, kind in get_type_hints(Schedule).items():
            if name in ("strategy", "fix", "prior", "offline", "single", "noise"):
                value, choices = getattr(self, name), get_args(kind)
                if value not in choices:
                    raise InputError(name, value, "is no reading", f"use one of {choices}")
        if not self.threshold > 0:
            raise InputError("threshold", self.threshold, "is not positive", "give 0.01, say")
        if self.sweeps < 1:
            raise InputError("sweeps", self.sweeps, "is less than one", "allow one sweep at least")
        if self.draws < 2:
            raise InputError("draws", self.draws, "are too few to average over", "give 100, say")


@dataclass(frozen=True, slots=True)
class Sweep:
    """One turn of the loop.

    mean, sd    of the shared parameters, natural units
    moved       largest change of mean and variance, in prior sd and variance
    plain_ess   what one weighting of the particles would have left, shared and worst blade
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


@dataclass(frozen=True)
class Scheduled:
    """What the schedule arrives at.

    shared      particles of the shared parameters
    local       particles of each blade's own parameters
    together    blades whose last step was a joint one: local and shared particles as pairs
    trace       every sweep;  converged: per loop, False where the sweeps ran out
    """

    schedule: Schedule
    shared: Posterior
    local: Mapping[str, Posterior]
    together: Mapping[str, Posterior]
    trace: tuple[Sweep, ...]
    converged: Mapping[str, bool]
    seed: int

    @property
    def ess(self) -> dict[str, float]:
        """Effective share of distinct particles: of each blade, and of the ``shared`` ones."""
        sets = {**{b: p.particles for b, p in self.local.items()}, "shared": self.shared.particles}
        return {
            name: float(n * n / np.sum(np.unique(p.psi, axis=0, return_counts=True)[1] ** 2.0))
            for name, p in sets.items()
            if (n := len(p.psi)) and p.psi.shape[1]
        }

    def blade(self, name: str) -> Posterior:
        """Local and shared particles of a blade, for `core.prediction.predict`.

        Independent of each other, as the schedule knows no better, unless in `together`.
        """
        if name not in self.local:
            raise InputError("blade", name, "has no particles here", "name a blade of the rotor")
        if name in self.together:
            return self.together[name]
        local, shared = self.local[name], self.shared
        order = stream(self.seed, "schedule", name, "pairs").permutation(len(shared.particles.psi))
        return Posterior(
            (*local.names, *shared.names),
            Particles(
                np.hstack([local.particles.psi, shared.particles.psi[order]]),
                np.zeros(len(order)),
            ),
        )


def calibrate(
    model: Model, rotor: RotorSpec, inspections: Sequence[Inspection], schedule: Schedule
) -> Scheduled:
    """The schedule's posterior after these readings; `rotor.particles` particles a set.

    Raises InputError for a blade that the rotor does not have, for a quantity or an input that the
    model does not have; CalibrationError where no particle explains a reading.
    """
    for quantity in schedule.multi:
        model.network.quantity(quantity)
    if schedule.discrepancy is not None and schedule.discrepancy not in model.input_names:
        raise InputError(
            "discrepancy", schedule.discrepancy, "is no input", f"one of {model.input_names}"
        )
    if rotor.particles < max(100, schedule.draws):
        raise InputError(
            "particles", rotor.particles, "are too few", f"give {max(100, schedule.draws)} or more"
        )
    for reading in inspections:
        if reading.blade not in rotor.blades:
            raise InputError(
                "blade", reading.blade, f"is no blade of rotor {rotor.id}", "install it first"
            )
    run = _Run(model, rotor, schedule)
    outages = instants(inspections)
    multi = {label: [i for i in own if i.quantity in schedule.multi] for label, own in outages}
    single = {label: [i for i in own if i.quantity not in schedule.multi] for label, own in outages}
    at_once = schedule.strategy == "offline" and schedule.offline == "at once"
    loops = {"all": [i for own in multi.values() for i in own]} if at_once else multi
    for label, own in loops.items():
        run.sweep(label, own)
        if schedule.strategy == "online" and schedule.single == "in turn":
            run.together_with(label, single[label])
    if schedule.single == "branches":
        run.branches([i for own in single.values() for i in own])
    elif schedule.strategy == "offline":
        for label, own in single.items():
            run.together_with(label, own)
    return run.result()


def instants(readings: Sequence[Inspection]) -> list[tuple[str, list[Inspection]]]:
    """The outages in order of time, each with its readings ordered by (blade, id).

    An outage is a campaign, placed by its oldest blade, or else an operating hour.
    """
    found: dict[str, list[Inspection]] = {}
    for reading in sorted(readings, key=lambda i: (i.blade, i.id)):
        found.setdefault(reading.campaign or f"{reading.time_h:g} h", []).append(reading)
    return sorted(found.items(), key=lambda item: max(i.time_h for i in item[1]))


class _Run:
    """The beliefs at work."""

    def __init__(self, model: Model, rotor: RotorSpec, schedule: Schedule) -> None:
        self.model, self.rotor, self.schedule = model, rotor, schedule
        physical = model.network.of_level("shared")
        self.shared = self._prior("shared", [(p.name, p.prior) for p in physical])
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

    def _with_noise(self, key: str, belief: Belief, readings: Sequence[Inspection]) -> Belief:
        """The belief, and the priors of sigma_obs and theta of quantities that it meets first."""
        new: list[tuple[str, Prior]] = []
        for name in sorted({i.quantity for i in readings}):
            quantity = self.model.network.quantity(name)
            if any(i.sigma is None for i in readings if i.quantity == name):
                new.append((quantity.sigma_name, quantity.sigma_obs))
            if self.schedule.discrepancy is not None:
                new += [(f"{theta}.{name}", self.schedule.theta) for theta in ("theta1", "theta2")]
        new = [(name, prior) for name, prior in new if name not in belief.space.names]
        if not new:
            return belief
        return belief.beside(self._prior(key, new), self._stream(key, "beside", *dict(new)))

    def _readings(self, blade: str, readings: Sequence[Inspection]) -> Readings:
        known = nominal(self.model, (self.rotor.known or {}).get(blade))
        return Readings(self.model, readings, known, self.schedule.discrepancy)

    def _with_noises(self, by_blade: Mapping[str, list[Inspection]]) -> None:
        if self.schedule.noise == "rotor":
            every = [i for own in by_blade.values() for i in own]
            self.shared = self._with_noise("shared", self.shared, every)
        else:
            for b, own in by_blade.items():
                self.local[b] = self._with_noise(b, self.local[b], own)

    def sweep(self, label: str, readings: Sequence[Inspection]) -> None:
        """Multi-component data: local and shared parameters in turn until they stay."""
        by_blade = grouped(readings)
        if not by_blade:
            return
        s = self.schedule
        self._with_noises(by_blade)
        seen = {b: self._readings(b, own) for b, own in by_blade.items()}
        enter_shared, enter_local = self.shared.log_density, {
            b: self.local[b].log_density for b in seen
        }  # fmt: skip
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

    def _jointly(self, key: tuple[str, ...], b: str, own: Sequence[Inspection]) -> Belief:
        """Local and shared parameters of one blade in one step, from its and the shared belief."""
        if b in self.joint:
            prior = self.joint[b]
        else:
            prior = self.local[b].beside(self.shared, self._stream(*key, b, "pairs"))
        prior = self._with_noise(b, prior, own)
        term = self._readings(b, own).holding({}, prior.space.names)
        target = product(prior, prior.log_density, term)
        return carried(prior, target, self._stream(*key, b, "joint")).belief

    def together_with(self, label: str, readings: Sequence[Inspection]) -> None:
        """Single-component data: one quantity of one blade after the other."""
        for quantity in [q.name for q in self.model.network.quantities]:
            for b, own in grouped([i for i in readings if i.quantity == quantity]).items():
                self.joint.pop(b, None)  # the shared parameters have moved on since
                self._with_noises({b: own})
                found = self._jointly((label, quantity), b, own)
                self.local[b], self.shared = split(found, self.local[b].space.names)
                self.joint[b] = found

    def branches(self, readings: Sequence[Inspection]) -> None:
        """Single-component data: each quantity of a blade goes on from multi-component data."""
        for quantity in [q.name for q in self.model.network.quantities]:
            for b, own in grouped([i for i in readings if i.quantity == quantity]).items():
                self.joint[b] = self._jointly(("branch", quantity), b, own)

    def result(self) -> Scheduled:
        def posterior(belief: Belief) -> Posterior:
            return Posterior(belief.space.names, Particles(belief.x, np.zeros(len(belief.u))))

        return Scheduled(
            self.schedule,
            posterior(self.shared),
            {b: posterior(belief) for b, belief in self.local.items()},
            {b: posterior(belief) for b, belief in self.joint.items()},
            tuple(self.trace),
            self.converged,
            self.rotor.seed,
        )


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
        Belief.fitted(type(space)(space.names[:d], space.priors[:d]), joint.u[:, :d]),
        Belief.fitted(type(space)(space.names[d:], space.priors[d:]), joint.u[:, d:]),
    )
