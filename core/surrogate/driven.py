"""A surrogate whose inputs run in time, by amplitudes that are inputs themselves.

    x_j(t) = x_j + a s(t)        or        x_j(t) = x_j (1 + a s(t))

s is a given course that starts from 0, `a` an input like any other: calibrated, it says how strong
an effect is (coating lost by 50,000 h, gas hotter by so much), and a = 0 is the surrogate as it
was. What the blade makes of it goes through its creep (`core.surrogate.history`), so elongation,
deformation, CEEQ and damage change together, as physics has it.

For the calibration the rows are compiled to polynomials like any other (`core.surrogate.fit`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from core.archive import Input
from core.drift import Drift
from core.errors import InputError
from core.response import Response
from core.surrogate.anchor import Anchor
from core.surrogate.fit import FEWER, Fit
from core.surrogate.followed import Followed
from core.surrogate.history import FOLLOWED, follow
from core.surrogate.in_time import InTime, from_start
from core.surrogate.kept import Kept, each
from core.surrogate.model import Surrogate
from core.surrogate.targets import DEFORMATION

Array = NDArray[np.float64]
Rows = tuple[Followed, Followed | None]
MANY = 200  # inputs from which polynomials answer


@dataclass(frozen=True)
class Driven:
    """A surrogate with inputs that run in time; itself a surrogate (`core.answers`).

    ranges   of each amplitude, and of inputs at the start (default: the surrogate's own), by name;
             what they become must stay inside the surrogate's box
    fixed    inputs held at a value, which are no inputs of this surrogate
    anchor   a finer surrogate that answers where nothing runs (`core.surrogate.anchor`)

    Raises InputError for a course that leaves the surrogate's box within its horizon.
    """

    base: Surrogate
    drifts: tuple[Drift, ...]
    ranges: Mapping[str, tuple[float, float]]
    fixed: Mapping[str, float]
    anchor: Anchor | None = None

    def __post_init__(self) -> None:
        self._in_time.check(self.horizon_h)
        if self.anchor is not None:
            started = {i.name: self._in_time.range_of(i) for i in self.base.inputs}
            self.anchor.fits(self.base, started)

    @cached_property
    def _in_time(self) -> InTime:
        return InTime(self.base.inputs, self.drifts, self.ranges, self.fixed)

    @cached_property
    def inputs(self) -> tuple[Input, ...]:
        """Those of the base that are not fixed, then the amplitudes."""
        return self._in_time.inputs

    @property
    def horizon_h(self) -> float:
        return self.base.horizon_h

    @property
    def node_count(self) -> int:
        return self.base.node_count

    @property
    def named(self) -> Mapping[str, int]:
        return self.base.named

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the surrogate's own and what drives it."""
        boxes = [(i.name, float(i.low), float(i.high)) for i in self.inputs]
        text = repr((self.base.digest, self.drifts, boxes, sorted(self.fixed.items())))
        text += "" if self.anchor is None else self.anchor.digest
        if ends := [d.name for d in self.drifts if d.held]:
            text += repr(ends)
        return sha256(text.encode()).hexdigest()

    def along(
        self, x: Array, quantity: str, times: Array, nodes: Sequence[int] | None = None
    ) -> tuple[Array, Array, Array]:
        """Mean and sd of rows (n, T, R), and mean CEEQ (n, T), at hours after 0."""
        return self._along(x, times, self._rows(quantity, nodes))

    def _along(
        self, x: Array, times: Array, what: Rows, doubt: bool = True
    ) -> tuple[Array, Array, Array]:
        """Mean, sd (n, T, R) and mean CEEQ (n, T) at times for inputs x (n, d); doubt: the sd is
        asked for, which takes most of the time."""
        if np.any(times <= 0):
            raise InputError("times", times.tolist(), "are not after the start", "ask later")
        self.base.check_times(times)
        edges, held, at_times = self._in_time.until(x, times)
        rule = FOLLOWED if self.drifts else 0.0
        found = follow(self.base, edges, held, times, at_times, what[0], rule, doubt=doubt)
        if self.anchor is None or what[1] is None:
            return found
        start = self._in_time.start(x, self.anchor.asleep)
        middle = from_start(edges, held, times, at_times)
        both = (what[0], what[1])
        return self.anchor.corrected(self.base, start, middle, times, found, both, doubt)

    def _rows(self, quantity: str, nodes: Sequence[int] | None) -> Rows:
        """What is followed of the base, and of the anchor."""
        fine = None if self.anchor is None else Followed.of(self.anchor.fine, quantity, nodes)
        return Followed.of(self.base, quantity, nodes), fine

    def predict(
        self, x: Array, quantity: str, times: Array, nodes: Sequence[int] | None = None
    ) -> tuple[Array, Array]:
        """Mean and sd at inputs x (n, d): (n, T), with nodes (n, T, K) or (n, T, K, 3)."""
        times = np.atleast_1d(np.asarray(times, float))
        if len(x) >= MANY:
            return self._compiled_answers(x, quantity, times, nodes)
        return self._followed(x, quantity, times, self._rows(quantity, nodes))

    def in_blocks(
        self, x: Array, quantity: str, times: Array, nodes: Sequence[int] | None, size: int
    ) -> Iterator[tuple[Array, Array]]:
        """`predict` of so many inputs at a time, each followed: for rows too many to compile.

        What the rows are is worked out once.
        """
        times, what = np.atleast_1d(np.asarray(times, float)), self._rows(quantity, nodes)
        for start in range(0, len(x), size):
            yield self._followed(x[start : start + size], quantity, times, what)

    def _followed(self, x: Array, quantity: str, times: Array, what: Rows) -> tuple[Array, Array]:
        later = times > 0
        mean, sd = (np.zeros((len(x), len(times), what[0].curves.forms.shape[2])) for _ in range(2))
        if later.any():  # at the start nothing has grown
            mean[:, later], sd[:, later], _ = self._along(x, times[later], what)
        return self._shaped(mean, quantity), self._shaped(sd, quantity)

    def _shaped(self, rows: Array, quantity: str) -> Array:
        """(n, T, R) → (n, T), with nodes (n, T, K) or (n, T, K, 3)."""
        kind = self.base.quantities[quantity].kind
        tail = {"scalar": (), "field": (-1,), "vector field": (-1, 3)}[kind]
        return rows.reshape((*rows.shape[:2], *tail))

    def ready(
        self, count: int, quantity: str, times: Sequence[float], nodes: Sequence[int] | None = None
    ) -> None:
        """Say that `count` inputs will be asked for at these hours, by and by.

        What has to be compiled for them is compiled together: later calls of `predict` answer the
        same to the last bit, and sooner.
        """
        if count >= MANY:
            self.base.check_times(times)
            self._kept.at(quantity, times, nodes)

    @cached_property
    def _kept(self) -> Kept:
        return Kept(self.response)

    def _compiled_answers(
        self, x: Array, quantity: str, times: Array, nodes: Sequence[int] | None
    ) -> tuple[Array, Array]:
        """`predict` by polynomials, compiled once for each time; 0 at the start."""
        self.base.check_times(times)
        rows_at = self._kept.at(quantity, times.tolist(), nodes)
        basis = next((rows.basis(x) for rows in rows_at.values()), np.empty(0))
        ready = {t: rows.at(basis) for t, rows in rows_at.items()}
        found = [ready.get(float(t)) for t in times]
        width = len(self.base.rows(quantity, nodes))
        nothing = np.zeros((len(x), width))
        mean, sd = (
            np.stack([nothing if one is None else one[k] for one in found], axis=1) for k in (0, 1)
        )
        return self._shaped(mean, quantity), self._shaped(sd, quantity)

    def _compiled(self, times: Array, what: Rows, degree: int) -> Response:
        """Rows in the order of (time, row)."""
        self.base.check_times(times)
        fit = Fit(self.inputs, degree, any(d.held for d in self.drifts))
        # at the start nothing has grown
        parts = [fit.nothing(what[0].curves.forms.shape[2])] * len(times)
        later = np.flatnonzero(times > 0)
        if later.size:
            x = fit.points
            few = len(x) // FEWER
            mean, sd, ceeq = self._along(x[:few], times[later], what)
            more, _, of_more = self._along(x[few:], times[later], what, doubt=False)
            mean, ceeq = np.concatenate([mean, more]), np.concatenate([ceeq, of_more])
        # time by time: rows are the same to the last bit whatever else is asked for with them
        for t, at in enumerate(later):
            parts[at] = fit.fitted(mean[:, t], sd[:, t], ceeq[:, t, None], what[0].per_ceeq)
        return Response.stack(parts)

    def response(
        self,
        quantity: str,
        times: Sequence[float] | Array,
        nodes: Sequence[int] | None = None,
        degree: int = 5,
    ) -> Response:
        """`predict` compiled to polynomials; rows in C order of (time, node, xyz)."""
        what = self._rows(quantity, nodes)
        return self._compiled(np.atleast_1d(np.asarray(times, float)), what, degree)

    def deformation_modes(self, nodes: Sequence[int]) -> Array:
        return self.base.deformation_modes(nodes)

    def mode_covariance(self, time_h: float) -> Array:
        return self.base.mode_covariance(time_h)

    def mode_response(self, time_h: float, mixing: Array, degree: int = 5) -> Response:
        """The Q rows T c(t) E(t) for mixing T (Q, B) of the deformation's modes."""
        return self.mode_responses([time_h], mixing, degree)[0]

    def mode_responses(
        self, times: Sequence[float], mixing: Array, degree: int = 5
    ) -> list[Response]:
        """`mode_response` of each time, to the last bit; cheaper than one by one."""
        width = self.base.parts[DEFORMATION].factors.space.shape[1]
        if mixing.ndim != 2 or mixing.shape[1] != width:
            raise InputError("T", mixing.shape, "does not fit the modes", f"give (Q, {width})")
        fine = None if self.anchor is None else self.anchor.mixed(self.base, mixing)
        what = (Followed.mixed(self.base, mixing), fine)
        return each(self._compiled(np.array(times, float), what, degree), len(times))
