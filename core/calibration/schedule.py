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
- The discrepancy is the network's (`core.discrepancy`, kind ``paper``): "y" is the model's output,
  as only it exists in a prediction, and psi is one named input.
- An outage is a campaign where the reading names one, else an operating hour. Which quantities are
  multi-component is declared (`multi`), the others are single-component in the network's order.
- The particle filter: see `schedule_filter`. After a joint step only its particles are known; as
  the next prior they count as a normal density within the bounds. A blade's local particles and the
  shared ones are independent in the result, except where a joint step was the blade's last.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args, get_type_hints

import numpy as np

from core.calibration.schedule_filter import Belief
from core.calibration.schedule_sweep import Run, Sweep
from core.calibration.space import locals_of
from core.calibration.state import Posterior, RotorSpec
from core.errors import InputError
from core.model import Model
from core.observation import Inspection
from core.rng import stream
from core.smc.particles import Particles


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
        """Effective number of distinct particles: of each blade, and of the ``shared`` ones."""
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
    drawn = [p.name for p in locals_of(model) if p.population is not None]
    if drawn:
        raise InputError(
            "population", drawn, "is no part of the paper's network", "give these plain priors"
        )
    if model.network.forgetting_h is not None:
        raise InputError(
            "forgetting_h", model.network.forgetting_h, "is not in Algorithm 1", "leave it out"
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
    run = Run(model, rotor, schedule)
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
    return Scheduled(
        schedule,
        _posterior(run.shared),
        {b: _posterior(belief) for b, belief in run.local.items()},
        {b: _posterior(belief) for b, belief in run.joint.items()},
        tuple(run.trace),
        run.converged,
        rotor.seed,
    )


def _posterior(belief: Belief) -> Posterior:
    return Posterior(belief.space.names, Particles(belief.x, np.zeros(len(belief.u))))


def instants(readings: Sequence[Inspection]) -> list[tuple[str, list[Inspection]]]:
    """The outages in order of time, each with its readings ordered by (blade, id).

    An outage is a campaign, placed by its oldest blade, or else an operating hour.
    """
    found: dict[str, list[Inspection]] = {}
    for reading in sorted(readings, key=lambda i: (i.blade, i.id)):
        found.setdefault(reading.campaign or f"{reading.time_h:g} h", []).append(reading)
    return sorted(found.items(), key=lambda item: max(i.time_h for i in item[1]))
