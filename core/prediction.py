"""Predictions with their uncertainty split by source.

With particles (psi_i, w_i) of a blade's posterior, the surrogate's mean Y_m and standard deviation
s, and the discrepancy delta_i = (g_i − 1) Y_m,i + o_i of each particle (`core.discrepancy`),

    mean   = Σ w_i (Y_m(t; psi_i) + delta_i)
    total² = Var_w((1 + b) Y_m) + Σ w_i g_i² s_i² + Var_w(r) + sigma_delta² + Σ w_i sigma_obs,i²
             parameters           surrogate         discrepancy               one more reading

where delta_i = a + b Y_m,i + r_i by weighted least squares: what of the discrepancy goes with the
model's own answer counts as the parameters', the rest as its own. As r is uncorrelated with Y_m,
the first and third term are exactly Var_w(Y_m + delta),
so the squares of the sources add up to the square of the total. Quantiles and bounds are those
of the mixture of normals Σ w_i N(Y_m,i + delta_i, g_i² s_i² + sigma_delta² + sigma_i²), not of a
fitted bell (`core.mixture`): the bounds between which a *reading* falls with the stated
probability.
Whoever wants the band of the blade itself, without the instrument, asks for ``noise=False``.
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
from core.mixture import mixture_quantiles
from core.model import Model
from core.network import Quantity
from core.prior import Prior

Array = NDArray[np.float64]
SOURCES = ("parameters", "surrogate", "discrepancy", "noise", "total")
QUANTILES = (0.025, 0.05, 0.16, 0.5, 0.84, 0.95, 0.975)
# fractional parts of roots: golden, 2, 3, 7, 11, 13, 17
IRRATIONAL = tuple(float(v) for v in (0.6180339887498949, *(np.sqrt([2, 3, 7, 11, 13, 17]) % 1.0)))
ENOUGH = 4000  # particles that a prediction rests on; more move a quantile by < 0.02 sd


@dataclass(frozen=True, slots=True)
class Prediction:
    """One quantity of one blade at T times.

    mean, lower, upper (T,) and each sd by source (T,) in `unit`; quantiles {p: (T,)}.
    instrument  whose noise the reading has, where noises are by instrument
    """

    quantity: str
    unit: str
    time_h: Array
    mean: Array
    sd: Mapping[str, Array]
    lower: Array
    upper: Array
    probability: float
    quantiles: Mapping[float, Array]
    particles: int
    instrument: str | None = None


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


def split_variance(mean: Array, delta: Array, w: Array) -> tuple[Array, Array]:
    """Var_w(mean + delta) (T,) as what goes with `mean` and what does not; both (n, T).

    >>> y, w = np.array([[0.0], [1.0], [2.0]]), np.ones(3) / 3
    >>> [v.round(9).tolist() for v in split_variance(y, 0.5 * y, w)]
    [[1.5], [0.0]]
    """
    centred, apart = mean - w @ mean, delta - w @ delta
    variance = w @ centred**2
    slope = (w @ (centred * apart)) / np.where(variance > 0, variance, 1.0)
    return (1 + slope) ** 2 * variance, w @ (apart - slope * centred) ** 2


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
            node = surrogate.named[declared.node or "tip"]
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


def predict(
    model: Model,
    posterior: Posterior,
    quantity: str,
    times: Sequence[float] | Array,
    node: int | None = None,
    probability: float = 0.95,
    *,
    component: int | None = None,
    noise: bool = True,
    instrument: str | None = None,
    known: Mapping[str, float] | None = None,
    reader: tuple[str | None, str | None] | None = None,
    sigma: float | None = None,
    levels: Sequence[float] = QUANTILES,
) -> Prediction:
    """Predict `quantity` at `times` [h] from a blade's posterior.

    node        for fields: the node (default: the quantity's own)
    component   for 3-D deformation: 0, 1, 2 for x, y, z
    noise       False: the blade itself, without one more reading's noise
    instrument  of that reading (default: `instrument_of`); a new one has its prior's noise
    sigma       noise of that reading where it is known [unit]; None: as calibrated
    levels      of the quantiles beside the bounds
    reader      (instrument, campaign): what their reading says, with their biases; None: the
                blade itself
    Raises RangeError for times or nodes outside the model, InputError for a bad probability and
    for an instrument where readings have one noise for all.
    """
    declared = model.network.quantity(quantity)
    if not 0 < probability < 1:
        raise InputError("probability", probability, "lies outside 0 … 1", "give 0.95, say")
    declared.check_instrument(instrument)
    thin = thinned(posterior)
    w = thin.particles.w
    time = checked_times(model, quantity, times)
    one = curves(model, thin, quantity, time, node, component, known, reader)
    if instrument is None and noise and sigma is None:
        instrument = instrument_of(thin, declared)
    own_noise = np.zeros(len(w))
    if noise:
        if sigma is None:
            own_noise = noise_of(model, thin, quantity, instrument)
        else:
            own_noise += sigma
    by_parameters, by_discrepancy = split_variance(one.model, one.mean - one.model, w)
    parts = {
        "parameters": np.sqrt(by_parameters),
        "surrogate": np.sqrt(w @ one.sd**2),
        "discrepancy": np.sqrt(by_discrepancy + w @ one.left**2),
        "noise": np.full(time.size, np.sqrt(w @ own_noise**2)),
    }
    parts["total"] = np.sqrt(sum(v**2 for v in parts.values()))
    tail = (1 - probability) / 2
    p = np.array([tail, 1 - tail, *levels])
    q = mixture_quantiles(one.mean, np.hypot(one.width, own_noise[:, None]), w, p)
    return Prediction(
        quantity,
        declared.unit,
        time,
        w @ one.mean,
        parts,
        q[0],
        q[1],
        probability,
        {float(k): v for k, v in zip(levels, q[2:], strict=True)},
        len(w),
        instrument,
    )
