"""3-D scans: thousands of readings that speak about a handful of inputs.

With the deformation modes Phi at the scanned nodes and Phi = Q R, the readings y of a scan split
into z = Q^T y, which depends on the inputs through R c(t; x) E(t; x), and a remainder that depends
on the noise only,

    p(y | x) = N(z | R c E, sigma² I + S) · (2 pi sigma²)^(−nu/2) exp(−RSS / 2 sigma²),

exact for white noise. S is what the simulation itself does not know: the surrogate's covariance in
mode space, and the error of its mesh and polynomials, a share of the deformation that the network
declares (the default mesh is within 0.3 % of a refined one). Without S, 4,000 readings would make
a posterior as sharp as 0.03 mm / sqrt(4000), which no model deserves.

The two dozen components of z are still more than the inputs need. Around the best fit x* (noise
sigma_0 from the remainder), the whitened components vary along a few directions only: the left
singular vectors U of their variation over the neighbourhood that the noise leaves open, five
standard deviations wide. Components along U keep the information; those across it hold none near
x* and leave. A row is scaled so that its noise is sigma² + extra. All of it is a function of the
scan alone. The errors of a simulation at two scans of one blade are taken as independent.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import qmc

from core.model import Model
from core.observation import Inspection
from core.response import Response

Array = NDArray[np.float64]
DIRECTIONS = 5
STARTS, SAMPLE = 4096, 400


@dataclass(frozen=True, slots=True)
class Dense:
    """Remainder of a scan: residual sum of squares [unit²] and its degrees of freedom."""

    sigma: str | float
    rss: float
    dof: int


@dataclass(frozen=True, slots=True)
class ScanRows:
    """A scan as rows: response (Q rows), y (Q,), extra variance (Q,) [unit²], remainder."""

    response: Response
    y: Array
    extra: Array
    dense: Dense


def scan_rows(
    model: Model,
    reading: Inspection,
    sigma: str | float,
    boxed: Callable[[Response], Response],
    degree: int,
) -> ScanRows:
    """One scan as a few rows, at most DIRECTIONS.

    sigma   name of the shared noise, or its known value
    boxed   brings a response to the boxes of the priors
    """
    assert reading.nodes is not None
    surrogate = model.part(reading.quantity)
    phi = surrogate.deformation_modes(reading.nodes.tolist())
    q, r = np.linalg.qr(phi.reshape(reading.values.size, -1))
    readings = reading.values.reshape(-1)
    y = q.T @ readings
    dense = Dense(sigma, max(float(readings @ readings - y @ y), 0.0), readings.size - y.size)
    response = boxed(surrogate.mode_response(reading.time_h, r, degree=degree))
    noise = _noise_guess(model, reading, dense)
    numerical = model.network.quantity(reading.quantity).numerical ** 2 * (y**2 + np.mean(y**2))
    best = _best_fit(response, y, noise, numerical)
    sd = response.evaluate(best[None])[1]
    # the surrogate's error in z is correlated: R C R^T, scaled to its sd at the best fit
    covariance = r @ surrogate.mode_covariance(reading.time_h) @ r.T
    root = sd[0] / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    unknown = covariance * np.outer(root, root) + np.diag(numerical)
    whiten = np.linalg.inv(np.linalg.cholesky(unknown + noise**2 * np.eye(len(y))))
    weight = _directions(response, best, whiten).T @ whiten  # (Q, J)
    share = np.sqrt(np.sum(weight**2, axis=1))
    weight /= share[:, None]  # a row's noise is sigma² + extra
    extra = np.maximum(1.0 / share**2 - noise**2, 0.0)
    zero = np.zeros(len(weight))
    mixed = Response(
        response.names,
        response.low,
        response.high,
        response.degree,
        weight @ response.a,
        np.tile(response.b[0], (len(weight), 1)),  # one mean CEEQ for the scan's time
        zero,
        zero,
        np.zeros((len(weight), response.a.shape[1])),
    )
    return ScanRows(mixed, weight @ y, extra, dense)


def _noise_guess(model: Model, reading: Inspection, dense: Dense) -> float:
    if not isinstance(dense.sigma, str):
        return float(dense.sigma)
    if dense.dof > 20:
        return math.sqrt(max(dense.rss / dense.dof, 1e-12))
    return math.exp(0.5 * sum(model.network.quantity(reading.quantity).sigma_obs.box))


def _best_fit(response: Response, y: Array, noise: float, numerical: Array) -> Array:
    """Inputs that fit best, by least squares from the best of many starts."""
    d = len(response.names)
    start = qmc.Sobol(d, scramble=True, rng=np.random.default_rng(0)).random(STARTS)
    x = response.low + start * (response.high - response.low)
    mean, sd = response.evaluate(x)
    score = np.sum(
        (mean - y) ** 2 / (noise**2 + numerical + sd**2) + np.log(noise**2 + numerical + sd**2),
        axis=1,
    )
    weights = 1.0 / np.sqrt(noise**2 + numerical)

    def miss(unit: Array) -> Array:
        at = response.low + unit * (response.high - response.low)
        return np.asarray((response.evaluate(at[None])[0][0] - y) * weights)

    fits = [
        least_squares(miss, np.clip(start[i], 1e-6, 1 - 1e-6), bounds=(0, 1), max_nfev=40)
        for i in np.argsort(score)[:3]
    ]
    best = min(fits, key=lambda f: f.cost)
    return np.asarray(response.low + best.x * (response.high - response.low))


def _directions(response: Response, best: Array, whiten: Array) -> Array:
    """Orthonormal directions (J, Q) along which the whitened rows vary around the best fit."""
    d = len(best)
    half = 0.5 * (response.high - response.low)

    def whitened(unit: Array) -> Array:
        inside = np.clip(best + unit * half, response.low, response.high)
        return np.asarray(response.evaluate(inside)[0] @ whiten.T)

    step = 1e-4 * np.eye(d)
    jacobian = (whitened(step) - whitened(-step)).T / 2e-4
    _, s, turn = np.linalg.svd(jacobian, full_matrices=False)
    spread = np.minimum(5.0 / np.maximum(s, 1e-9), 2.0)
    cloud = np.random.default_rng(0).standard_normal((SAMPLE, len(s))) * spread @ turn
    values = whitened(cloud)
    u, _, _ = np.linalg.svd((values - values.mean(axis=0)).T, full_matrices=False)
    return np.asarray(u[:, : min(DIRECTIONS, len(whiten))])
