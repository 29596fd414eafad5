"""What the model gets wrong: the discrepancy of a quantity, switchable in the network.

Kennedy & O'Hagan (2001) and the paper (Eqs. 3-4) write a reading as

    y = Y_m(t; l, s) + delta + epsilon,   epsilon ~ N(0, sigma_obs²).

Every kind here is affine in the model,

    y = g(s, t) Y_m + o(s) + N(0, sigma_obs² + sigma_delta² + (g Y_m r(t))²),

with a gain g = 1 + Σ and an offset o that are sums of shared parameters theta, so the likelihood of
y is that of (y − o) / g under the model alone, over |g|, and theta are inferred with T1T and the
noise on the shared level:

    constant   o = c (for a vector: c_x, c_y, c_z)
    paper      g = 1 + theta1 − theta2 psi, sigma_delta = 1e-5   (Sec. 4: delta ~ N(Y_m (theta1 −
               theta2 psi), sigma_delta²))
    gp         g = 1 + f(t), f ~ GP(0, sd² exp(−(t − t')² / 2 length²)) over operating hours

Where the data hold psi nearly constant, theta1 and theta2 are one parameter in two: their posterior
is a ridge along theta1 = theta2 psi + const, as wide as the priors let it be. delta itself is not
affected. A gain that multiplies a model whose own parameters scale it is known no better than their
priors say; a constant offset is told from them by readings at several times (Arendt, Apley & Chen
2012).

f is a sum of its Karhunen–Loève modes on [0, horizon] (Nyström's method with Gauss–Legendre nodes),

    f(t) = Σ_k theta_k sqrt(lambda_k) phi_k(t),   theta_k ~ N(0, 1),

as many as hold `HELD` of the variance at every t (holding it of the integral alone would leave most
at the ends). What the cut modes leave, r(t)² = sd² − Σ lambda_k phi_k(t)², counts as independent
from reading to reading. Priors are cut at `WIDTH` standard deviations, and no prior may let g fall
below `LEAST_GAIN`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError
from core.model import Model
from core.network import LEAST_GAIN, WIDTH, Quantity
from core.prior import Prior

Array = NDArray[np.float64]
Term = tuple[float, tuple[str, ...]]
HELD, MOST_MODES, NODES = 0.995, 6, 96
AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Affine:
    """How one reading sees the model through the discrepancy.

    gain, offset  terms (coefficient, names of the shared parameters it multiplies); the gain is
                  1 plus its terms
    sigma         sigma_delta, independent from reading to reading [unit]
    left          r(t), relative to the corrected model
    """

    gain: tuple[Term, ...] = ()
    offset: tuple[Term, ...] = ()
    sigma: float = 0.0
    left: float = 0.0

    @property
    def names(self) -> frozenset[str]:
        return frozenset(n for _, names in (*self.gain, *self.offset) for n in names)


NONE = Affine()


@dataclass(frozen=True, slots=True)
class Modes:
    """Karhunen–Loève modes of a unit-variance process on [0, 1], at quadrature nodes (NODES,).

    weight (NODES,); value (NODES, k) holds phi_k, eigenvalue (k,) lambda_k, largest first.
    """

    length: float
    node: Array
    weight: Array
    value: Array
    eigenvalue: Array

    def at(self, t: Array) -> Array:
        """sqrt(lambda_k) phi_k at t (n,): (n, k)."""
        kernel = np.exp(-0.5 * ((t[:, None] - self.node) / self.length) ** 2)
        return np.asarray((kernel * self.weight) @ self.value / np.sqrt(self.eigenvalue))


@lru_cache(maxsize=64)
def modes(length: float) -> Modes:
    """Modes of a process with this length, as a share of the horizon, that hold `HELD`.

    >>> len(modes(0.5).eigenvalue), len(modes(2.0).eigenvalue)
    (4, 2)
    """
    x, w = np.polynomial.legendre.leggauss(NODES)
    node, weight = 0.5 * (x + 1), 0.5 * w
    root = np.sqrt(weight)
    kernel = np.exp(-0.5 * ((node[:, None] - node) / length) ** 2)
    values, vectors = np.linalg.eigh(root[:, None] * kernel * root)
    values, vectors = values[::-1], vectors[:, ::-1]
    phi = vectors / root[:, None]
    held = np.cumsum(values * phi**2, axis=1).min(axis=0)
    count = int(np.argmax(held >= HELD)) + 1
    phi = phi[:, :count] * np.where(
        phi[-1, :count] < 0, -1.0, 1.0
    )  # on every machine the same sign
    return Modes(length, node, weight, phi, values[:count])


def _modes_of(model: Model, quantity: Quantity) -> Modes:
    declared = quantity.discrepancy
    assert declared.length_h is not None
    assert declared.sd is not None
    horizon_h = model.part(quantity.name).horizon_h
    # anything shorter needs every mode as well
    found = modes(max(declared.length_h / horizon_h, 1.0 / NODES**2))
    if len(found.eigenvalue) > MOST_MODES:
        raise InputError(
            f"discrepancy length_h of {quantity.name}",
            declared.length_h,
            f"needs {len(found.eigenvalue)} modes up to {horizon_h:g} h, more than {MOST_MODES}",
            "give a longer one",
        )
    reach = WIDTH * declared.sd * np.abs(found.at(np.linspace(0, 1, 101))).sum(axis=1).max()
    if 1 - reach < LEAST_GAIN:
        raise InputError(
            f"discrepancy sd of {quantity.name}",
            declared.sd,
            f"lets 1 + f fall to {1 - reach:.3g}, below {LEAST_GAIN}",
            "give a smaller one",
        )
    return found


def parameters(model: Model, quantity: Quantity) -> dict[str, Prior]:
    """The shared parameters of a quantity's discrepancy, with their priors."""
    declared, name = quantity.discrepancy, quantity.name
    if declared.kind == "constant" and quantity.kind == "vector":
        return {f"theta.{name}.{axis}": declared.theta for axis in AXES}
    if declared.kind == "constant":
        return {f"theta.{name}": declared.theta}
    if declared.kind == "paper":
        return {f"theta1.{name}": declared.theta, f"theta2.{name}": declared.theta}
    if declared.kind == "gp":
        count = len(_modes_of(model, quantity).eigenvalue)
        return {f"theta.{name}.{k + 1}": Prior.gaussian(0.0, 1.0, WIDTH) for k in range(count)}
    return {}


