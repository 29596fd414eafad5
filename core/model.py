"""A model: the network that is calibrated and the surrogate that answers for the physics.

Where different models answer for different quantities (creep coupons below blades, say), they are
`Stacked`: one network over all of them, in which they may share parameters.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import sha256
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from core.course import ITSELF, Drift
from core.errors import InputError, ModelError
from core.network import Network, rotor_blade_network
from core.response import Response
from core.surrogate import Surrogate
from core.surrogate.anchor import Anchor
from core.surrogate.driven import Driven

Array = NDArray[np.float64]
MOST_LOCAL = 10  # local parameters of a component; the polynomials of its rows grow too large


class Input(Protocol):
    """One input of a surrogate and the range it was trained on."""

    @property
    def name(self) -> str: ...
    @property
    def low(self) -> float: ...
    @property
    def high(self) -> float: ...


class Answers(Protocol):
    """What the network needs of a surrogate: `core.surrogate`, or a formula in tests."""

    @property
    def inputs(self) -> Sequence[Input]: ...
    @property
    def horizon_h(self) -> float: ...
    @property
    def node_count(self) -> int: ...
    @property
    def named(self) -> Mapping[str, int]: ...
    @property
    def digest(self) -> str: ...

    def predict(
        self, x: Array, quantity: str, times: Array, nodes: Sequence[int] | None = None
    ) -> tuple[Array, Array]: ...
    def response(
        self, quantity: str, times: Array, nodes: Sequence[int] | None = None, degree: int = 5
    ) -> Response: ...
    def deformation_modes(self, nodes: Sequence[int]) -> Array: ...
    def mode_response(self, time_h: float, mixing: Array, degree: int = 5) -> Response: ...
    def mode_covariance(self, time_h: float) -> Array: ...


@dataclass(frozen=True, slots=True)
class Range:
    """An input of several surrogates and the range that all of them cover."""

    name: str
    low: float
    high: float


@dataclass(frozen=True)
class Stacked:
    """Several surrogates as one; each quantity is answered by one of them.

    parts  (surrogate, the quantities it answers for)

    Raises InputError for a quantity in two parts and for an input whose ranges do not overlap.
    """

    parts: tuple[tuple[Answers, tuple[str, ...]], ...]

    def __post_init__(self) -> None:
        quantities = [q for _, own in self.parts for q in own]
        twice = sorted({q for q in quantities if quantities.count(q) > 1})
        if twice:
            raise InputError(
                "quantities", twice, "are answered by two surrogates", "give each to one of them"
            )
        for i in self.inputs:
            if not i.low < i.high:
                raise InputError(
                    f"input {i.name}",
                    (i.low, i.high),
                    "has no range that all surrogates cover",
                    "rename the input of one of them or add training runs",
                )

    @cached_property
    def inputs(self) -> tuple[Range, ...]:
        """Every input once, in the order of the parts."""
        every = [i for part, _ in self.parts for i in part.inputs]
        same = {i.name: [j for j in every if j.name == i.name] for i in every}
        return tuple(
            Range(n, max(j.low for j in own), min(j.high for j in own)) for n, own in same.items()
        )

    @property
    def _largest(self) -> Answers:
        return max((part for part, _ in self.parts), key=lambda part: part.node_count)

    @property
    def horizon_h(self) -> float:
        return max(part.horizon_h for part, _ in self.parts)

    @property
    def node_count(self) -> int:
        return self._largest.node_count

    @property
    def named(self) -> Mapping[str, int]:
        """Named nodes of the largest mesh."""
        return self._largest.named

    @cached_property
    def digest(self) -> str:
        text = "".join(f"{part.digest}{sorted(own)}" for part, own in self.parts)
        return sha256(text.encode()).hexdigest()

    def part(self, quantity: str) -> Answers:
        """The surrogate that answers for `quantity`."""
        for part, own in self.parts:
            if quantity in own:
                return part
        raise InputError(
            "quantity",
            quantity,
            "is answered by no surrogate",
            f"use one of {[q for _, own in self.parts for q in own]}",
        )

    def predict(
        self, x: Array, quantity: str, times: Array, nodes: Sequence[int] | None = None
    ) -> tuple[Array, Array]:
        part, names = self.part(quantity), [i.name for i in self.inputs]
        return part.predict(
            x[:, [names.index(i.name) for i in part.inputs]], quantity, times, nodes
        )


def _of_all(drift: Drift) -> bool:
    """Whether it runs alike in every blade."""
    return drift.blades is None and (not drift.since or drift.since == ((ITSELF, 0.0),))


@dataclass(frozen=True)
class Model:
    """Network + surrogate. `version` names the pair in every answer (64 bits of its digest).

    Where the network has inputs that run in time, make it with `Model.of`.
    """

    network: Network
    surrogate: Answers | Stacked
    _rows: dict[object, Response] = field(default_factory=dict, repr=False, compare=False)
    _blades: dict[object, Model] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        known = {p.name: p for p in self.network.parameters}
        answered = {i.name for i in self.surrogate.inputs}
        for drift in self.network.drifts:
            asleep = known[drift.name].level == "dormant"
            if drift.name not in answered and _of_all(drift) and not asleep:
                raise ModelError(
                    f"the surrogate knows no amplitude {drift.name!r}: inputs that run in time "
                    "need a driven surrogate; use Model.of"
                )
        for i in self.surrogate.inputs:
            if i.name not in known:
                raise ModelError(
                    f"the surrogate's input {i.name!r} is not a parameter of the network "
                    f"{self.network.name!r}; declare it (dormant, if it is not to be calibrated)"
                )
            prior = known[i.name].prior
            slack = 1e-9 * (i.high - i.low)
            if prior.low < i.low - slack or prior.high > i.high + slack:
                raise ModelError(
                    f"the prior of {i.name!r}, {prior.low:g} … {prior.high:g}, leaves the range of "
                    f"the training runs, {i.low:g} … {i.high:g}; narrow it or add runs"
                )
        for quantity in self.network.quantities:
            self.few_locals([i.name for i in self.part(quantity.name).inputs], quantity.name)

    @staticmethod
    def of(network: Network, surrogate: Answers | Stacked, anchor: Anchor | None = None) -> Model:
        """The network on a surrogate that is driven by the network's drifts, if there are any.

        anchor  of a wide surrogate (`core.surrogate.anchor`); that of a driven one is kept
        Raises ModelError where the drifts cannot go through this surrogate, InputError where an
        input would leave its runs.
        """
        if isinstance(surrogate, Driven):
            anchor, surrogate = surrogate.anchor, surrogate.base
        asleep = {p.name: p.nominal for p in network.of_level("dormant") if p.nominal is not None}
        if isinstance(surrogate, Surrogate):
            inputs = {i.name for i in surrogate.inputs}
            fixed = {name: value for name, value in asleep.items() if name in inputs}
        if not network.drifts and not (isinstance(surrogate, Surrogate) and fixed):
            return Model(network, surrogate)
        if not isinstance(surrogate, Surrogate):
            raise ModelError(
                f"inputs that run in time ({', '.join(d.name for d in network.drifts)}) need one "
                "surrogate of simulation runs with mean CEEQ; this model's is none"
            )
        drifts = tuple(d for d in network.drifts if _of_all(d) and d.name not in asleep)
        free = (inputs - fixed.keys()) | {d.name for d in drifts}
        ranges = {p.name: (p.prior.low, p.prior.high) for p in network.parameters if p.name in free}
        return Model(network, Driven(surrogate, drifts, ranges, fixed, anchor))

    def for_blade(self, blade: str) -> Model:
        """The model as one blade has it; itself where no effect is of some blades only."""
        network = self.network.for_blade(blade)
        if network is self.network:
            return self
        key = (network.drifts, network.biases)
        if key not in self._blades:
            plain = isinstance(self.surrogate, Stacked) or not self.network.drifts
            made = Model(network, self.surrogate) if plain else Model.of(network, self.surrogate)
            self._blades[key] = made
        return self._blades[key]

    def part(self, quantity: str) -> Answers:
        """The surrogate that answers for `quantity`."""
        return (
            self.surrogate.part(quantity) if isinstance(self.surrogate, Stacked) else self.surrogate
        )

    def few_locals(self, names: Sequence[str], what: str) -> None:
        """Refuse inputs with more local parameters than a message integrates over."""
        local = [n for n in names if self.network.parameter(n).level == "local"]
        if len(local) > MOST_LOCAL:
            raise InputError(
                f"local parameters of {what}",
                local,
                f"are more than {MOST_LOCAL}",
                "declare some as shared, known or dormant",
            )

    @cached_property
    def digest(self) -> str:
        """SHA-256 over the declaration and the surrogate's own digest.

        Effects that the model may lack (`families`) are no part of it: no posterior knows them.
        """
        declared = {k: v for k, v in self.network.to_json().items() if k != "families"}
        text = json.dumps(declared, sort_keys=True) + self.surrogate.digest
        return sha256(text.encode()).hexdigest()

    @property
    def version(self) -> str:
        return self.digest[:16]

    @property
    def input_names(self) -> tuple[str, ...]:
        return tuple(i.name for i in self.surrogate.inputs)


def rotor_blade() -> Model:
    """The model that ships: the paper's network on the built-in surrogate."""
    from core.builtin import rotor_blade as builtin

    return Model(rotor_blade_network(), builtin.load())


def rotor_blade_wide() -> Model:
    """The model of the wide plan, in which effects find room; dormant inputs are asleep.

    Where there is no effect it answers as `rotor_blade` does (`core.surrogate.anchor`).
    """
    from core.builtin import rotor_blade as builtin

    network = builtin.wide_network()
    asleep = {p.name: p.nominal for p in network.of_level("dormant") if p.nominal is not None}
    return Model.of(network, builtin.load_wide(), Anchor(builtin.load(), asleep))
