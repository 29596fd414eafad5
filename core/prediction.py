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

from core.calibration.state import Posterior
from core.curves import checked_times, curves, instrument_of, noise_of, spans, thinned
from core.errors import InputError
from core.mixture import mixture_quantiles
from core.model import Model

Array = NDArray[np.float64]
SOURCES = ("parameters", "surrogate", "discrepancy", "noise", "total")
QUANTILES = (0.025, 0.05, 0.16, 0.5, 0.84, 0.95, 0.975)


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
    instrument  of that reading (default: its reader's, else `instrument_of`); a new one has its
                prior's noise
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
    if instrument is None and noise and sigma is None:
        if reader is None:
            instrument = instrument_of(thin, declared)
        elif declared.by_instrument:
            instrument = reader[0]
    own_noise = np.zeros(len(w))
    if noise:
        if sigma is None:
            own_noise = noise_of(model, thin, quantity, instrument)
        else:
            own_noise += sigma
    tail = (1 - probability) / 2
    p = np.array([tail, 1 - tail, *levels])

    def told(at: Array) -> tuple[Array, dict[str, Array], Array]:
        one = curves(model, thin, quantity, at, node, component, known, reader)
        by_parameters, by_discrepancy = split_variance(one.model, one.mean - one.model, w)
        parts = {
            "parameters": np.sqrt(by_parameters),
            "surrogate": np.sqrt(w @ one.sd**2),
            "discrepancy": np.sqrt(by_discrepancy + w @ one.left**2),
            "noise": np.full(at.size, np.sqrt(w @ own_noise**2)),
        }
        parts["total"] = np.sqrt(sum(v**2 for v in parts.values()))
        q = mixture_quantiles(one.mean, np.hypot(one.width, own_noise[:, None]), w, p)
        return w @ one.mean, parts, q

    means, sds, qs = zip(*map(told, spans(time)), strict=True)
    q = np.concatenate(qs, axis=1)
    return Prediction(
        quantity,
        declared.unit,
        time,
        np.concatenate(means),
        {name: np.concatenate([sd[name] for sd in sds]) for name in sds[0]},
        q[0],
        q[1],
        probability,
        {float(k): v for k, v in zip(levels, q[2:], strict=True)},
        len(w),
        instrument,
    )
