"""What answers for effects of physics, and how one moves an input."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.answers import Answers
from core.course import Course
from core.drift import Drift
from core.network import Network
from core.observation import Inspection
from core.surrogate.driven import Driven
from core.surrogate.model import Surrogate
from core.surrogate.targets import MEAN_CEEQ

Array = NDArray[np.float64]


def follows(answers: object) -> bool:
    """Whether inputs may run in time: that needs mean CEEQ as the memory. Else an effect of an
    input can be constant only."""
    base = answers.base if isinstance(answers, Driven) else answers
    return isinstance(base, Surrogate) and MEAN_CEEQ in base.parts


@dataclass(frozen=True, slots=True)
class Physics:
    """What answers for effects.

    rest     values of the inputs that the network lacks
    fields   by each quantity that is read at a node, the one where a reading names none
    network  of the model, with the effects that it has already
    """

    answers: Answers
    rest: Mapping[str, float]
    fields: Mapping[str, int]
    network: Network

    @staticmethod
    def of(network: Network, answers: Answers, rest: Mapping[str, float]) -> Physics:
        """For the quantities of a network."""
        read_at = [q for q in network.quantities if q.kind == "field"]
        there = {q.name: q.default_node for q in read_at if q.default_node in answers.named}
        fields = {q: answers.named[node] for q, node in there.items()}
        return Physics(answers, rest, fields, network)

    def drifts(self, blade: str) -> tuple[Drift, ...]:
        """What moves a blade's inputs in the model already, by the blade's own hours."""
        asleep = {p.name for p in self.network.of_level("dormant")}
        own = (d.of_blade(blade) for d in self.network.drifts if d.name not in asleep)
        return tuple(d for d in own if d is not None)

    def asked(self, reading: Inspection) -> tuple[str, list[int] | None]:
        """Quantity and nodes of a reading."""
        if reading.nodes is not None:
            return reading.quantity, [int(n) for n in reading.nodes]
        node = self.fields.get(reading.quantity)
        return reading.quantity, None if node is None else [node]


@dataclass(frozen=True, slots=True)
class Moving:
    """What an input does, for all blades: `how`, size with its sign, shape, and its clock."""

    input: str
    how: str
    size: float
    course: Course
    rotor: bool

    def moved(self, x: Array, s: Array) -> Array:
        return x + self.size * s if self.how == "plus" else x * (1.0 + self.size * s)
