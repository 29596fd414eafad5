"""The trained surrogate: inputs and times in, mean and standard deviation out.

Parts (`core.surrogate.targets`) in Tucker form (`core.surrogate.tucker`) share one Gaussian
process (`core.surrogate.kernel`). Row r of a part at time t is linear in its coefficients,

    g(t, r; x) = g0(t, r) + D(t, r) c(x),

and only the rows asked for are put together. Its error has the relative variance v(x) of the
process and the scale

    k(t, r)^2 = f^2 [ D C D^T + cut(t)^2 cut(r)^2 / v_typical ],   C = 1/n sum_i e_i e_i^T / v_i,

with e_i, v_i the leave-one-out residuals of run i: an empirical covariance, so that errors of
neighbouring nodes and instants are correlated as they are seen to be. ``cut`` is the rms that
the truncated bases leave, f makes the 95 % intervals cover 95 % in cross-validation over the
training runs. For a ratio times mean CEEQ, y = E g:

    sd(y)^2 = E^2 v ( ka^2 + g^2 kb^2 ),   ka of g, kb of log E.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.archive import Input, Quantity
from core.errors import InputError, RangeError
from core.response import Response
from core.surrogate.compile import Compiler
from core.surrogate.kernel import SharedGP
from core.surrogate.targets import DEFORMATION, ELASTIC, MEAN_CEEQ, Form, invert
from core.surrogate.tucker import Factors

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
Box = tuple[tuple[str, ...], Array, Array]
DEGREE = 6


@dataclass(frozen=True, slots=True)
class Part:
    """One target: how y comes of it, its factors, its columns of the process, its error.

    left_out  e_i / sqrt(n v_i), (J, n): C = left_out @ left_out^T
    cut_time, cut_space   rms left by the truncation, (T,) and (R,), their product is used
    inflation f of the module's text
    """

    form: Form
    factors: Factors
    columns: slice
    left_out: Array
    cut_time: Array
    cut_space: NDArray[np.float32]
    inflation: float

    def forms(self, time_h: Array, rows: Rows) -> tuple[Array, Array]:
        """g0 (T', R') and D (J, T', R')."""
        modes = self.factors.modes(time_h)
        decoded = modes @ self.factors.space[rows].T.astype(float)
        return decoded[0], decoded[1:]

    def mode_covariance(self, time_h: Array) -> Array:
        """Covariance (T', B, B) of the spatial modes' coefficients, relative to v."""
        modes = self.factors.modes(time_h)[1:]
        half = np.tensordot(modes, self.left_out, axes=(0, 0))
        return np.asarray(self.inflation**2 * (half @ half.transpose(0, 2, 1)))

    def scale(self, time_h: Array, rows: Rows, v_typical: float) -> Array:
        """k (T', R') of the module's text."""
        space = self.factors.space[rows].astype(float)
        seen = np.einsum("trb,rb->tr", space @ self.mode_covariance(time_h), space)
        cut = np.outer(self._cut_at(time_h), self.cut_space[rows]) ** 2 / v_typical
        return np.asarray(np.sqrt(np.maximum(seen, 0.0) + self.inflation**2 * cut))

    def _cut_at(self, time_h: Array) -> Array:
        return np.asarray(np.interp(time_h, self.factors.time_h, self.cut_time))


@dataclass(frozen=True, slots=True)
class Surrogate:
    """A trained surrogate. Make one with `core.surrogate.train` or load an artefact.

    inputs, time_h, quantities  what it covers; outside of it a RangeError
    points, named               the mesh's nodes (N, 3) [mm] and those with a name
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
    manifest: Mapping[str, Any] = field(default_factory=dict)
    digest: str = ""
    _compilers: dict[int, Compiler] = field(default_factory=dict, repr=False, compare=False)

    @property
    def horizon_h(self) -> float:
        """The last instant, in operating hours."""
        return float(self.time_h[-1])

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
            raise InputError(
                "x", x.shape, "is the wrong shape", f"give (n, {len(low)}): {self._names()}"
            )
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

    def _names(self) -> str:
        return ", ".join(item.name for item in self.inputs)

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
        if quantity in (DEFORMATION, "elongation", "displacement"):
            part = self.parts["elongation" if quantity == "elongation" else DEFORMATION]
            mean, variance = self._normalised(z, part, time, rows, quantity == "displacement")
        else:
            part = self.parts[quantity]
            (c,), v = self.process.mean_and_variance(z, [part.columns])
            mean = invert(part.form, part.factors.decode(c, time, rows), time)
            k = part.scale(time, rows, self.v_typical)
            variance = (k * (1.0 if part.form == "raw" else mean)) ** 2 * v[:, None, None]
        sd = np.sqrt(variance, out=variance)
        kind = self.quantities[quantity].kind
        shape = {"scalar": (), "field": (len(rows),), "vector field": (len(rows) // 3, 3)}[kind]
        return mean.reshape(*mean.shape[:2], *shape), sd.reshape(*sd.shape[:2], *shape)

    def _normalised(
        self, z: Array, part: Part, time: Array, rows: Rows, hot: bool
    ) -> tuple[Array, Array]:
        scale = self.parts[MEAN_CEEQ]
        used = [scale, part, self.parts[ELASTIC]] if hot else [scale, part]
        c, v = self.process.mean_and_variance(z, [one.columns for one in used])
        one = np.zeros(1, dtype=np.int64)
        ceeq = invert(scale.form, scale.factors.decode(c[0], time, one), time)
        ratio = part.factors.decode(c[1], time, rows)
        ka = part.scale(time, rows, self.v_typical)
        kb = scale.scale(time, one, self.v_typical)
        variance = ceeq**2 * (ka**2 + (ratio * kb) ** 2)
        mean = ratio * ceeq
        if hot:
            elastic = self.parts[ELASTIC]
            mean += elastic.factors.decode(c[2], time[:1], rows)
            variance += elastic.scale(time[:1], rows, self.v_typical) ** 2
        variance *= v[:, None, None]
        return mean, variance

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
        made = self.compiler(degree)
        box = (tuple(item.name for item in self.inputs), self.low, self.high)
        if quantity in (DEFORMATION, "elongation"):
            part = self.parts[quantity]
            ka = part.scale(time, rows, self.v_typical)
            g0, d = part.forms(time, rows)
            a = made.linear(g0.ravel(), d.reshape(len(d), -1), part.columns)
            return self._per_ceeq(box, made, time, len(rows), a, ka.ravel())
        if quantity == "displacement":
            return self._hot(box, made, time, rows)
        part = self.parts[quantity]
        g0, d = part.forms(time, rows)
        k = part.scale(time, rows, self.v_typical).ravel()
        if part.form == "log rate":
            g0 = g0 + np.log(np.maximum(time, 1e-30))[:, None]
        g = made.linear(g0.ravel(), d.reshape(len(d), -1), part.columns)
        if part.form == "raw":
            return Response(*box, degree, g, np.zeros_like(g), k, np.zeros_like(k), made.log_v)
        ones = made.constant(np.ones(len(g)))
        return Response(*box, degree, ones, g, np.zeros_like(k), k, made.log_v)

    def _log_ceeq(self, made: Compiler, time: Array) -> tuple[Array, Array]:
        """Polynomials of log E (T, M) and kb (T,)."""
        scale = self.parts[MEAN_CEEQ]
        one = np.zeros(1, dtype=np.int64)
        g0, d = scale.forms(time, one)
        logs = g0[:, 0] + np.log(np.maximum(time, 1e-30))
        kb = scale.scale(time, one, self.v_typical)[:, 0]
        return made.linear(logs, d[:, :, 0], scale.columns), kb

    def _per_ceeq(
        self, box: Box, made: Compiler, time: Array, width: int, a: Array, ka: Array
    ) -> Response:
        b, kb = (np.repeat(one, width, axis=0) for one in self._log_ceeq(made, time))
        return Response(*box, made.degree, a, b, ka, kb, made.log_v)

    def _hot(self, box: Box, made: Compiler, time: Array, rows: Rows) -> Response:
        """u0 + E g as a exp(b) with b = log(E0 + E): E0 is the middle of E at the horizon."""
        samples, elastic, part = made.samples, self.parts[ELASTIC], self.parts[DEFORMATION]
        scale = self.parts[MEAN_CEEQ]
        one = np.zeros(1, dtype=np.int64)
        clock = np.append(time, self.horizon_h)
        every = invert(
            scale.form, scale.factors.decode(samples[:, scale.columns], clock, one), clock
        )
        ceeq, middle = every[:, :-1], float(np.exp(np.mean(np.log(every[:, -1]))))
        g = part.factors.decode(samples[:, part.columns], time, rows)
        u0 = elastic.factors.decode(samples[:, elastic.columns], time[:1], rows)
        a = made.fit(((u0 + ceeq * g) / (middle + ceeq)).reshape(len(samples), -1))
        b = np.repeat(made.fit(np.log(middle + ceeq[:, :, 0])), len(rows), axis=0)
        share = np.mean(ceeq / (middle + ceeq), axis=0)
        ka = part.scale(time, rows, self.v_typical) * share
        k0 = elastic.scale(time[:1], rows, self.v_typical) * np.mean(1 / (middle + ceeq), axis=0)
        kb = scale.scale(time, one, self.v_typical) * np.abs(share * np.mean(g, axis=0))
        ka = np.sqrt(ka**2 + k0**2 + kb**2).ravel()
        return Response(*box, made.degree, a, b, ka, np.zeros_like(ka), made.log_v)

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
        time = self.check_times(time_h)
        part, made = self.parts[DEFORMATION], self.compiler(degree)
        modes = part.factors.modes(time)[:, 0]
        if mixing.ndim != 2 or mixing.shape[1] != modes.shape[1]:
            raise InputError(
                "T", mixing.shape, "does not fit the modes", f"give (Q, {modes.shape[1]})"
            )
        rows = modes @ mixing.T
        a = made.linear(rows[0], rows[1:], part.columns)
        ka = np.sqrt(np.einsum("qb,bc,qc->q", mixing, self.mode_covariance(time_h), mixing))
        box = (tuple(item.name for item in self.inputs), self.low, self.high)
        return self._per_ceeq(box, made, time, len(rows[0]), a, ka)
