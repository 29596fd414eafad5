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

as many as hold 0.995 of the variance at every t (`core.expansion`; holding it of the integral alone
would leave most at the ends). What the cut modes leave, r(t)² = sd² − Σ lambda_k phi_k(t)², counts
as independent from reading to reading. Priors are cut at `WIDTH` standard deviations, and no prior
may let g fall below `LEAST_GAIN`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from core.expansion import modes_over
from core.model import Model
from core.network import WIDTH, Quantity
from core.prior import Prior

Array = NDArray[np.float64]
Term = tuple[float, tuple[str, ...]]
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
        count = len(modes_over(quantity, model.part(quantity.name).horizon_h).eigenvalue)
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
    horizon_h = model.part(quantity.name).horizon_h
    at = modes_over(quantity, horizon_h).at(np.array([time_h / horizon_h]))[0]
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