def affine(
    model: Model,
    quantity: Quantity,
    time_h: float,
    component: int | None = None,
    reader: tuple[str | None, str | None] | None = None,
) -> Affine:
    """The discrepancy of a quantity at a time; for a vector, of one component.

    reader  instrument and campaign of a reading, whose biases join; None: the blade itself, with
            those that last
    """
    own = _declared(model, quantity, time_h, component)
    for bias in model.network.biases:
        asleep = model.network.parameter(bias.name).level == "dormant"
        if asleep or bias.quantity != quantity.name or (reader is None and not bias.lasting):
            continue
        s = bias.share(time_h, *(reader or (None, None)))
        term = ((s, (bias.name,)),) if s else ()
        if bias.how == "plus":
            own = replace(own, offset=own.offset + term)
        else:
            own = replace(own, gain=own.gain + term)
    return own


def _declared(model: Model, quantity: Quantity, time_h: float, component: int | None) -> Affine:
    declared = quantity.discrepancy
    if declared.kind == "none":
        return NONE
    names, sigma = tuple(parameters(model, quantity)), declared.sigma or 0.0
    if declared.kind == "constant":
        return Affine(offset=((1.0, (names[component or 0],)),), sigma=sigma)
    if declared.kind == "paper":
        psi = model.network.psi_of(quantity).name
        return Affine(((1.0, names[:1]), (-1.0, (names[1], psi))), sigma=sigma)
    assert declared.sd is not None
    at = _modes_of(model, quantity).at(np.array([time_h / model.part(quantity.name).horizon_h]))[0]
    left = declared.sd * math.sqrt(max(1.0 - float(at @ at), 0.0))
    terms = tuple((declared.sd * float(a), (n,)) for a, n in zip(at, names, strict=True))
    return Affine(terms, sigma=sigma, left=left)


def total(terms: Iterable[Term], value: Callable[[str], Array]) -> Array | float:
    """Σ coefficient × product of the named parameters; `value` gives them, (n,) each.

    >>> total(((1.0, ("a",)), (-2.0, ("a", "b"))), {"a": np.ones(2), "b": np.arange(2.0)}.get)
    array([ 1., -1.])
    """
    out: Array | float = 0.0
    for coefficient, names in terms:
        product: Array | float = coefficient
        for name in names:
            product = product * value(name)
        out = out + product
    return out
