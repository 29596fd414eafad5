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
input may run in time by an amplitude that is a parameter (`core.drift.Drift`), readings may be
off by one (`Bias`), for all blades or for some.

The declaration is data: it is written to JSON, posted over HTTP and stored with every state.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.drift import Bias, Drift
from core.errors import InputError
from core.family import Family
from core.gain import check_biases, check_discrepancy
from core.parameter import Level, Parameter
from core.quantity import LEAST_GAIN, WIDTH, Discrepancy, Kind, Quantity

__all__ = [
    "LEAST_GAIN", "WIDTH", "Discrepancy", "Kind", "Level", "Network", "Parameter", "Quantity",
]  # fmt: skip

Array = NDArray[np.float64]
SCHEMA = 1
RESERVED = ("sigma_obs.", "theta.", "theta1.", "theta2.")


@dataclass(frozen=True, slots=True)
class Network:
    """Parameters and quantities; immutable, JSON both ways.

    drifts        inputs that run in time, each by the parameter of its name
    biases        what readings have beside what the blades do, each by the parameter of its name
    families      effects that the model may lack, for diagnoses: physics of its own, by name
    forgetting_h  half-life [h] by which a blade's older readings lose weight, for local parameters
                  that drift: variance · 2^(age / half-life), age counted from its latest reading
    """

    name: str
    parameters: tuple[Parameter, ...]
    quantities: tuple[Quantity, ...]
    notes: Mapping[str, str] = field(default_factory=dict)
    forgetting_h: float | None = None
    drifts: tuple[Drift, ...] = ()
    biases: tuple[Bias, ...] = ()
    families: tuple[Family, ...] = ()

    def __post_init__(self) -> None:
        if self.forgetting_h is not None and not 0 < self.forgetting_h < math.inf:
            raise InputError(
                "forgetting_h", self.forgetting_h, "is no half-life", "give hours > 0, or None"
            )
        for what, names in {
            "parameters": [p.name for p in self.parameters],
            "quantities": [q.name for q in self.quantities],
            "effects": [d.name for d in self.drifts] + [b.name for b in self.biases],
            "families": [f.name for f in self.families],
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
        own = {name for p in self.parameters for name in p.hyperparameters}
        if same := sorted(own & {p.name for p in self.parameters}):
            raise InputError(
                "parameters", same, "are mean or sd of a population", "choose other names"
            )
        for q in self.quantities:
            if q.discrepancy.kind == "paper":
                check_discrepancy(self, q)
        for f in self.families:
            (self.parameter if f.target == "input" else self.quantity)(f.of)
        for d in self.drifts:
            self._check_amplitude(d.name, d.input)
            self.parameter(d.input)
        for one in self.biases:
            self._check_amplitude(one.name, one.quantity)
            if self.quantity(one.quantity).kind == "vector":
                raise InputError(
                    f"bias {one.name}", one.quantity, "is read at many nodes", "use a scalar one"
                )
        for q in self.quantities:
            check_biases(self, q)

    def _check_amplitude(self, name: str, moved: str) -> None:
        """An amplitude is a parameter of its own, shared or dormant, on a plain scale."""
        own = self.parameter(name)
        if name == moved or own.prior.log_scale or own.level not in ("shared", "dormant"):
            raise InputError(
                f"effect {name}",
                (moved, own.level, own.prior.kind),
                "cannot be the amplitude",
                "give it a parameter of its own, shared, with a uniform or normal prior",
            )

    def for_blade(self, blade: str) -> Network:
        """The network as one blade has it: effects that concern it, by its own hours."""
        drifts = tuple(d for one in self.drifts if (d := one.of_blade(blade)) is not None)
        biases = tuple(b for one in self.biases if (b := one.of_blade(blade)) is not None)
        if (drifts, biases) == (self.drifts, self.biases):
            return self
        return replace(self, drifts=drifts, biases=biases)

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

    def unit_of(self, name: str) -> str:
        """A parameter's unit; of the amplitude of an effect that is added, of what it is added to.

        Raises InputError for one that the network does not declare.
        """
        own = self.parameter(name)
        added = (name, "plus")
        units = {self.parameter(d.input).unit for d in self.drifts if (d.name, d.how) == added}
        units |= {self.quantity(b.quantity).unit for b in self.biases if (b.name, b.how) == added}
        return units.pop() if own.unit == "1" and len(units) == 1 else own.unit

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
        out["biases"] = [one.to_json() for one in self.biases]
        out["families"] = [one.to_json() for one in self.families]
        unused_options: list[tuple[dict[str, Any], str, Any]] = [
            *((q, "level", 1) for q in out["quantities"]),
            *((p, "population", None) for p in out["parameters"]),
            (out, "forgetting_h", None),
            (out, "drifts", []),
            (out, "biases", []),
            (out, "families", []),
        ]
        for told, name, unused in unused_options:
            if told[name] == unused:
                del told[name]
        return out

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Network:
        """The inverse of `to_json`; unknown keys are refused.

        >>> from core.builtin.paper_network import rotor_blade_network
        >>> Network.from_json(rotor_blade_network().to_json()) == rotor_blade_network()
        True
        """
        body = dict(data)
        if body.pop("schema", SCHEMA) != SCHEMA:
            raise InputError("schema", data["schema"], "is not known", f"write schema {SCHEMA}")
        try:
            return Network(
                name=body.pop("name"),
                parameters=tuple(Parameter.from_json(p) for p in body.pop("parameters")),
                quantities=tuple(Quantity.from_json(q) for q in body.pop("quantities")),
                drifts=tuple(Drift.from_json(d) for d in body.pop("drifts", ())),
                biases=tuple(Bias.from_json(d) for d in body.pop("biases", ())),
                families=tuple(Family.from_json(d) for d in body.pop("families", ())),
                **body,
            )
        except (TypeError, KeyError, ValueError, AttributeError) as error:
            raise InputError(
                "network", str(error), "does not fit the schema", "see Network"
            ) from error
