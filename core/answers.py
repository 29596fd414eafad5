"""What answers for the physics: a surrogate of simulation runs, a formula, or several as one.

Where different models answer for different quantities (creep coupons below blades, say), they are
`Stacked`: one network over all of them, in which they may share parameters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError
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
