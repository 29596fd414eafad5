"""Levels of networks: the posterior of a lower one is the prior of the next.

A blade's network may rest on lower ones: creep coupons below blades, strains of a few blades below
elongations of all. With the data D1 of level 1 and D2 of level 2 there are two cases (the paper's
Sec. 3.1), to any depth.

Independent data (`calibrate`). The shared parameters s couple the levels,

    p(s | D1, D2) ∝ [p(s) Π_b m_b¹(s)] Π_b m_b²(s),

and the bracket, the posterior of level 1, needs no density estimate while its readings are at hand:
a level is more messages in one product, each exact. So the levels' order does not change the last
posterior, and every level's own posterior is a sealed state. Different models are `Stacked`; a
component (coupon, blade) is anything with readings of its own, and pays for the local parameters
that its readings depend on. Where only the state of level 1 is kept, see `stored`.

One-to-one data (`paired`). Each component read on level 2 has its reading of level 1, which enters
the second model as a known input; given it, psi² does not depend on psi¹, and

    p(psi¹, psi² | D1, D2) ∝ L(D1 | psi¹) p(psi¹) · L(D2 | D1, psi²) p(psi²)

comes apart: both posteriors in one shot, separately. As in the paper, the paired reading counts as
it was read: its noise is no uncertainty of psi², and a slope of the second model against it is
drawn towards zero by the share of noise in the readings' variance. Where that matters, the input is
a `local` parameter of the second network and the paired quantity a reading of it (a stacked
formula y = x): then the case is the first one, and the noise counts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from core.calibration.online import Workspace, update
from core.calibration.space import shared_prior
from core.calibration.state import RotorSpec, RotorState, shared_posterior
from core.calibration.stored import StoredPosterior
from core.errors import InputError, RangeError
from core.model import Model
from core.observation import Inspection
from core.prior import Prior

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Change:
    """What one level taught about one shared parameter.

    mean, sd     after the level, on the working scale (log x for a log-uniform prior, else x)
    contraction  1 − (sd / sd before)²; negative where the level's data widened it
    kl           of the normal with these moments from the one before [nat]
    """

    parameter: str
    level: int
    mean: float
    sd: float
    contraction: float
    kl: float


@dataclass(frozen=True, slots=True)
class Levels:
    """One sealed state per level, each the prior of the next, and what each level changed."""

    states: Mapping[int, RotorState]
    changes: tuple[Change, ...]

    @property
    def last(self) -> RotorState:
        return self.states[max(self.states)]


def calibrate(
    model: Model,
    rotor: RotorSpec,
    readings: Sequence[Inspection],
    *,
    prior: StoredPosterior | None = None,
    workspace: Workspace | None = None,
) -> Levels:
    """Calibrate level by level: the state of level k rests on the readings up to level k.

    rotor  its `blades` are the components of every level
    prior  of a network still further below, of which only a state is kept
    """
    work = workspace or Workspace()
    level_of = {q.name: q.level for q in model.network.quantities}
    states: dict[int, RotorState] = {}
    for level in sorted(set(level_of.values())):
        known = [r for r in readings if model.network.quantity(r.quantity).level <= level]
        before = states.get(level - 1)
        states[level] = update(model, rotor, known, before, workspace=work, prior=prior)
    return Levels(states, _changes(model, states, prior))


def _changes(
    model: Model, states: Mapping[int, RotorState], prior: StoredPosterior | None
) -> tuple[Change, ...]:
    names = list(dict.fromkeys(n for s in states.values() for n in s.meta["shared"]))
    found = []
    for name in names:
        declared = shared_prior(model, name)
        before = _moments_of(declared)
        if prior is not None and name in prior.names:
            before = prior.moments_of(name)
        for level, state in states.items():
            now = before
            if name in state.meta["shared"]:
                posterior = shared_posterior(state.meta, state.arrays.__getitem__)
                u, w = declared.to_u(posterior.column(name)), posterior.particles.w
                mean = float(w @ u)
                now = mean, float(np.sqrt(w @ (u - mean) ** 2))
            ratio, shift = now[1] / before[1], (now[0] - before[0]) / before[1]
            kl = 0.5 * (shift**2 + ratio**2 - 1) - float(np.log(ratio))
            found.append(Change(name, level, *now, 1 - ratio**2, kl))
            before = now
    return tuple(found)


def _moments_of(prior: Prior) -> tuple[float, float]:
    """Mean and standard deviation on the working scale."""
    u = prior.to_u(prior.quantile((np.arange(2000) + 0.5) / 2000))
    return float(u.mean()), float(u.std())


def paired(
    first: Model,
    second: Model,
    rotor: RotorSpec,
    lower: Sequence[Inspection],
    upper: Sequence[Inspection],
    pairs: Mapping[str, str],
) -> tuple[RotorState, RotorState]:
    """The posteriors of two networks whose data correspond one to one.

    lower, upper  readings of the first and of the second model's quantities
    pairs         {known input of the second model: quantity of the first}; each component with an
                  upper reading has one lower reading of that quantity, its value of the input

    Raises InputError for a component without its pair or with several, and for a parameter that
    both networks calibrate: then the posterior does not come apart, and `calibrate` is right.
    """
    both = sorted(_calibrated(first) & _calibrated(second))
    if both:
        raise InputError(
            "parameters",
            both,
            "are calibrated by both networks",
            "stack the models and use calibrate, or make them known in the second",
        )
    ranges = {i.name: i for i in second.surrogate.inputs}
    for name in pairs:
        if second.network.parameter(name).level != "known" or name not in ranges:
            raise InputError("pair", name, "is no known input of the second model", "declare it so")
    known = {b: dict(v) for b, v in (rotor.known or {}).items()}
    for blade in sorted({r.blade for r in upper}):
        for name, quantity in pairs.items():
            found = [r for r in lower if r.blade == blade and r.quantity == quantity]
            if len(found) != 1 or found[0].values.size != 1:
                raise InputError(
                    f"pair of component {blade}",
                    [r.id for r in found],
                    f"is not one value of {quantity}",
                    "give exactly one, or make each pair a component of its own",
                )
            value, own = float(found[0].values.flat[0]), ranges[name]
            if not own.low <= value <= own.high:
                raise RangeError(
                    f"{quantity} of component {blade}",
                    value,
                    f"lies outside {own.low:g} … {own.high:g}, which the second model covers",
                    f"check it, or add training runs over {name}",
                )
            known.setdefault(blade, {})[name] = value
    return update(first, rotor, lower), update(second, replace(rotor, known=known), upper)


def _calibrated(model: Model) -> set[str]:
    """Parameters that the model's readings calibrate, noises as well."""
    physical = {p.name for p in model.network.parameters if p.level in ("local", "shared")}
    return physical | {q.sigma_name for q in model.network.quantities}
