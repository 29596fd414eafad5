"""The trained surrogate: inputs and times in, mean and standard deviation out.

Parts (`core.surrogate.part`) in Tucker form (`core.surrogate.tucker`) share one Gaussian process
(`core.surrogate.kernel`) with one relative variance v(x). Only the rows asked for are put
together, a block of inputs at a time. With k the scale of a part's error and p its power,

    log y = g            sd(y) = y k v^(p/2)                                      CEEQ, damage
    y = g                sd(y) = k v^(p/2)
    y = E g              sd(y) = E sqrt( v (ka^2 + g^2 kb^2) ), ka of g, kb of log E

where E is the mean CEEQ: elongation and permanent deformation. The hot displacement adds the
field at 0+ and its error.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.archive import Input, Quantity
from core.errors import InputError, RangeError
from core.response import Response
from core.surrogate.compile import Compiled, Compiler
from core.surrogate.kernel import SharedGP
from core.surrogate.part import Part, Rows
from core.surrogate.targets import DEFORMATION, ELASTIC, MEAN_CEEQ, invert

Array = NDArray[np.float64]
Evaluate = Callable[[Array], tuple[Array, Array]]
DEGREE = 6
BLOCK = 1024


@dataclass(frozen=True, slots=True)
class Surrogate:
    """A trained surrogate. Make one with `core.surrogate.train` or load an artefact.

    inputs, time_h, quantities  what it covers; outside of it a RangeError
    points, named               the mesh's nodes (N, 3) [mm] and those with a name
    cells                       of a user's mesh: kind (`core.archive.cells`), node numbers (E, n)
    manifest                    where it comes from and how well it did (JSON-able)
    digest                      SHA-256 of its content
    """

    inputs: tuple[Input, ...]
    time_h: Array
    quantities: Mapping[str, Quantity]
    points: Array
    named: Mapping[str, int]
    process: SharedGP
    parts: Mapping[str, Part]
    v_typical: float
    cells: tuple[str, NDArray[np.int64]] | None = None
    manifest: Mapping[str, Any] = field(default_factory=dict)
    digest: str = ""
    _compilers: dict[int, Compiler] = field(default_factory=dict, repr=False, compare=False)

    @property
    def horizon_h(self) -> float:
        """The last instant, in operating hours."""
        return float(self.time_h[-1])

    @property
    def node_count(self) -> int:
        """Nodes of the model's mesh."""
        return len(self.points)

    @property
    def low(self) -> Array:
        """Lower bounds of the inputs, (d,)."""
        return np.array([item.low for item in self.inputs])

    @property
    def high(self) -> Array:
        """Upper bounds of the inputs, (d,)."""
        return np.array([item.high for item in self.inputs])

    def scaled(self, x: Array) -> Array:
        """Inputs (n, d) to [-1, 1]; outside of the box a RangeError."""
        x = np.atleast_2d(np.asarray(x, dtype=float))
        low, high = self.low, self.high
        if x.shape[1] != len(low):
            names = ", ".join(item.name for item in self.inputs)
            raise InputError("x", x.shape, "is the wrong shape", f"give (n, {len(low)}): {names}")
        inside = (x >= low - 1e-9 * (high - low)) & (x <= high + 1e-9 * (high - low))
        if not np.all(inside):
            i, j = (int(k) for k in np.argwhere(~inside)[0])
            raise RangeError(
                f"x[{i}], {self.inputs[j].name}",
                float(x[i, j]),
                f"lies outside {low[j]:g} … {high[j]:g}",
                "stay inside the runs or train on a wider box",
            )
        return np.asarray(2.0 * (x - low) / (high - low) - 1.0)

    def check_times(self, times: Sequence[float] | Array | float) -> Array:
        """Times (T,) inside 0 … horizon, or a RangeError."""
        time = np.atleast_1d(np.asarray(times, dtype=float))
        bad = np.flatnonzero(~((time >= 0) & (time <= self.horizon_h)))
        if len(bad):
            raise RangeError(
                f"times[{bad[0]}]",
                float(time[bad[0]]),
                f"lies outside 0 … {self.horizon_h:g} h",
                "ask inside the horizon",
            )
        return time

    def rows(self, quantity: str, nodes: Sequence[int] | Array | None) -> Rows:
        """Row numbers of a quantity at nodes, in C order of (node, xyz)."""
        if quantity not in self.quantities:
            raise InputError(
                "quantity", quantity, "is unknown", f"use one of {', '.join(self.quantities)}"
            )
        kind = self.quantities[quantity].kind
        if kind == "scalar":
            if nodes is not None:
                raise InputError("nodes", nodes, f"mean nothing for {quantity}", "leave them out")
            return np.zeros(1, dtype=np.int64)
        count = len(self.points)
        chosen = np.arange(count) if nodes is None else np.asarray(nodes)
        bad = np.flatnonzero((chosen < 0) | (chosen >= count) | (chosen != np.floor(chosen)))
        if len(bad):
            raise RangeError(
                f"nodes[{bad[0]}]",
                chosen[bad[0]].item(),
                f"is not in 0 … {count - 1}",
                "use node numbers of the model's mesh",
            )
        chosen = chosen.astype(np.int64)
        if kind == "field":
            return chosen
        return np.asarray((3 * chosen[:, None] + np.arange(3)).ravel())

    def predict(
        self,
        x: Array,
        quantity: str,
        times: Sequence[float] | Array,
        nodes: Sequence[int] | None = None,
    ) -> tuple[Array, Array]:
        """Mean and sd at inputs x (n, d): (n, T), with nodes (n, T, K) or (n, T, K, 3)."""
        time, rows = self.check_times(times), self.rows(quantity, nodes)
        z = self.scaled(x)
        if self._creeps(quantity):
            evaluate = self._normalised(quantity, time, rows)
        else:
            evaluate = self._direct(self.parts[quantity], time, rows)
        mean = np.empty((len(z), len(time), len(rows)))
        sd = np.empty_like(mean)
        for start in range(0, len(z), BLOCK):
            block = slice(start, start + BLOCK)
            mean[block], variance = evaluate(z[block])
            np.sqrt(variance, out=sd[block])
        kind = self.quantities[quantity].kind
        shape = {"scalar": (), "field": (len(rows),), "vector field": (len(rows) // 3, 3)}[kind]
        return mean.reshape(*mean.shape[:2], *shape), sd.reshape(*sd.shape[:2], *shape)

    def _creeps(self, quantity: str) -> bool:
        """Whether it is put together with mean CEEQ; else it is a part of its own."""
        return quantity not in self.parts or self.parts[quantity].form == "per ceeq"

    def _direct(self, part: Part, time: Array, rows: Rows) -> Evaluate:
        decode = part.factors.decoder(time, rows)
        square = part.scale(time, rows, self.v_typical) ** 2

        def evaluate(z: Array) -> tuple[Array, Array]:
            (c,), v = self.process.mean_and_variance(z, [part.columns])
            mean = invert(part.form, decode(c), time)
            spread = square * part.relative(v)[:, None, None]
            return mean, spread if part.form == "raw" else spread * mean**2

        return evaluate

    def _normalised(self, quantity: str, time: Array, rows: Rows) -> Evaluate:
        part = self.parts["elongation" if quantity == "elongation" else DEFORMATION]
        scale, one, start = self.parts[MEAN_CEEQ], np.zeros(1, dtype=np.int64), time[:1]
        used = [scale.columns, part.columns]
        decode_log, decode = scale.factors.decoder(time, one), part.factors.decoder(time, rows)
        ka2 = part.scale(time, rows, self.v_typical) ** 2
        kb2 = scale.scale(time, one, self.v_typical) ** 2
        hot = self.parts[ELASTIC] if quantity == "displacement" else None
        if hot is not None:
            used.append(hot.columns)
            decode_hot = hot.factors.decoder(start, rows)
            k02 = hot.scale(start, rows, self.v_typical) ** 2

        def evaluate(z: Array) -> tuple[Array, Array]:
            c, v = self.process.mean_and_variance(z, used)
            ceeq = invert(scale.form, decode_log(c[0]), time)
            mean = decode(c[1])
            variance = np.square(mean)
            variance *= kb2
            variance += ka2
            variance *= ceeq**2
            mean *= ceeq
            if hot is not None:
                mean += decode_hot(c[2])
                variance += k02
            variance *= v[:, None, None]
            return mean, variance

        return evaluate

    def compiler(self, degree: int = DEGREE) -> Compiler:
        """The polynomials of all coefficients, made at the first call and kept."""
        if degree not in self._compilers:
            self._compilers[degree] = Compiler.of(self.process, degree)
        return self._compilers[degree]

    def response(
        self,
        quantity: str,
        times: Sequence[float] | Array,
        nodes: Sequence[int] | None = None,
        degree: int = DEGREE,
    ) -> Response:
        """`predict` compiled to polynomials; rows in C order of (time, node, xyz)."""
        time, rows = self.check_times(times), self.rows(quantity, nodes)
        make = Compiled(self, self.compiler(degree), time)
        if quantity == "displacement" and self._creeps(quantity):
            return make.hot(rows)
        if self._creeps(quantity):
            return make.per_ceeq(self.parts[quantity], rows)
        return make.direct(self.parts[quantity], rows)

    def deformation_modes(self, nodes: Sequence[int] | None = None) -> Array:
        """Phi (n_nodes, 3, B): permanent deformation = E(t; x) sum_b Phi_b c_b(t; x)."""
        rows = self.rows(DEFORMATION, nodes)
        return (
            self.parts[DEFORMATION].factors.space[rows].astype(float).reshape(len(rows) // 3, 3, -1)
        )

    def mode_covariance(self, time_h: float) -> Array:
        """C (B, B), covariance of the error of c at a time, relative to v(x)."""
        time = self.check_times(time_h)
        return np.asarray(self.parts[DEFORMATION].mode_covariance(time)[0])

    def mode_response(self, time_h: float, mixing: Array, degree: int = DEGREE) -> Response:
        """The Q rows E(t; x) T c(t; x) for mixing T (Q, B); ka^2 = diag(T C T^T)."""
        time, width = self.check_times(time_h), self.parts[DEFORMATION].factors.space.shape[1]
        if mixing.ndim != 2 or mixing.shape[1] != width:
            raise InputError("T", mixing.shape, "does not fit the modes", f"give (Q, {width})")
        return Compiled(self, self.compiler(degree), time).modes(mixing)
