"""A surrogate whose inputs run in time, by amplitudes that are inputs themselves.

    x_j(t) = x_j + a s(t)        or        x_j(t) = x_j (1 + a s(t))

s is a given course that starts from 0, `a` an input like any other: calibrated, it says how strong
an effect is (coating lost by 50,000 h, gas hotter by so much), and a = 0 is the surrogate as it
was. What the blade makes of it goes through its creep (`core.surrogate.history`), so elongation,
deformation, CEEQ and damage change together, as physics has it.

For the calibration the rows are compiled to polynomials like any other (`core.surrogate.fit`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from core.archive import Input
from core.drift import Drift
from core.errors import InputError
from core.pools import both
from core.response import Response
from core.surrogate.anchor import Anchor
from core.surrogate.fit import FEWER, Fit
from core.surrogate.followed import Followed
from core.surrogate.history import FOLLOWED, Answer, follow
from core.surrogate.in_time import InTime, from_start
from core.surrogate.kept import Kept, Wanted
from core.surrogate.model import Surrogate
from core.surrogate.targets import DEFORMATION

Array = NDArray[np.float64]
Rows = tuple[Followed, Followed | None]
MANY = 200  # inputs from which polynomials answer
DEGREE = 5  # of these


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
        self.in_time.check(self.horizon_h)
        if self.anchor is not None:
            started = {i.name: self.in_time.range_of(i) for i in self.base.inputs}
            self.anchor.fits(self.base, started)

    @cached_property
    def in_time(self) -> InTime:
        """What the base's own inputs are over time."""
        return InTime(self.base.inputs, self.drifts, self.ranges, self.fixed)

    @cached_property
    def inputs(self) -> tuple[Input, ...]:
        """Those of the base that are not fixed, then the amplitudes."""
        return self.in_time.inputs

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
        return self._along(x, times, [self._rows(quantity, nodes)])[0]

    def _along(
        self, x: Array, times: Array, what: Sequence[Rows], doubt: bool = True
    ) -> list[Answer]:
        """Of each quantity mean, sd (n, T, R) and mean CEEQ (n, T) at times for inputs x (n, d);
        doubt: the sd is asked for, which takes most of the time."""
        if np.any(times <= 0):
            raise InputError("times", times.tolist(), "are not after the start", "ask later")
        self.base.check_times(times)
        edges, held, at_times = self.in_time.until(x, times)
        rule = FOLLOWED if self.drifts else 0.0
        wide = [one[0] for one in what]
        found = follow(self.base, edges, held, times, at_times, wide, rule, doubt=doubt, late=True)
        both = [(own, fine) for own, fine in what if fine is not None]
        if self.anchor is None or not both:
            return found
        start = self.in_time.start(x, self.anchor.asleep)
        middle = from_start(edges, held, times, at_times)
        return self.anchor.corrected(self.base, start, middle, times, found, both, doubt)

    def _rows(self, quantity: str, nodes: Sequence[int] | None) -> Rows:
        """What is followed of the base, and of the anchor."""
        fine = None if self.anchor is None else Followed.of(self.anchor.fine, quantity, nodes)
        return Followed.of(self.base, quantity, nodes), fine

    def predict(
        self, x: Array, quantity: str, times: Array, nodes: Sequence[int] | None = None
    ) -> tuple[Array, Array]:
        """Mean and sd at inputs x (n, d): (n, T), with nodes (n, T, K) or (n, T, K, 3)."""
        times = self.base.check_times(times)
        if len(x) >= MANY:
            return self._compiled_answers(self.in_time.checked(x), quantity, times, nodes)
        return self._followed(x, quantity, times, self._rows(quantity, nodes))

    def in_blocks(
        self, x: Array, quantity: str, times: Array, nodes: Sequence[int] | None, size: int
    ) -> Iterator[tuple[Array, Array]]:
        """`predict` of so many inputs at a time, each followed: for rows too many to compile.

        What the rows are is worked out once.
        """
        times, what = self.base.check_times(times), self._rows(quantity, nodes)
        for start in range(0, len(x), size):
            yield self._followed(x[start : start + size], quantity, times, what)

    def _followed(self, x: Array, quantity: str, times: Array, what: Rows) -> tuple[Array, Array]:
        later = times > 0
        mean, sd = (np.zeros((len(x), len(times), what[0].curves.forms.shape[2])) for _ in range(2))
        if later.any():  # at the start nothing has grown
            ((mean[:, later], sd[:, later], _),) = self._along(x, times[later], [what])
        return self._shaped(mean, quantity), self._shaped(sd, quantity)

    def _shaped(self, rows: Array, quantity: str) -> Array:
        """(n, T, R) → (n, T), with nodes (n, T, K) or (n, T, K, 3)."""
        kind = self.base.quantities[quantity].kind
        tail = {"scalar": (), "field": (-1,), "vector field": (-1, 3)}[kind]
        return rows.reshape((*rows.shape[:2], *tail))

    def ready(self, count: int, asked: Mapping[Wanted, Iterable[float]]) -> None:
        """Say that `count` inputs will be asked for these rows at these hours, by and by.

        What has to be compiled for them is compiled together: later calls of `predict` and
        `mode_responses` answer the same to the last bit, and sooner.
        """
        own = {w: list(h) for w, h in asked.items() if w.mixing is not None or count >= MANY}
        for hours in own.values():
            self.base.check_times(hours)
        self._kept.ready(own)

    @cached_property
    def _kept(self) -> Kept:
        return Kept(self.compiled)

    def _compiled_answers(
        self, x: Array, quantity: str, times: Array, nodes: Sequence[int] | None
    ) -> tuple[Array, Array]:
        """`predict` by polynomials, compiled once for each time; 0 at the start."""
        rows_at = self._kept.at(Wanted.of(quantity, nodes), times.tolist())
        basis = next((rows.basis(x) for rows in rows_at.values()), np.empty(0))
        ready = {t: rows.at(basis) for t, rows in rows_at.items()}
        found = [ready.get(float(t)) for t in times]
        width = len(self.base.rows(quantity, nodes))
        nothing = np.zeros((len(x), width))
        mean, sd = (
            np.stack([nothing if one is None else one[k] for one in found], axis=1) for k in (0, 1)
        )
        return self._shaped(mean, quantity), self._shaped(sd, quantity)

    def compiled(
        self, wanted: Sequence[Wanted], times: Sequence[float], degree: int = DEGREE
    ) -> list[list[Response]]:
        """Rows of each of these, by time."""
        time, what = np.array(times, float), [self._followed_for(one) for one in wanted]
        self.base.check_times(time)
        fit = Fit(self.inputs, degree, any(d.held for d in self.drifts))
        # at the start nothing has grown
        parts = [[fit.nothing(own.curves.forms.shape[2])] * len(time) for own, _ in what]
        later = np.flatnonzero(time > 0)
        if later.size:
            x, few, hours = fit.points, len(fit.points) // FEWER, time[later]
            sure = partial(self._along, x[:few], hours, what)
            known, more = both(sure, partial(self._along, x[few:], hours, what, doubt=False))
            for rows, (own, _), first, rest in zip(parts, what, known, more, strict=True):
                for at, row in zip(later, fit.by_time(first, rest, own.per_ceeq), strict=True):
                    rows[at] = row
        return parts

    def _followed_for(self, wanted: Wanted) -> Rows:
        """What is followed for rows."""
        if wanted.mixing is None:
            return self._rows(wanted.quantity, wanted.nodes)
        mixing = np.array(wanted.mixing)
        fine = None if self.anchor is None else self.anchor.mixed(self.base, mixing)
        return Followed.mixed(self.base, mixing), fine

    def response(
        self,
        quantity: str,
        times: Sequence[float] | Array,
        nodes: Sequence[int] | None = None,
        degree: int = DEGREE,
    ) -> Response:
        """`predict` compiled to polynomials; rows in C order of (time, node, xyz)."""
        hours = np.atleast_1d(np.asarray(times, float)).tolist()
        return Response.stack(self.compiled([Wanted.of(quantity, nodes)], hours, degree)[0])

    def deformation_modes(self, nodes: Sequence[int]) -> Array:
        return self.base.deformation_modes(nodes)

    def mode_covariance(self, time_h: float) -> Array:
        return self.base.mode_covariance(time_h)

    def mode_response(self, time_h: float, mixing: Array, degree: int = DEGREE) -> Response:
        """The Q rows T c(t) E(t) for mixing T (Q, B) of the deformation's modes."""
        return self.compiled([self._mixed(mixing)], [time_h], degree)[0][0]

    def mode_responses(self, times: Sequence[float], mixing: Array) -> list[Response]:
        """`mode_response` of each time after 0, to the last bit; cheaper, and kept."""
        self.base.check_times(times)
        found = self._kept.at(self._mixed(mixing), times)
        return [found[float(t)] for t in times]

    def _mixed(self, mixing: Array) -> Wanted:
        width = self.base.parts[DEFORMATION].factors.space.shape[1]
        if mixing.ndim != 2 or mixing.shape[1] != width:
            raise InputError("T", mixing.shape, "does not fit the modes", f"give (Q, {width})")
        return Wanted.of(DEFORMATION, mixing=mixing)
