"""Where a surrogate has to be accurate: the posterior of a rotor's blades.

Each blade gives equally many draws of its local and the rotor's shared parameters, so that a blade
without readings counts as one with many: both are predicted. Known inputs are each blade's own,
dormant ones stay at their nominal value.

`from_readings` calibrates anew on every surrogate that it is asked about. The likelihood counts the
surrogate's own variance, so that the region is wide while the surrogate is poor and narrows as it
learns. A calibration that fails is no reason to stop: the region is then the prior, and says so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from core.calibration.online import update
from core.calibration.state import RotorSpec, RotorState, blade_posterior
from core.design import Region
from core.design.region import sobol
from core.errors import CalibrationError, InputError
from core.model import Model
from core.network import Network
from core.observation import Inspection
from core.rng import seed_of, stream
from core.surrogate.artefact import digest_of
from core.surrogate.model import Surrogate
from core.surrogate.refine import Regions

Array = NDArray[np.float64]
Known = Mapping[str, Mapping[str, float]]
DRAWS = 512  # of all blades together
PARTICLES = 2000


def columns(
    network: Network,
    names: Sequence[str],
    drawn: Mapping[str, Array],
    count: int,
    known: Mapping[str, float],
    blade: str,
) -> Array:
    """Inputs (count, d) in the order of `names`: drawn, known of the blade, or nominal.

    Raises InputError for an input that has no value.
    """
    made = []
    for name in names:
        if name in drawn:
            made.append(drawn[name])
            continue
        declared = {p.name: p for p in network.parameters}.get(name)
        value = known.get(name, None if declared is None else declared.nominal)
        if value is None:
            problem = f"is an input of the runs and has no value for blade {blade}"
            remedy = "give it as a known input, or declare it in the network"
            raise InputError(name, None, problem, remedy)
        made.append(np.full(count, float(value)))
    return np.stack(made, axis=1)


def of_state(
    model: Model, rotor: RotorSpec, state: RotorState, names: Sequence[str], count: int = DRAWS
) -> Region:
    """Draws of all blades of a state, `count` or a few more, with even weights."""
    each, get = -(-count // len(rotor.blades)), state.arrays.__getitem__
    rows = []
    for blade in rotor.blades:
        found = blade_posterior(state.meta, get, blade)
        rng = stream(rotor.seed, "region", rotor.id, blade)
        psi = found.particles.resampled(each, rng).psi
        drawn = dict(zip(found.names, psi.T, strict=True))
        known = (rotor.known or {}).get(blade, {})
        rows.append(columns(model.network, names, drawn, each, known, blade))
    return Region.of(np.vstack(rows))


def of_prior(network: Network, names: Sequence[str], seed: int = 0, count: int = DRAWS) -> Region:
    """Points even in the priors' quantiles; inputs that are dormant at their nominal value."""
    free = [p for p in network.parameters if p.name in names and p.level != "dormant"]
    unit = sobol(count, np.zeros(len(free)), np.ones(len(free)), seed_of(seed, "prior"))
    drawn = {p.name: p.prior.quantile(unit[:, j]) for j, p in enumerate(free)}
    return Region.of(columns(network, names, drawn, count, {}, "any"))


def prior_regions(network: Network, seed: int = 0) -> Regions:
    """The prior, whatever the surrogate."""

    def regions(surrogate: Surrogate) -> tuple[Region, str]:
        return of_prior(network, [i.name for i in surrogate.inputs], seed), "prior"

    return regions


def from_readings(
    network: Network,
    blades: Sequence[str],
    readings: Sequence[Inspection],
    *,
    known: Known | None = None,
    particles: int = PARTICLES,
    seed: int = 0,
) -> Regions:
    """The posterior by each surrogate in turn, of a rotor with these blades and readings.

    Raises InputError for what the network cannot use.
    """
    rotor = RotorSpec("refinement", tuple(blades), particles, seed, known)

    def regions(surrogate: Surrogate) -> tuple[Region, str]:
        names = [i.name for i in surrogate.inputs]
        model = Model.of(network, replace(surrogate, digest=digest_of(surrogate)))
        try:
            state = update(model, rotor, readings)
        except CalibrationError as error:
            return of_prior(network, names, seed), f"prior, for nothing can be calibrated: {error}"
        words = f"posterior of {len(blades)} blades, {len(readings)} readings"
        return of_state(model, rotor, state, names), words

    return regions
