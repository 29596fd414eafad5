"""Predictions with their uncertainty split by source.

With particles (psi_i, w_i) of a blade's posterior and the surrogate's mean Y_m and standard
deviation s,

    mean   = Σ w_i Y_m(t; psi_i)
    total² = Var_w(Y_m) + Σ w_i s(t; psi_i)² + sigma_delta² + Σ w_i sigma_obs,i²
             parameters   surrogate            discrepancy   noise of one more reading

(the surrogate's part holds the simulation's numerical error, too),

so the squares of the sources add up to the square of the total. Quantiles and bounds are those
of the mixture of normals Σ w_i N(Y_m,i, s_i² + sigma_i²), not of a fitted bell: they are the bounds
between which a *reading* falls with the stated probability. Whoever wants the band of the blade
itself, without the instrument, asks for ``noise=False``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from core.calibration.state import Posterior
from core.calibration.target import nominal
from core.errors import InputError, RangeError
from core.model import Model

Array = NDArray[np.float64]
SOURCES = ("parameters", "surrogate", "discrepancy", "noise", "total")
QUANTILES = (0.025, 0.05, 0.16, 0.5, 0.84, 0.95, 0.975)
ENOUGH = 4000  # particles that a prediction rests on; more move a quantile by < 0.02 sd


@dataclass(frozen=True, slots=True)
class Prediction:
    """One quantity of one blade at T times.

    mean, lower, upper (T,) and each sd by source (T,) in `unit`; quantiles {p: (T,)}.
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


def noise_of(model: Model, posterior: Posterior, quantity: str) -> Array:
    """sigma_obs of each particle; a noise that nobody measured yet keeps its prior (N,)."""
    declared = model.network.quantity(quantity)
    if declared.sigma_name in posterior.names:
        return posterior.column(declared.sigma_name)
    n = len(posterior.particles.log_w)
    spread = (np.arange(n) * 0.6180339887498949 + 0.5) % 1.0  # golden-ratio strata
    return declared.sigma_obs.quantile(np.asarray(spread, float))


GROUPS = 160


def mixture_quantiles(mean: Array, sd: Array, w: Array, p: Array) -> Array:
    """Quantiles of Σ w_i N(mean_i, sd_i²), shape (len(p), T); mean and sd (n, T).

    Components are sorted by mean and merged into groups of equal weight that keep mean and
    variance; then the distribution function is bisected inside a bracket that holds them all.

    >>> one = mixture_quantiles(np.zeros((1, 1)), np.ones((1, 1)), np.ones(1), np.array([0.975]))
    >>> round(float(one[0, 0]), 4)
    1.96
    """
    n, t = mean.shape
    if n > GROUPS:
        order = np.argsort(mean, axis=0, kind="stable")
        share = w[order]
        group = np.minimum((np.cumsum(share, axis=0) * GROUPS).astype(np.int64), GROUPS - 1)
        flat = (group + GROUPS * np.arange(t)).ravel()
        m = np.take_along_axis(mean, order, axis=0)
        second = m**2 + np.take_along_axis(sd, order, axis=0) ** 2

        def gather(values: Array) -> Array:
            sums = np.bincount(flat, values.ravel(), GROUPS * t)
            return np.asarray(sums.reshape(t, GROUPS).T, float)

        mass = gather(share)
        safe = np.maximum(mass, 1e-300)
        mean = gather(share * m) / safe
        sd = np.sqrt(np.maximum(gather(share * second) / safe - mean**2, 0.0))
    else:
        mass = np.repeat(w[:, None], t, axis=1)
    sd = np.maximum(sd, 1e-300)
    here = mass > 0
    low = np.tile(np.min(np.where(here, mean - 9 * sd, np.inf), axis=0), (len(p), 1))
    high = np.tile(np.max(np.where(here, mean + 9 * sd, -np.inf), axis=0), (len(p), 1))
    for _ in range(32):
        mid = 0.5 * (low + high)
        f = np.einsum("pgt,gt->pt", ndtr((mid[:, None, :] - mean) / sd), mass)
        above = f < p[:, None]
        low, high = np.where(above, mid, low), np.where(above, high, mid)
    return np.asarray(0.5 * (low + high))


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
    known: Mapping[str, float] | None = None,
) -> Prediction:
    """Predict `quantity` at `times` [h] from a blade's posterior.

    node        for fields: the node (default: the quantity's own)
    component   for 3-D deformation: 0, 1, 2 for x, y, z
    Raises RangeError for times or nodes outside the model, InputError for a bad probability.
    """
    declared, surrogate = model.network.quantity(quantity), model.part(quantity)
    if not 0 < probability < 1:
        raise InputError("probability", probability, "lies outside 0 … 1", "give 0.95, say")
    time = np.atleast_1d(np.asarray(times, float))
    if time.size == 0 or not np.all((time >= 0) & (time <= surrogate.horizon_h)):
        raise RangeError(
            "times",
            time.tolist()[:5],
            f"are not all within 0 … {surrogate.horizon_h:g} h",
            "ask for times that the model covers",
        )
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
    thin = _thinned(posterior)
    w = thin.particles.w
    mean, sd = surrogate.predict(inputs_of(model, thin, quantity, known), quantity, time, nodes)
    if declared.kind == "field":
        mean, sd = mean[:, :, 0], sd[:, :, 0]
    elif declared.kind == "vector":
        mean, sd = mean[:, :, 0, component], sd[:, :, 0, component]
    sd = np.hypot(sd, declared.numerical * mean)
    sigma = noise_of(model, thin, quantity) if noise else np.zeros(len(w))
    centre = w @ mean
    parts = {
        "parameters": np.sqrt(w @ (mean - centre) ** 2),
        "surrogate": np.sqrt(w @ sd**2),
        "discrepancy": np.zeros(time.size),
        "noise": np.full(time.size, np.sqrt(w @ sigma**2)),
    }
    parts["total"] = np.sqrt(sum(v**2 for v in parts.values()))
    tail = (1 - probability) / 2
    p = np.array([tail, 1 - tail, *QUANTILES])
    q = mixture_quantiles(mean, np.sqrt(sd**2 + sigma[:, None] ** 2), w, p)
    return Prediction(
        quantity,
        declared.unit,
        time,
        centre,
        parts,
        q[0],
        q[1],
        probability,
        {float(k): v for k, v in zip(QUANTILES, q[2:], strict=True)},
        len(w),
    )


def _thinned(posterior: Posterior) -> Posterior:
    """At most ENOUGH equally weighted particles, by systematic resampling from a fixed stream."""
    if len(posterior.particles.log_w) <= ENOUGH:
        return posterior
    return Posterior(
        posterior.names, posterior.particles.resampled(ENOUGH, np.random.default_rng(0))
    )
