"""What is measured, how noisily, and what the model gets wrong of it: declarations of a network."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from core.errors import InputError
from core.prior import Prior

KINDS = ("scalar", "field", "vector")
Kind = Literal["none", "constant", "paper", "gp"]
WIDTH = 4.0  # theta's normal priors are cut at as many standard deviations
LEAST_GAIN = 0.1  # what multiplies the model stays above this


@dataclass(frozen=True, slots=True)
class Discrepancy:
    """What the model gets wrong of a quantity, delta = y_true − Y_m (`core.discrepancy`: theory).

    kind      ``none``      delta = 0
              ``constant``  delta = c, one for each component of a vector
              ``paper``     delta ~ N(Y_m (theta1 − theta2 psi), sigma²)
              ``gp``        delta = Y_m f(t), f a Gaussian process over operating hours
    sd        prior standard deviation of c [unit], of theta1 and theta2 [1], of f [1]; the means
              are 0
    prior     of c or of theta1 and theta2, in place of a normal one with `sd`
    psi       the shared parameter of ``paper``; default: the network's first one
    sigma     sigma_delta [unit], fixed; ``paper``: 1e-5 (Sec. 4), else 0
    length_h  correlation length of f [h]
    """

    kind: Kind = "none"
    sd: float | None = None
    prior: Prior | None = None
    psi: str | None = None
    sigma: float | None = None
    length_h: float | None = None

    def __post_init__(self) -> None:
        takes = {
            "none": (),
            "constant": ("sd", "prior", "sigma"),
            "paper": ("sd", "prior", "psi", "sigma"),
            "gp": ("sd", "sigma", "length_h"),
        }
        if self.kind not in takes:
            raise InputError(
                "discrepancy kind", self.kind, "is not known", f"use one of {[*takes]}"
            )
        for name in ("sd", "prior", "psi", "sigma", "length_h"):
            if getattr(self, name) is not None and name not in takes[self.kind]:
                raise InputError(
                    f"discrepancy {name}",
                    getattr(self, name),
                    f"means nothing to the kind {self.kind}",
                    f"it takes {[*takes[self.kind]]}",
                )
        if self.kind in ("paper", "gp") and self.sd is None and self.prior is None:
            object.__setattr__(self, "sd", 0.05)
        if self.kind != "none" and self.sigma is None:
            object.__setattr__(self, "sigma", 1e-5 if self.kind == "paper" else 0.0)
        if self.kind in ("constant", "paper") and (self.sd is None) == (self.prior is None):
            raise InputError("discrepancy sd", self.sd, "is not one prior", "give sd or prior")
        if self.prior is not None and self.prior.log_scale:
            raise InputError(
                "discrepancy prior", "log_uniform", "has no sign", "use uniform or normal"
            )
        if self.kind == "gp" and self.length_h is None:
            raise InputError("discrepancy length_h", None, "is missing", "give f's length in hours")
        for name in ("sd", "length_h", "sigma"):
            value = getattr(self, name)
            if value is None or (math.isfinite(value) and value > 0):
                continue
            if name != "sigma" or value != 0:
                raise InputError(f"discrepancy {name}", value, "is not positive", "give one > 0")

    @property
    def theta(self) -> Prior:
        """Prior of c, or of theta1 and of theta2."""
        return self.prior or Prior.gaussian(0.0, self.sd or 1.0, WIDTH)

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Discrepancy:
        prior = data.get("prior")
        return Discrepancy(**{**data, "prior": prior and Prior(**prior)})


@dataclass(frozen=True, slots=True)
class Quantity:
    """Something that is measured.

    name, unit   as inspections give them
    kind         ``scalar`` (one value), ``field`` (a value at a node) or ``vector`` (x, y, z at
                 many nodes)
    sigma_obs    prior of the noise's standard deviation, shared by the rotor
    low, high    plausible range of a reading; outside it is refused as a likely unit mistake
    node         node used when a reading of a field names none
    numerical    relative standard error of the simulation itself (mesh, time steps, compiled
                 polynomials): counted as the surrogate's, in likelihood and prediction
    level        of the network that measures it, from 1: the posterior of a level is the prior of
                 the next (`core.calibration.levels`)
    discrepancy  what the model gets wrong
    by_instrument  a noise of its own for each instrument that readings name
    """

    name: str
    unit: str
    kind: Literal["scalar", "field", "vector"]
    sigma_obs: Prior
    low: float
    high: float
    node: str | None = None
    numerical: float = 0.0
    level: int = 1
    discrepancy: Discrepancy = field(default_factory=Discrepancy)
    by_instrument: bool = False

    def __post_init__(self) -> None:
        if "@" in self.name or "." in self.name:
            raise InputError("quantity", self.name, "holds a . or @", "choose another name")
        if not self.sigma_obs.low > 0:
            raise InputError(
                f"sigma_obs of {self.name}",
                self.sigma_obs.low,
                "is no standard deviation",
                "give bounds above 0",
            )
        if self.kind not in KINDS:
            problem = "is of an unknown kind"
            raise InputError(f"kind of {self.name}", self.kind, problem, f"use one of {[*KINDS]}")
        if not self.low < self.high:
            ends = (self.low, self.high)
            raise InputError(f"range of {self.name}", ends, "holds no reading", "give low < high")
        if not 0 <= self.numerical < math.inf:
            problem = "is no relative standard error"
            raise InputError(
                f"numerical of {self.name}", self.numerical, problem, "give 0 or more, as 0.01"
            )

    @property
    def default_node(self) -> str:
        """Name of the node where one is needed and none is given: of a field, of a vector."""
        return self.node or ("tip" if self.kind == "vector" else "critical")

    def node_among(self, named: Mapping[str, int]) -> int:
        """The number of `default_node`; InputError: a model without it, so that one must be given.

        >>> noise = Prior("log_uniform", 1e-6, 1e-3)
        >>> Quantity("ceeq", "1", "field", noise, 0, 1).node_among({"critical": 7, "tip": 9})
        7
        """
        if self.default_node not in named:
            there = ", ".join(sorted(named)) or "no node"
            problem = f"is needed for {self.name}: the model names {there}, not {self.default_node}"
            raise InputError("node", None, problem, "give the number of a node")
        return named[self.default_node]

    @property
    def sigma_name(self) -> str:
        return f"sigma_obs.{self.name}"

    def sigma_of(self, instrument: str | None) -> str:
        """Name of the shared noise of a reading by this instrument.

        >>> noise = Prior("log_uniform", 1e-3, 0.2)
        >>> q = Quantity("elongation", "mm", "scalar", noise, -5, 50, by_instrument=True)
        >>> q.sigma_of("gauge-2"), q.sigma_of(None)
        ('sigma_obs.elongation@gauge-2', 'sigma_obs.elongation')
        """
        if not self.by_instrument or instrument is None:
            return self.sigma_name
        return f"{self.sigma_name}@{instrument}"

    def check_instrument(self, instrument: str | None) -> None:
        """Refuse an instrument where readings have one noise for all."""
        if instrument is not None and not self.by_instrument:
            raise InputError(
                "instrument",
                instrument,
                f"has no noise of its own: {self.name} has one for all",
                "leave it out, or declare the quantity by_instrument",
            )

    def to_json(self) -> dict[str, Any]:
        """A plain dictionary; a discrepancy and instruments only where declared."""
        out = asdict(self)
        told = {name: v for name, v in out.pop("discrepancy").items() if v is not None}
        if self.discrepancy.kind != "none":
            out["discrepancy"] = told
        if not self.by_instrument:
            del out["by_instrument"]
        return out

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Quantity:
        told = {"discrepancy": Discrepancy.from_json(data.get("discrepancy", {}))}
        return Quantity(**{**data, "sigma_obs": Prior(**data["sigma_obs"]), **told})
