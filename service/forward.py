"""A model as a function of its parameters: what others' samplers and designs call.

    (psi, t) → Y_m(t; psi), s(t; psi)

the surrogate's mean and its own standard deviation, without discrepancy and noise. Inputs that are
not calibrated (known of a blade, or dormant) keep their values; amplitudes of effects that a rotor
has adopted are parameters like any other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.answers import Answers
from core.calibration.space import nominal
from core.errors import InputError, RangeError
from core.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SurrogateForward:
    """One quantity of a model; `place` says which inputs of the surrogate are free."""

    surrogate: Answers
    quantity: str
    kind: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    place: tuple[int, ...]
    rest: tuple[float, ...]

    def __call__(
        self, x: Sequence[float], times: Sequence[float], node: int | None
    ) -> tuple[Array, Array]:
        """Mean and sd (T,), for a vector (T, 3). RangeError for parameters outside the runs."""
        if len(x) != len(self.names):
            raise InputError(
                "parameters",
                len(x),
                f"is not the number of {', '.join(self.names)}",
                f"give {len(self.names)} values",
            )
        for name, value, low, high in zip(self.names, x, self.low, self.high, strict=True):
            if not low <= value <= high:
                problem = f"lies outside the training runs, {low:g} … {high:g}"
                raise RangeError(name, value, problem, "ask inside")
        row = np.array([self.rest], dtype=np.float64)
        row[0, list(self.place)] = x
        nodes = None if self.kind == "scalar" else [0 if node is None else node]
        mean, sd = self.surrogate.predict(row, self.quantity, np.asarray(times, float), nodes)
        if self.kind == "scalar":
            return mean[0], sd[0]
        return mean[0, :, 0], sd[0, :, 0]


def forward_of(model: Model, quantity: str, known: Mapping[str, float] | None) -> SurrogateForward:
    """The function behind one quantity; inputs that `known` gives are not among its parameters."""
    declared, surrogate = model.network.quantity(quantity), model.part(quantity)
    inputs = list(surrogate.inputs)
    fixed = nominal(model, [i.name for i in inputs], known)
    free = [(place, i) for place, i in enumerate(inputs) if i.name not in fixed]
    return SurrogateForward(
        surrogate,
        quantity,
        declared.kind,
        tuple(i.name for _, i in free),
        tuple(model.network.parameter(i.name).unit for _, i in free),
        tuple(float(i.low) for _, i in free),
        tuple(float(i.high) for _, i in free),
        tuple(place for place, _ in free),
        tuple(fixed.get(i.name, 0.0) for i in inputs),
    )
