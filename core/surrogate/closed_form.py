"""A formula that is asked, not compiled, where its inputs span decades.

Over rates of creep from 1e-7 to 1 per hour no polynomial follows exp(c r t). A `ClosedForm` is
asked itself by the calibration: exactly in shared, known and dormant inputs, and as a polynomial
in the local ones only where the readings leave any likelihood (`core.calibration.windows`). How
far the readings exclude the rest is bounded, not guessed: a formula that rises or falls with each
local input lies, over a box, between its values at two corners.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError, ModelError
from core.response import Response
from core.surrogate.formula import FormulaModel

Array = NDArray[np.float64]
PROBES = 64  # places at which a closed form is held against what it declares
DIGITS = 7  # of its values there that its digest rests on: fewer than machines differ in
MISSED = 0.01  # share of its value by which a polynomial over the whole box may miss it


@dataclass(frozen=True)
class ClosedForm(FormulaModel):
    """Formulas y(x, t) that are asked, not compiled: x (…, d) and t broadcast, → the same shape.

    rising, falling   inputs in which no quantity ever falls, or rises, over its range

    Raises InputError where a formula breaks that at one of `PROBES` places.
    """

    rising: tuple[str, ...] = ()
    falling: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        declared = (*self.rising, *self.falling)
        known = [i.name for i in self.inputs]
        wrong = sorted({n for n in declared if n not in known or declared.count(n) > 1})
        if wrong:
            raise InputError(
                "rising or falling", wrong, "is no input, or is named twice", f"use {known}"
            )
        x, times = self._probes
        for quantity in self.formulas:
            here = self.values(quantity, x, times)
            for name in declared:
                there = x.copy()
                j = known.index(name)
                there[:, j] += 0.25 * (self.high[j] - there[:, j])
                step = (self.values(quantity, there, times) - here) * self.direction(name)
                if not np.all(step >= -1e-9 * np.abs(here)):
                    bad = np.argwhere(~(step >= -1e-9 * np.abs(here)))[0]
                    raise InputError(
                        f"{quantity} in {name}",
                        x[bad[0]].tolist(),
                        "goes the other way than declared",
                        "correct rising and falling, or the formula",
                    )

    @cached_property
    def _probes(self) -> tuple[Array, Array]:
        """Places (PROBES, d) spread over the box, and four times [h]."""
        roots = np.sqrt([2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37])
        j = np.arange(len(self.inputs))  # beyond the twelfth, of multiples of the roots
        steps = roots[j % len(roots)] * (1 + j // len(roots)) % 1.0
        shares = (0.5 + np.arange(PROBES)[:, None] * steps) % 1.0
        return self.low + shares * (self.high - self.low), self.horizon_h * 0.1 ** np.arange(4.0)

    @cached_property
    def _fingerprint(self) -> str:
        x, times = self._probes
        values = [self.values(q, x, times).ravel() for q in sorted(self.formulas)]
        return " ".join(f"{v:.{DIGITS - 1}e}" for v in np.concatenate(values))

    @property
    def named(self) -> dict[str, int]:
        """A closed form has no nodes: its quantities are scalars."""
        return {}

    @property
    def manifest(self) -> dict[str, object]:
        """What it is, for whoever asks what a model is and how good: exact."""
        inputs = {i.name: [i.low, i.high] for i in self.inputs}
        return {"kind": "closed form", "inputs": inputs, "errors": None}

    @property
    def digest(self) -> str:
        """SHA-256 over the declaration and the formulas' own values at the probes.

        It changes with what the formulas answer, not with how they are written.
        """
        text = f"{super().digest}{self.rising}{self.falling}{self.horizon_h}{self._fingerprint}"
        return sha256(text.encode()).hexdigest()

    def direction(self, name: str) -> int:
        """1 where the formulas rise with an input, −1 where they fall, 0 where neither is known."""
        return (name in self.rising) - (name in self.falling)

    def values(self, quantity: str, x: Array, times: Array) -> Array:
        """Exact values (n, T) at inputs x (n, d) and times (T,)."""
        return np.asarray(self._formula(quantity)(x[:, None, :], np.asarray(times, float)), float)

    def rows(self, quantity: str, times: Sequence[float] | Array) -> FormulaRows:
        """The rows of readings at these times, answered by the formula itself."""
        self._formula(quantity)
        asked = tuple((quantity, float(t)) for t in np.atleast_1d(times))
        return FormulaRows(self, tuple(i.name for i in self.inputs), self.low, self.high, asked)

    def response(
        self,
        quantity: str,
        times: Sequence[float] | Array,
        nodes: Sequence[int] | None = None,
        degree: int = 5,
    ) -> Response:
        """Polynomials over the whole box, where they hold.

        Raises ModelError where they miss the formula by more than `MISSED` of its value.
        """
        made = super().response(quantity, times, nodes, degree)
        exact = self.values(quantity, self._probes[0], np.atleast_1d(times))
        missed = np.abs(made.evaluate(self._probes[0])[0] - exact).max(axis=0)
        worst = missed / np.maximum(np.abs(exact).max(axis=0), 1e-300)
        if not np.all(worst <= MISSED):
            at = float(np.atleast_1d(times)[np.argmax(~(worst <= MISSED))])
            raise ModelError(
                f"{quantity} of {self.name} at {at:g} h is no polynomial of degree {degree} over "
                f"the whole box of its inputs: off by {float(np.nanmax(worst)):.2g} of its largest "
                "value. Ask for its rows (ClosedForm.rows) or values, or narrow the inputs."
            )
        return made


@dataclass(frozen=True)
class FormulaRows:
    """R rows over d inputs that a closed form answers; it stands where a `Response` does.

    names, low, high  inputs and their box, (d,)
    asked             per row: (quantity, time in h), or the name of an input, which the row is
    """

    model: ClosedForm
    names: tuple[str, ...]
    low: Array
    high: Array
    asked: tuple[tuple[str, float] | str, ...]

    def __len__(self) -> int:
        return len(self.asked)

    @cached_property
    def _parts(self) -> list[tuple[str, Array, list[int]]]:
        """(quantity, times, rows) of the rows that the formulas answer."""
        found: dict[str, list[tuple[float, int]]] = {}
        for r, one in enumerate(self.asked):
            if not isinstance(one, str):
                found.setdefault(one[0], []).append((one[1], r))
        return [(q, np.array([t for t, _ in own]), [r for _, r in own]) for q, own in found.items()]

    def evaluate(self, x: Array) -> tuple[Array, Array]:
        """Exact values at inputs ``x`` (n, d) and their standard deviation, zero: (n, R) each."""
        x = np.atleast_2d(x)
        out = np.empty((len(x), len(self)))
        own = x[:, [self.names.index(i.name) for i in self.model.inputs]]
        for quantity, times, rows in self._parts:
            out[:, rows] = self.model.values(quantity, own, times)
        for r, one in enumerate(self.asked):
            if isinstance(one, str):
                out[:, r] = x[:, self.names.index(one)]
        return out, np.zeros_like(out)

    def of_input(self, name: str) -> FormulaRows:
        """One row that is an input itself, e.g. that of a normal prior."""
        return FormulaRows(self.model, self.names, self.low, self.high, (name,))

    def scattered(self, times: Array) -> FormulaRows:
        """The same rows: there is no surrogate's error to be larger."""
        return self

    def over(self, names: Sequence[str], low: Array, high: Array) -> FormulaRows:
        """The same rows over more inputs, on which they do not depend; boxes (d,) as given."""
        return FormulaRows(self.model, tuple(names), low, high, self.asked)

    @staticmethod
    def stack(parts: Sequence[FormulaRows]) -> FormulaRows:
        """The rows of several as one; all of one closed form and over the same inputs."""
        first = parts[0]
        if any(p.model is not first.model or p.names != first.names for p in parts):
            raise ModelError(
                "readings of one blade are answered by two models, one of them a closed form: "
                "give each model's readings to a blade of its own"
            )
        asked = tuple(one for part in parts for one in part.asked)
        return FormulaRows(first.model, first.names, first.low, first.high, asked)
