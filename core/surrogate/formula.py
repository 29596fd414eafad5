"""A model given by a formula, in place of a surrogate of simulation runs.

A creep law in closed form, say; checks against exact answers; users' own tests. Everything that
needs a surrogate (calibration, prediction, the service) runs on it unchanged.

Its rows are compiled to polynomials over the whole box of the inputs, as a surrogate's are; where
inputs span decades, use a `core.surrogate.closed_form.ClosedForm`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError, RangeError
from core.monomials import multi_indices
from core.response import Response

Array = NDArray[np.float64]
Formula = Callable[..., Array]


@dataclass(frozen=True, slots=True)
class FormulaInput:
    """An input and its range."""

    name: str
    low: float
    high: float


@dataclass(frozen=True)
class FormulaModel:
    """Quantities y(x, t) by formula: x (n, d) inputs, t hours → (n,).

    positive   quantities whose logarithm is compiled to polynomials, not the value itself
    digest     must change when the formulas do
    """

    inputs: tuple[FormulaInput, ...]
    formulas: Mapping[str, Formula]
    name: str
    horizon_h: float = 1e5
    positive: tuple[str, ...] = ()
    node_count: int = 1

    @property
    def named(self) -> dict[str, int]:
        return {"tip": 0, "critical": 0}

    @property
    def digest(self) -> str:
        text = f"{self.name}{self.inputs}{sorted(self.formulas)}{self.positive}"
        return sha256(text.encode()).hexdigest()

    @property
    def low(self) -> Array:
        return np.array([i.low for i in self.inputs])

    @property
    def high(self) -> Array:
        return np.array([i.high for i in self.inputs])

    def _formula(self, quantity: str) -> Formula:
        if quantity not in self.formulas:
            raise InputError("quantity", quantity, "has no formula", f"one of {[*self.formulas]}")
        return self.formulas[quantity]

    def predict(
        self, x: Array, quantity: str, times: Array, nodes: Sequence[int] | None = None
    ) -> tuple[Array, Array]:
        """Exact values (n, T), standard deviation zero; fields get a node axis."""
        formula = self._formula(quantity)
        mean = np.stack([formula(x, float(t)) for t in np.atleast_1d(times)], axis=1)
        if nodes is not None:
            mean = mean[:, :, None]
        return mean, np.zeros_like(mean)

    def response(
        self,
        quantity: str,
        times: Sequence[float] | Array,
        nodes: Sequence[int] | None = None,
        degree: int = 5,
    ) -> Response:
        """The formula compiled to polynomials on a seeded design of 8 M points."""
        formula = self._formula(quantity)
        d = len(self.inputs)
        count = 8 * len(multi_indices(d, degree))
        x = self.low + np.random.default_rng(0).random((count, d)) * (self.high - self.low)
        values = np.stack([formula(x, float(t)) for t in np.atleast_1d(times)], axis=1)
        names = [i.name for i in self.inputs]
        if quantity in self.positive:
            log = np.log(np.maximum(values, np.finfo(float).tiny))  # 0 at the start, say
            return Response.fit(names, self.low, self.high, degree, x, b=log)
        return Response.fit(names, self.low, self.high, degree, x, a=values)

    def deformation_modes(self, nodes: Sequence[int]) -> Array:
        raise RangeError("nodes", len(nodes), "have no modes in a formula", "post scalar readings")

    def mode_response(self, time_h: float, mixing: Array, degree: int = 5) -> Response:
        raise RangeError("time_h", time_h, "has no modes in a formula", "post scalar readings")

    def mode_covariance(self, time_h: float) -> Array:
        raise RangeError("time_h", time_h, "has no modes in a formula", "post scalar readings")
