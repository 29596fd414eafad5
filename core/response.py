"""What readings would be: scalar rows of the model, compiled to polynomials.

A particle filter asks the model the same few questions millions of times: the elongation at
8,000 h, say, for one more value of the inputs. A surrogate answers each question in
microseconds; compiled once per question to a polynomial it answers in nanoseconds, and a
quadrature can freeze all inputs but one and be left with seven coefficients.

With the inputs scaled to the unit box, ``z = 2 (x − low) / (high − low) − 1``, a row is

    y_r(x) = a_r(z) · exp(b_r(z))

with ``a`` and ``b`` polynomials of total degree p. Three forms are special cases: a linear row
(b = 0), a logarithmic one (a = 1, b = log CEEQ) and a normalised one (elongation divided by mean
CEEQ: b = log of the mean CEEQ at that time). The surrogate's own standard deviation is

    s_r(x) = exp(b_r) · sqrt( v_r(z) · (ka_r² + (a_r kb_r)²) )

where v is the predictive variance of the Gaussian process relative to its prior (0 at a
training point, 1 far away) and ka, kb are the scales of the errors of a and b.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from core.monomials import monomials, multi_indices

Array = NDArray[np.float64]
CALIBRATED = 5  # degree of the polynomials that a calibration asks


@dataclass(frozen=True, slots=True)
class Response:
    """R rows of the model over d inputs; see the module's text for the formulas.

    names  the inputs, in order
    low    lower bounds, shape (d,)
    high   upper bounds, shape (d,)
    degree total degree p of the polynomials, M = C(d + p, p) coefficients
    a, b   coefficients, shape (R, M)
    ka, kb scales of the surrogate's error in a and in b, shape (R,)
    log_v  coefficients of log v, shape (R, M)
    """

    names: tuple[str, ...]
    low: Array
    high: Array
    degree: int
    a: Array
    b: Array
    ka: Array
    kb: Array
    log_v: Array

    def __post_init__(self) -> None:
        m = len(multi_indices(len(self.names), self.degree))
        rows = self.a.shape[0]
        if self.log_v.ndim == 1:
            object.__setattr__(self, "log_v", np.tile(self.log_v, (rows, 1)))
        for name, shape in {
            "a": (rows, m),
            "b": (rows, m),
            "log_v": (rows, m),
            "ka": (rows,),
            "kb": (rows,),
        }.items():
            got = getattr(self, name).shape
            if got != shape:
                raise ValueError(f"Response.{name} has shape {got}, expected {shape}")

    def __len__(self) -> int:
        return int(self.a.shape[0])

    def scale(self, x: Array) -> Array:
        """Inputs (n, d) to the unit box [-1, 1]."""
        return 2.0 * (x - self.low) / (self.high - self.low) - 1.0

    def evaluate(self, x: Array) -> tuple[Array, Array]:
        """Mean and surrogate standard deviation at inputs ``x`` (n, d): two arrays (n, R)."""
        return self.at(self.basis(x))

    def basis(self, x: Array) -> Array:
        """Monomials at inputs (n, d), (n, M): the same for all rows of a box and a degree."""
        return monomials(self.scale(np.atleast_2d(x)), self.degree)

    def at(self, basis: Array) -> tuple[Array, Array]:
        """`evaluate` where the monomials are known."""
        a, e = basis @ self.a.T, np.exp(basis @ self.b.T)
        v = np.exp(basis @ self.log_v.T)
        return a * e, e * np.sqrt(v * (self.ka**2 + (a * self.kb) ** 2))

    def of_input(self, name: str) -> Response:
        """One row over the same inputs that is an input itself, e.g. that of a normal prior.

        >>> x = np.linspace(0, 2, 9)[:, None]
        >>> r = Response.fit(["l"], np.array([0.0]), np.array([2.0]), 2, x, a=3 + x**2)
        >>> r.of_input("l").evaluate(np.array([[1.5]]))[0].tolist()
        [[1.5]]
        """
        j = self.names.index(name)
        half = 0.5 * (self.high[j] - self.low[j])
        a, zero, none = np.zeros((1, self.a.shape[1])), np.zeros((1, self.a.shape[1])), np.zeros(1)
        unit = np.zeros(len(self.names), dtype=np.int64)
        unit[j] = 1
        table = multi_indices(len(self.names), self.degree)
        a[0, 0] = self.low[j] + half
        a[0, np.flatnonzero((table == unit).all(axis=1))[0]] = half
        return Response(self.names, self.low, self.high, self.degree, a, zero, none, none, zero)

    def scattered(self, times: Array) -> Response:
        """The same rows with the surrogate's error so many `times` as large, (R,)."""
        return replace(self, ka=self.ka * times, kb=self.kb * times)

    def reboxed(self, low: Array, high: Array) -> Response:
        """The same rows as polynomials of inputs scaled to another box.

        >>> x = np.linspace(0, 2, 9)[:, None]
        >>> r = Response.fit(["l"], np.array([0.0]), np.array([2.0]), 2, x, a=3 + x**2)
        >>> r.reboxed(np.array([1.0]), np.array([1.5])).evaluate(
        ...     np.array([[1.5]]))[0].round(9).tolist()
        [[5.25]]
        """
        if np.array_equal(low, self.low) and np.array_equal(high, self.high):
            return self
        m = len(multi_indices(len(self.names), self.degree))
        t = np.random.default_rng(0).uniform(-1, 1, (4 * m, len(self.names)))
        there = monomials(t, self.degree)
        here = monomials(self.scale(low + (t + 1) / 2 * (high - low)), self.degree)
        turn = np.linalg.lstsq(there, here, rcond=None)[0].T
        return Response(
            self.names,
            low,
            high,
            self.degree,
            self.a @ turn,
            self.b @ turn,
            self.ka,
            self.kb,
            self.log_v @ turn,
        )

    def over(self, names: Sequence[str], low: Array, high: Array) -> Response:
        """The same rows over more inputs, on which they do not depend; boxes (d,) as given.

        >>> x = np.linspace(0, 2, 9)[:, None]
        >>> r = Response.fit(["l"], np.array([0.0]), np.array([2.0]), 2, x, a=3 + x**2)
        >>> r.over(["s", "l"], np.zeros(2), np.array([1.0, 4.0])).evaluate(
        ...     np.array([[0.3, 1.5]]))[0].round(9).tolist()
        [[5.25]]
        """
        at = [list(names).index(n) for n in self.names]
        same = self.reboxed(low[at], high[at])
        if tuple(names) == self.names:
            return same
        wide = np.zeros((same.a.shape[1], len(names)), dtype=np.int64)
        wide[:, at] = multi_indices(len(self.names), self.degree)
        place = {tuple(e): i for i, e in enumerate(multi_indices(len(names), self.degree).tolist())}
        to = [place[tuple(e)] for e in wide.tolist()]

        def spread(c: Array) -> Array:
            out = np.zeros((len(c), len(place)))
            out[:, to] = c
            return out

        a, b, log_v = spread(same.a), spread(same.b), spread(same.log_v)
        return Response(tuple(names), low, high, self.degree, a, b, self.ka, self.kb, log_v)

    def rows(self, which: NDArray[np.int64]) -> Response:
        """Some of the rows."""
        parts = (self.a, self.b, self.ka, self.kb, self.log_v)
        a, b, ka, kb, log_v = (one[which] for one in parts)
        return Response(self.names, self.low, self.high, self.degree, a, b, ka, kb, log_v)

    @staticmethod
    def stack(parts: Sequence[Response]) -> Response:
        """The rows of several responses over the same inputs and of one degree as one."""
        first = parts[0]
        for other in parts[1:]:
            same_box = np.array_equal(other.low, first.low) and np.array_equal(
                other.high, first.high
            )
            if other.names != first.names or other.degree != first.degree or not same_box:
                raise ValueError("only responses over the same inputs and degree can be stacked")
        joined = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("a", "b", "ka", "kb", "log_v")
        }
        return Response(first.names, first.low, first.high, first.degree, **joined)

    @staticmethod
    def fit(
        names: Sequence[str],
        low: Array,
        high: Array,
        degree: int,
        x: Array,
        a: Array | None = None,
        b: Array | None = None,
        ka: Array | float = 0.0,
        kb: Array | float = 0.0,
        log_v: Array | float = 0.0,
    ) -> Response:
        """Least-squares polynomials through values at design points.

        ``x`` (n, d); ``a``, ``b`` values (n, R), absent: 1 and 0; ``log_v`` values (n,) or a
        constant.

        >>> x = np.linspace(0, 2, 9)[:, None]
        >>> r = Response.fit(["l"], np.array([0.0]), np.array([2.0]), 2, x, a=3 + x**2)
        >>> r.evaluate(np.array([[1.5]]))[0].round(12).tolist()
        [[5.25]]
        """
        low, high = np.asarray(low, float), np.asarray(high, float)
        basis = monomials(2.0 * (x - low) / (high - low) - 1.0, degree)
        given = a if a is not None else b
        rows = 1 if given is None else given.shape[1]
        m = basis.shape[1]

        def coefficients(values: Array | None, constant: float) -> Array:
            if values is None:
                out = np.zeros((rows, m))
                out[:, 0] = constant
                return out
            return np.ascontiguousarray(np.linalg.lstsq(basis, values, rcond=None)[0].T)

        if isinstance(log_v, np.ndarray):
            v: Array = np.asarray(np.linalg.lstsq(basis, log_v, rcond=None)[0], float)
        else:
            v = np.zeros(m)
            v[0] = log_v
        return Response(
            tuple(names),
            low,
            high,
            degree,
            coefficients(a, 1.0),
            coefficients(b, 0.0),
            np.broadcast_to(np.asarray(ka, float), (rows,)).copy(),
            np.broadcast_to(np.asarray(kb, float), (rows,)).copy(),
            v,
        )
