"""Priors of single parameters: bounded, and drawn from by their quantiles.

Every prior lives on a box [low, high]; a normal one is cut there. In `u` a prior that is uniform in
log x is uniform. A local parameter may have a population instead: its mean and sd over the blades
are parameters themselves, with priors of their own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from core.errors import InputError

Array = NDArray[np.float64]


def cut_mass(mean: Array | float, sd: Array | float, low: float, high: float) -> Array:
    """Mass of N(mean, sd²) between the bounds.

    Of bounds above the mean by the tails above them: below 1 there is no room for the difference.

    >>> float(cut_mass(1.0, 0.1, 2.0, 3.0) / cut_mass(-1.0, 0.1, -3.0, -2.0))
    1.0
    """
    a, b = (low - mean) / sd, (high - mean) / sd
    return np.asarray(np.where(a > 0, ndtr(-a) - ndtr(-b), ndtr(b) - ndtr(a)), float)


def cut_quantile(
    p: Array, mean: Array | float, sd: Array | float, low: float, high: float
) -> Array:
    """Quantile of N(mean, sd²) cut at the bounds."""
    mass, a = cut_mass(mean, sd, low, high), (low - mean) / sd
    z = np.where(a > 0, -ndtri(ndtr(-a) - p * mass), ndtri(ndtr(a) + p * mass))
    return np.asarray(np.clip(mean + sd * z, low, high))


@dataclass(frozen=True, slots=True)
class Prior:
    """Prior of one parameter, bounded on [low, high].

    kind  ``uniform``; ``log_uniform`` (density ∝ 1/x); ``normal`` with `mean` and `sd`, cut at
    the bounds.
    """

    kind: Literal["uniform", "log_uniform", "normal"]
    low: float
    high: float
    mean: float = 0.0
    sd: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise InputError(
                "prior bounds", (self.low, self.high), "are not an interval", "give low < high"
            )
        if self.kind == "log_uniform" and self.low <= 0:
            raise InputError(
                "prior low", self.low, "is not positive", "a log_uniform needs low > 0"
            )
        if self.kind == "normal" and not self.sd > 0:
            raise InputError("prior sd", self.sd, "is not positive", "give sd > 0")
        if self.kind == "normal" and not cut_mass(self.mean, self.sd, self.low, self.high) > 0:
            raise InputError(
                "prior mean",
                self.mean,
                f"lies too far from {self.low:g} … {self.high:g}: nothing of N(mean, {self.sd:g}²) "
                "is left there",
                "move the bounds or widen sd",
            )
        if self.kind not in ("uniform", "log_uniform", "normal"):
            raise InputError(
                "prior kind", self.kind, "is not known", "use uniform, log_uniform or normal"
            )

    @staticmethod
    def gaussian(mean: float, sd: float, width: float = 8.0) -> Prior:
        """A normal prior whose bounds lie `width` standard deviations away."""
        return Prior("normal", mean - width * sd, mean + width * sd, mean, sd)

    @property
    def log_scale(self) -> bool:
        return self.kind == "log_uniform"

    @property
    def box(self) -> tuple[float, float]:
        """Bounds on the working scale u: log x for a log-uniform prior, else x."""
        return (
            (math.log(self.low), math.log(self.high)) if self.log_scale else (self.low, self.high)
        )

    def to_u(self, x: Array) -> Array:
        return np.asarray(np.log(x) if self.log_scale else x, float)

    def to_x(self, u: Array) -> Array:
        return np.asarray(np.exp(u) if self.log_scale else u, float)

    def log_density_u(self, u: Array) -> Array:
        """Log density on the working scale; −inf outside the bounds.

        >>> Prior("uniform", 0.0, 4.0).log_density_u(np.array([1.0, 5.0])).round(4).tolist()
        [-1.3863, -inf]
        """
        low, high = self.box
        inside = (u >= low) & (u <= high)
        if self.kind == "normal":
            mass = cut_mass(self.mean, self.sd, low, high)
            z = (u - self.mean) / self.sd
            value = -0.5 * z * z - np.log(self.sd * math.sqrt(2 * math.pi) * mass)
        else:
            value = np.full(np.shape(u), -math.log(high - low))
        return np.where(inside, value, -np.inf)

    def quantile(self, p: Array) -> Array:
        """Inverse distribution function, on the scale of x."""
        low, high = self.box
        if self.kind == "normal":
            return cut_quantile(p, self.mean, self.sd, low, high)
        return np.asarray(self.to_x(low + p * (high - low)))


@dataclass(frozen=True, slots=True)
class Population:
    """Where the blades' values of a local parameter come from: N(mean, sd²), cut at its bounds.

    Both are shared and unknown; these are their priors. Every blade's values teach them, so a blade
    without a reading, a replaced blade's successor say, starts from the rotor's population.
    """

    mean: Prior
    sd: Prior

    def __post_init__(self) -> None:
        if not self.sd.low > 0:
            raise InputError("population sd", self.sd.low, "is not positive", "give low > 0")
