"""3-D scans: thousands of readings that speak about a handful of inputs.

With the deformation modes Phi at the scanned nodes and Phi = Q R, the readings y of a scan split
into z = Q^T y, which depends on the inputs through R c(t; x) E(t; x), and a remainder that depends
on the noise only,

    p(y | x) = N(z | R c E, sigma² I + S) · (2 pi sigma²)^(−nu/2) exp(−RSS / 2 sigma²),

exact for white noise. S is what the simulation itself does not know: the surrogate's covariance in
mode space, and the error of its mesh and polynomials, a share of the deformation that the network
declares (the default mesh is within 0.3 % of a refined one). Without S, 4,000 readings would make
a posterior as sharp as 0.03 mm / sqrt(4000), which no model deserves.

S goes with the inputs: the surrogate's covariance has one shape, R C R^T, and a size E(x)² v(x)
(`core.response`). A turn W of z in which that shape and the rest of the noise, as it is at the best
fit x*, are both diagonal makes the components of W z independent wherever the inputs are,

    W_j z ~ N(W_j R c E, sigma² + extra_j + k_j² E(x)² v(x)),

so that each is a row like any other reading's; the density of z is theirs times |det W|, which no
parameter moves and the evidence needs. All of them are kept. (Five directions, those in
which z varies around x*, and S as it is at x*, moved the posterior of T1T from three scans alone by
half its sd; twelve directions widen it by a tenth where the scan is a poor one.) The errors of a
simulation at two scans of one blade are taken as independent.

A discrepancy (`core.discrepancy`) joins the best fit (`scan_fit`): a constant offset c adds Q^T D c
to z (D repeats x, y, z) and makes the remainder a quadratic, RSS(c) = RSS_0 +
(c − c_0)^T A (c − c_0); a gain leaves the remainder alone and moves z along itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from core.calibration.scan_fit import Shift, best_fit
from core.discrepancy import AXES, Affine, Term, affine, parameters, total
from core.model import Model
from core.monomials import monomials
from core.observation import Inspection
from core.prior import Prior
from core.response import Response

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Dense:
    """Remainder of a scan: least residual sum of squares [unit²] and its degrees of freedom.

    extra         variance beside the noise [unit²]
    turned        log |det W| of the scan's rows: with it the rows' density is that of the readings
    offset        names of a constant offset c; centre (3,) and bend (3, 3): the sum of squares is
                  rss + (c − centre)^T bend (c − centre)
    """

    sigma: str | float
    rss: float
    dof: int
    extra: float = 0.0
    offset: tuple[str, ...] = ()
    centre: Array = field(default_factory=lambda: np.zeros(0))
    bend: Array = field(default_factory=lambda: np.zeros((0, 0)))
    turned: float = 0.0

    def log_density(self, s: Array, c: Array) -> Array:
        """Log density of the remainder at noises s (n,) and offsets c (n, 0 or 3), and `turned`."""
        s2, rss = s**2 + self.extra, self._square(c)
        free = self.dof * np.log(2 * np.pi * s2)
        return np.asarray(self.turned - 0.5 * rss / s2 - 0.5 * free)

    def misfit(self, s: Array, c: Array) -> tuple[Array, Array]:
        """chi²/2 of the remainder at noises s (n,) and offsets c (n, 0 or 3), and its least over
        the offsets, (n,) each."""
        s2 = s**2 + self.extra
        return np.asarray(0.5 * self._square(c) / s2), np.asarray(0.5 * self.rss / s2)

    def _square(self, c: Array) -> Array:
        miss = c - self.centre
        return np.asarray(self.rss + np.einsum("ni,ij,nj->n", miss, self.bend, miss))


@dataclass(frozen=True, slots=True)
class Mixing:
    """A scan's rows as mixtures of the deformation's spatial modes: `turn` @ `modes`.

    modes  R, (Q, B): the same for all scans of the same nodes
    turn   W, (Q, Q): of this scan
    """

    turn: Array
    modes: Array


@dataclass(frozen=True, slots=True)
class ScanRows:
    """A scan as rows: response (Q rows), y (Q,), extra variance (Q,) [unit²], remainder.

    discrepancy   of each row
    mixing        of the rows
    """

    response: Response
    y: Array
    extra: Array
    dense: Dense
    discrepancy: tuple[Affine, ...]
    mixing: Mixing


def scan_rows(
    model: Model,
    reading: Inspection,
    sigma: str | float,
    answer: Callable[[Array], Response],
) -> ScanRows:
    """One scan as rows, one for each of its modes.

    sigma   name of the shared noise, or its known value
    answer  the model's rows for R (Q, B) at the scan's hour, on the boxes of the priors
    """
    assert reading.nodes is not None
    quantity = model.network.quantity(reading.quantity)
    surrogate = model.part(reading.quantity)
    q, r = split_modes(model, reading)
    readings = reading.values.reshape(-1)
    y = q.T @ readings
    seen = [affine(model, quantity, reading.time_h, axis) for axis in range(len(AXES))]
    dense, shift, moved = _split(model, reading, sigma, q, seen)
    response = answer(r)
    noise = _noise_guess(model, reading, dense)

    def share_of(z: Array) -> Array:
        return np.asarray(quantity.numerical**2 * (z**2 + np.mean(z**2)) + dense.extra)

    best, eta = best_fit(response, shift, y, noise, share_of(y))
    (gain,), (offset,) = shift.at(eta[None])
    numerical = share_of(y - offset)
    _, sd = response.evaluate(best[None])
    simulated = shaped(surrogate.mode_covariance(reading.time_h), r, gain * sd[0])
    unknown = simulated + np.diag(numerical) + seen[0].left ** 2 * np.outer(y, y)
    whiten = np.linalg.inv(np.linalg.cholesky(unknown + noise**2 * np.eye(len(y))))
    part, turn = np.linalg.eigh(whiten @ simulated @ whiten.T)
    part = np.clip(part, 0.0, 1.0)  # of a component's variance at x*: the surrogate's
    weight = turn.T @ whiten
    share = np.sqrt(np.sum(weight**2, axis=1))
    weight /= share[:, None]  # a row's noise is sigma² + extra, and the surrogate's
    extra = np.maximum((1.0 - part) / share**2 - noise**2, 0.0)
    dense = replace(dense, turned=float(np.linalg.slogdet(weight)[1]))
    zero = np.zeros(len(weight))
    mixed = Response(
        response.names,
        response.low,
        response.high,
        response.degree,
        weight @ response.a,
        np.tile(response.b[0], (len(weight), 1)),  # one mean CEEQ for the scan's time
        np.sqrt(part) / (share * gain * _scale(response, best)),
        zero,
        response.log_v[:1].repeat(len(weight), axis=0),
    )
    rows = tuple(
        Affine(
            seen[0].gain, tuple((float(k), (c,)) for k, c in zip(row, dense.offset, strict=True))
        )
        for row in weight @ moved
    )
    return ScanRows(mixed, weight @ y, extra, dense, rows, Mixing(weight, r))


def split_modes(model: Model, reading: Inspection) -> tuple[Array, Array]:
    """Q (V, Q) and R (Q, B) of the deformation's modes at a scan's V values."""
    assert reading.nodes is not None
    phi = model.part(reading.quantity).deformation_modes(reading.nodes.tolist())
    q, r = np.linalg.qr(phi.reshape(reading.values.size, -1))
    return q, r


def shaped(covariance: Array, r: Array, sd: Array) -> Array:
    """The surrogate's covariance of z, of its shape (B, B) and z's standard deviations (Q,)."""
    own = r @ covariance @ r.T
    root = sd / np.sqrt(np.maximum(np.diag(own), 1e-300))
    return np.asarray(own * np.outer(root, root))


def doubt(covariance: Array, r: Array, z: Array, sd: Array, numerical: float) -> Array:
    """S (Q, Q): what surrogate and mesh do not know of z (Q,)."""
    return shaped(covariance, r, sd) + np.diag(numerical**2 * (z**2 + np.mean(z**2)))


def _scale(response: Response, x: Array) -> float:
    """E sqrt(v) at x: what the surrogate's error goes with, over the inputs (`core.response`)."""
    basis = monomials(response.scale(x[None]), response.degree)[0]
    return float(np.exp(basis @ response.b[0] + 0.5 * basis @ response.log_v[0]))


