"""What each particle of a blade's posterior says of a quantity over the hours.

A prediction, a life and a residual all rest on these: the surrogate's mean and standard deviation
at the particle's parameters, its discrepancy (`core.discrepancy`), and its noise. A parameter that
nobody measured yet keeps its prior, spread over the particles by a Kronecker sequence.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.calibration.space import nominal
from core.calibration.state import Posterior
from core.discrepancy import affine, parameters, total
from core.errors import InputError, RangeError
from core.model import Model
from core.network import Quantity
from core.prior import Prior

Array = NDArray[np.float64]
# fractional parts of roots: golden, 2, 3, 7, 11, 13, 17
IRRATIONAL = tuple(float(v) for v in (0.6180339887498949, *(np.sqrt([2, 3, 7, 11, 13, 17]) % 1.0)))
SPAN = 128  # hours at once: 4 MB for each array of 4,000 particles
ENOUGH = 4000  # particles that a prediction rests on; more move a quantile by < 0.02 sd


def inputs_of(
    model: Model, posterior: Posterior, quantity: str, known: Mapping[str, float] | None = None
) -> Array:
    """Inputs of the surrogate that answers for `quantity`, for each particle, (N, d)."""
    names = [i.name for i in model.part(quantity).inputs]
    fixed = nominal(model, names, known)
    n = len(posterior.particles.log_w)
    return np.stack(
        [np.full(n, fixed[name]) if name in fixed else posterior.column(name) for name in names],
        axis=1,
    )


def spread(prior: Prior, n: int, place: int) -> Array:
    """n values for the prior of what nobody measured yet: strata by a Kronecker sequence.

    place   number of the parameter; those of other numbers are spread independently
    """
    return prior.quantile(np.asarray((np.arange(n) * IRRATIONAL[place] + 0.5) % 1.0, float))


def instrument_of(posterior: Posterior, quantity: Quantity) -> str | None:
    """The instrument whose noise is known best, which is to say: the one with most readings.

    None where readings named none, or the quantity has one noise for all.
    """
    of_each = f"{quantity.sigma_name}@"
    w = posterior.particles.w

    def doubt(name: str) -> float:
        log = np.log(posterior.column(name))
        return float(w @ (log - w @ log) ** 2)

    met = [n for n in posterior.names if n == quantity.sigma_name or n.startswith(of_each)]
    best = min(met, key=doubt, default=quantity.sigma_name)
    return best.removeprefix(of_each) if best != quantity.sigma_name else None


def noise_of(
    model: Model, posterior: Posterior, quantity: str, instrument: str | None = None
) -> Array:
    """sigma_obs of each particle; a noise that nobody measured yet keeps its prior (N,)."""
    declared = model.network.quantity(quantity)
    name = declared.sigma_of(instrument)
    if name in posterior.names:
        return posterior.column(name)
    return spread(declared.sigma_obs, len(posterior.particles.log_w), 0)


def corrected(
    model: Model,
    posterior: Posterior,
    quantity: Quantity,
    time: Array,
    component: int | None,
    reader: tuple[str | None, str | None] | None = None,
) -> tuple[Array, Array, Array, Array]:
    """Gain and offset of each particle (N, T), sigma_delta (T,) [unit] and r (T,) [1]."""
    n = len(posterior.particles.log_w)
    priors = parameters(model, quantity)
    values = {
        name: posterior.column(name) if name in posterior.names else spread(prior, n, 1 + place)
        for place, (name, prior) in enumerate(priors.items())
    }

    def value(name: str) -> Array:
        return values[name] if name in values else posterior.column(name)

    gain, offset = np.ones((n, time.size)), np.zeros((n, time.size))
    sigma, left = np.zeros(time.size), np.zeros(time.size)
    for i, t in enumerate(time):
        one = affine(model, quantity, float(t), component, reader)
        gain[:, i] += total(one.gain, value)
        offset[:, i] += total(one.offset, value)
        sigma[i], left[i] = one.sigma, one.left
    return gain, offset, sigma, left


@dataclass(frozen=True, slots=True)
class Curves:
    """What each particle says of a quantity over time, without a reading's noise; all (N, T).

    model   the surrogate's mean; mean, with the discrepancy
    sd      of the surrogate and the mesh, beside `mean`; left: of the discrepancy
    """

    model: Array
    mean: Array
    sd: Array
    left: Array

    @property
    def width(self) -> Array:
        """sd of both."""
        return np.asarray(np.hypot(self.sd, self.left))


def spans(time: Array) -> list[Array]:
    """Hours (T,) in parts of at most `SPAN`: what is held of (particles, hours) at once.

    >>> [len(part) for part in spans(np.arange(200.0))]
    [128, 72]
    """
    return [time[i : i + SPAN] for i in range(0, time.size, SPAN)]


def checked_times(model: Model, quantity: str, times: Sequence[float] | Array) -> Array:
    """Times (T,) [h] inside the model's horizon; RangeError."""
    time = np.atleast_1d(np.asarray(times, float))
    horizon_h = model.part(quantity).horizon_h
    if time.size == 0 or not np.all((time >= 0) & (time <= horizon_h)):
        raise RangeError(
            "times",
            time.tolist()[:5],
            f"are not all within 0 … {horizon_h:g} h",
            "ask for times that the model covers",
        )
    return time


def curves(
    model: Model,
    posterior: Posterior,
    quantity: str,
    time: Array,
    node: int | None = None,
    component: int | None = None,
    known: Mapping[str, float] | None = None,
    reader: tuple[str | None, str | None] | None = None,
) -> Curves:
    """The curves of the particles of `posterior`; options as of `predict`."""
    declared, surrogate = model.network.quantity(quantity), model.part(quantity)
    nodes = None
    if declared.kind != "scalar":
        if node is None:
            node = declared.node_among(surrogate.named)
        if not 0 <= node < surrogate.node_count:
            raise RangeError(
                "node", node, f"does not exist: 0 … {surrogate.node_count - 1}", "name a node"
            )
        nodes = [node]
    if declared.kind == "vector" and component not in (0, 1, 2):
        raise InputError("component", component, "is none of 0, 1, 2", "choose x, y or z")
    mean, sd = surrogate.predict(
        inputs_of(model, posterior, quantity, known), quantity, time, nodes
    )
    if declared.kind == "field":
        mean, sd = mean[:, :, 0], sd[:, :, 0]
    elif declared.kind == "vector":
        mean, sd = mean[:, :, 0, component], sd[:, :, 0, component]
    gain, offset, sigma_delta, left = corrected(model, posterior, declared, time, component, reader)
    return Curves(
        mean,
        gain * mean + offset,
        gain * np.hypot(sd, declared.numerical * mean),
        np.hypot(sigma_delta, left * gain * mean),
    )


def thinned(posterior: Posterior) -> Posterior:
    """At most ENOUGH equally weighted particles, by systematic resampling from a fixed stream."""
    if len(posterior.particles.log_w) <= ENOUGH:
        return posterior
    return Posterior(
        posterior.names, posterior.particles.resampled(ENOUGH, np.random.default_rng(0))
    )
