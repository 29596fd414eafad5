"""The hierarchical Bayesian network, declared.

A network says which parameters exist and at which level, and how readings see them::

    shared   psi_global   one value for the rotor          T1T, sigma_obs of each quantity,
                                                           mean and sd of a population
    local    psi_local    one value for each blade         TBC thickness, alpha, gamma
    known                 given for each blade             a stress, a slot
    dormant               held at its nominal value        freed only by an effect

with the joint density (the paper's Eq. 4 and Fig. 6, for B blades and shared s, local l_b)

    p(s, l, D) = p(s) Π_b p(l_b) Π_{i in b} N(y_i | Y_m(t_i; l_b, s), sigma² + sigma_surrogate²)

A quantity may declare what the model gets wrong (`Discrepancy`); its theta are shared, too. An
input may run in time by an amplitude that is a parameter (`core.course.Drift`).

The declaration is data: it is written to JSON, posted over HTTP and stored with every state.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from core.course import Drift
from core.errors import InputError
from core.prior import Population, Prior

Array = NDArray[np.float64]
Level = Literal["local", "shared", "known", "dormant"]
Kind = Literal["none", "constant", "paper", "gp"]
SCHEMA = 1
WIDTH = 4.0  # theta's normal priors are cut at as many standard deviations
LEAST_GAIN = 0.1  # what multiplies the model stays above this
RESERVED = ("sigma_obs.", "theta.", "theta1.", "theta2.")


@dataclass(frozen=True, slots=True)
class Parameter:
    """An input of the model and its place in the network.

    `nominal` is the value used while the parameter is dormant, or known and not given. With a
    `population`, a local parameter's `prior` gives its bounds only.
    """

    name: str
    level: Level
    prior: Prior
    unit: str = "1"
    symbol: str = ""
    nominal: float | None = None
    population: Population | None = None

    @property
    def hyperparameters(self) -> dict[str, Prior]:
        """Shared parameters of the population, by name."""
        if self.population is None:
            return {}
        return {f"mean.{self.name}": self.population.mean, f"sd.{self.name}": self.population.sd}

    def __post_init__(self) -> None:
        if self.population is not None:
            mean, own = self.population.mean, self.prior
            if self.level != "local" or own.kind != "uniform":
                raise InputError(
                    f"population of {self.name}",
                    (self.level, own.kind),
                    "does not belong there",
                    "give it to a local parameter with a uniform prior, its bounds",
                )
            if mean.low < own.low or mean.high > own.high:
                raise InputError(
                    f"population mean of {self.name}",
                    (mean.low, mean.high),
                    f"leaves the bounds {own.low:g} … {own.high:g}",
                    "narrow it",
                )
        if self.level not in ("local", "shared", "known", "dormant"):
            raise InputError(
                f"level of {self.name}", self.level, "is not known", "local, shared, known, dormant"
            )
        if self.level == "dormant" and self.nominal is None:
            raise InputError(
                f"nominal of {self.name}", None, "is missing", "a dormant parameter needs a value"
            )


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


@dataclass(frozen=True, slots=True)
class Network:
    """Parameters and quantities; immutable, JSON both ways.

    drifts        inputs that run in time, each by the parameter of its name
    forgetting_h  half-life [h] by which a blade's older readings lose weight, for local parameters
                  that drift: variance · 2^(age / half-life), age counted from its latest reading
    """

    name: str
    parameters: tuple[Parameter, ...]
    quantities: tuple[Quantity, ...]
    notes: Mapping[str, str] = field(default_factory=dict)
    forgetting_h: float | None = None
    drifts: tuple[Drift, ...] = ()

    def __post_init__(self) -> None:
        if self.forgetting_h is not None and not 0 < self.forgetting_h < math.inf:
            raise InputError(
                "forgetting_h", self.forgetting_h, "is no half-life", "give hours > 0, or None"
            )
        for what, names in {
            "parameters": [p.name for p in self.parameters],
            "quantities": [q.name for q in self.quantities],
            "drifts": [d.name for d in self.drifts],
        }.items():
            twice = sorted({n for n in names if names.count(n) > 1})
            if twice:
                raise InputError(what, twice, "are declared twice", "give each name once")
        levels = {q.level for q in self.quantities}
        gap = set(range(1, max(levels, default=1))) - levels
        if gap or min(levels, default=1) < 1:
            raise InputError(
                "levels", sorted(levels), "leave a level without a quantity", "count from 1 up"
            )
        for p in self.parameters:
            if p.name.startswith(RESERVED):
                raise InputError("parameter", p.name, "is a name of ours", "choose another one")
        for q in self.quantities:
            if q.discrepancy.kind == "paper":
                self._check_gain(q)
        for d in self.drifts:
            own, moved = self.parameter(d.name), self.parameter(d.input)
            if own.name == moved.name or own.prior.log_scale:
                raise InputError(
                    f"drift {d.name}",
                    (d.input, own.prior.kind),
                    "cannot be the amplitude",
                    "give it a parameter of its own, with a uniform or normal prior",
                )

    def _check_gain(self, quantity: Quantity) -> None:
        """1 + theta1 − theta2 psi must stay above LEAST_GAIN everywhere in the priors."""
        psi, theta = self.psi_of(quantity).prior, quantity.discrepancy.theta
        corners = [theta.low - t * p for t in (theta.low, theta.high) for p in (psi.low, psi.high)]
        if 1 + min(corners) < LEAST_GAIN:
            raise InputError(
                f"discrepancy of {quantity.name}",
                (theta.low, theta.high),
                f"lets 1 + theta1 - theta2 psi fall to {1 + min(corners):.3g}, below {LEAST_GAIN}",
                "give theta a smaller sd",
            )

    def psi_of(self, quantity: Quantity) -> Parameter:
        """The shared parameter in a ``paper`` discrepancy."""
        shared, name = self.of_level("shared"), quantity.discrepancy.psi
        for p in shared:
            if name in (None, p.name):
                return p
        raise InputError(
            f"discrepancy psi of {quantity.name}",
            name,
            "is no shared parameter",
            f"use one of {[p.name for p in shared]}",
        )

    def of_level(self, level: Level) -> tuple[Parameter, ...]:
        return tuple(p for p in self.parameters if p.level == level)

    def parameter(self, name: str) -> Parameter:
        for p in self.parameters:
            if p.name == name:
                return p
        raise InputError(
            "parameter", name, "does not exist", f"use one of {[p.name for p in self.parameters]}"
        )

    def quantity(self, name: str) -> Quantity:
        for q in self.quantities:
            if q.name == name:
                return q
        raise InputError(
            "quantity",
            name,
            "is not measured here",
            f"use one of {[q.name for q in self.quantities]}",
        )

    def to_json(self) -> dict[str, Any]:
        """A plain dictionary; a level of 1 and options that are not used are left out."""
        out = {"schema": SCHEMA, **asdict(self)}
        out["quantities"] = [q.to_json() for q in self.quantities]
        out["drifts"] = [d.to_json() for d in self.drifts]
        unused_options: list[tuple[dict[str, Any], str, Any]] = [
            *((q, "level", 1) for q in out["quantities"]),
            *((p, "population", None) for p in out["parameters"]),
            (out, "forgetting_h", None),
            (out, "drifts", []),
        ]
        for told, name, unused in unused_options:
            if told[name] == unused:
                del told[name]
        return out

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Network:
        """The inverse of `to_json`; unknown keys are refused.

        >>> Network.from_json(rotor_blade_network().to_json()) == rotor_blade_network()
        True
        """
        body = dict(data)
        if body.pop("schema", SCHEMA) != SCHEMA:
            raise InputError("schema", data["schema"], "is not known", f"write schema {SCHEMA}")
        try:
            return Network(
                name=body.pop("name"),
                parameters=tuple(_parameter(p) for p in body.pop("parameters")),
                quantities=tuple(Quantity.from_json(q) for q in body.pop("quantities")),
                drifts=tuple(Drift.from_json(d) for d in body.pop("drifts", ())),
                **body,
            )
        except (TypeError, KeyError, ValueError) as error:
            raise InputError(
                "network", str(error), "does not fit the schema", "see Network"
            ) from error


def _parameter(told: Mapping[str, Any]) -> Parameter:
    own = {**told, "prior": Prior(**told["prior"])}
    if told.get("population") is not None:
        own["population"] = Population(**{k: Prior(**v) for k, v in told["population"].items()})
    return Parameter(**own)


def rotor_blade_network() -> Network:
    """The paper's network: T1T shared; TBC thickness, alpha and gamma local to each blade."""
    return Network(
        name="rotor-blade",
        parameters=(
            Parameter("tbc_thickness", "local", Prior("uniform", 2 / 3, 4 / 3), "1", "TBC"),
            Parameter("t1t_rate", "shared", Prior("uniform", 0.8, 1.0), "1", "T1T"),
            Parameter("creep_transient", "local", Prior("uniform", -3, 3), "1", "alpha"),
            Parameter("creep_steady", "local", Prior("uniform", -3, 3), "1", "gamma"),
        ),
        quantities=(
            # numerical: the default mesh against a refined one (tests/benchmarks/bench_blade.py)
            Quantity(
                "elongation",
                "mm",
                "scalar",
                Prior("log_uniform", 1e-3, 0.2),
                -5.0,
                50.0,
                numerical=0.003,
            ),
            Quantity(
                "deformation",
                "mm",
                "vector",
                Prior("log_uniform", 1e-3, 0.2),
                -50.0,
                50.0,
                numerical=0.003,
            ),
            Quantity(
                "ceeq",
                "1",
                "field",
                Prior("log_uniform", 1e-5, 1e-2),
                0.0,
                0.5,
                "critical",
                numerical=0.02,
            ),
        ),
        notes={"source": "Kapusuzoglu et al. 2023, doi 10.1115/1.4055243, Sec. 4 and Table 1"},
    )
