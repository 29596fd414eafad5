"""A model: the network that is calibrated and the surrogate that answers for the physics."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import sha256
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from core.errors import ModelError
from core.network import Network, rotor_blade_network
from core.response import Response

Array = NDArray[np.float64]


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


@dataclass(frozen=True)
class Model:
    """Network + surrogate. `version` names the pair in every answer (64 bits of its digest)."""

    network: Network
    surrogate: Answers
    _rows: dict[object, Response] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        known = {p.name: p for p in self.network.parameters}
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

    @cached_property
    def digest(self) -> str:
        """SHA-256 over the declaration and the surrogate's own digest."""
        text = json.dumps(self.network.to_json(), sort_keys=True) + self.surrogate.digest
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