def _split(
    model: Model, reading: Inspection, sigma: str | float, q: Array, seen: Sequence[Affine]
) -> tuple[Dense, Shift, Array]:
    """The remainder, the discrepancy of z under its priors, and Q^T D (J, 0 or 3)."""
    quantity = model.network.quantity(reading.quantity)
    readings = reading.values.reshape(-1)
    y = q.T @ readings
    rss, dof = max(float(readings @ readings - y @ y), 0.0), readings.size - y.size
    priors = parameters(model, quantity) | {p.name: p.prior for p in model.network.parameters}
    extra = seen[0].sigma ** 2
    zero = np.zeros(len(y))
    none = np.zeros((len(y), 0))
    if not seen[0].offset:
        gain = _moments(seen[0].gain, priors)
        shift = Shift((1 + gain[0], gain[1]), zero, none, np.zeros((0, 0)), np.zeros(0))
        return Dense(sigma, rss, dof, extra), shift, none
    names = tuple(name for one in seen for _, (name,) in one.offset)
    mean, sd = np.array([_moments(one.offset, priors) for one in seen]).T
    repeat = np.tile(np.eye(len(AXES)), (reading.values.shape[0], 1))
    moved = q.T @ repeat
    across = repeat - q @ moved
    bend = across.T @ across
    centre = np.asarray(np.linalg.lstsq(across, readings - q @ y, rcond=1e-6)[0], float)
    rss = float(np.sum((readings - q @ y - across @ centre) ** 2))
    value, vector = np.linalg.eigh(bend)
    root = np.sqrt(np.maximum(value, 0.0))[:, None] * vector.T
    shift = Shift((1.0, 0.0), moved @ mean, moved * sd, root * sd, root @ (centre - mean))
    return Dense(sigma, rss, dof, extra, names, centre, bend), shift, moved


def _moments(terms: Sequence[Term], priors: Mapping[str, Prior]) -> tuple[float, float]:
    """Mean and standard deviation of a sum of terms under the priors, by 4,096 draws."""
    rng = np.random.default_rng(0)
    names = sorted({name for _, several in terms for name in several})
    draws = {name: priors[name].quantile(rng.random(4096)) for name in names}
    values = total(terms, draws.__getitem__)
    return float(np.mean(values)), float(np.std(values))


def _noise_guess(model: Model, reading: Inspection, dense: Dense) -> float:
    if not isinstance(dense.sigma, str):
        return float(dense.sigma)
    if dense.dof > 20:
        return math.sqrt(max(dense.rss / dense.dof, 1e-12))
    return float(model.network.quantity(reading.quantity).sigma_obs.quantile(np.array(0.5)))
