"""Fields of several runs as spatial modes x time modes x coefficients (a Tucker form).

The values of run i at instant t and row r (a node, or a node's x, y or z) are

    y_i(t, r) = sum_ab tau_a(t) phi_b(r) [ G0_ab + sum_j c_ij G_jab ],

phi from the randomised SVD of all snapshots, tau from the projections on phi, and the G_j with
their coefficients c from the projections on both (sequentially truncated, N. Vannieuwenhoven,
R. Vandebril, K. Meerbergen, SIAM J. Sci. Comput. 34 (2012) A1027-A1052). Ranks are the smallest
that leave a root-mean-square residual below a tolerance, up to a cap.

Between the instants the tau are cubic splines in log t; before the first instant t1 > 0 they
keep their value at t1. A part that has a value at t = 0 as well uses log(1 + t / t*): in
log(1 + t) the hours from 0 to a first instant at 500 are most of the axis, and a cubic is free to
swing there. t* is one of 1 h up to ten times the last instant, the one whose cubics foretell
instants best from the others and swing least from monotone ones; 1 h where instants begin at 1 h
or before and follow each other within a decade.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator

from core.reduction import Basis

Array = NDArray[np.float64]
Floats = NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True)
class Ranks:
    """Caps of the ranks, and the residual that is small enough to stop below them."""

    space: int
    time: int
    coefficients: int
    tolerance: float


DECADE = 10.0 * (1 + 1e-9)
TURNS = 8


@dataclass(frozen=True, slots=True)
class Factors:
    """space (R, B) float32, time (T, A) at `time_h` (T,), core (1 + J, A, B), row 0 = G0.

    early_h  t* of the module's text
    """

    space: NDArray[np.float32]
    time: Array
    time_h: Array
    core: Array
    early_h: float = 1.0

    @property
    def coefficients(self) -> int:
        """J, the number of coefficients."""
        return len(self.core) - 1

    def at(self, time_h: Array) -> Array:
        """Time modes at any times, (T', A)."""
        if len(self.time_h) == 1:
            return np.repeat(self.time, len(time_h), axis=0)
        if self.time_h[0] > 0:
            clock, asked = np.log(self.time_h), np.log(np.maximum(time_h, self.time_h[0]))
        else:
            clock, asked = np.log1p(self.time_h / self.early_h), np.log1p(time_h / self.early_h)
        return np.asarray(CubicSpline(clock, self.time, axis=0)(asked))

    def modes(self, time_h: Array) -> Array:
        """The forms of the coefficients of the spatial modes at times, (1 + J, T', B)."""
        return np.asarray(np.einsum("ta,jab->jtb", self.at(time_h), self.core, optimize=True))

    def encode(self, values: Floats) -> Array:
        """Coefficients (n, J) of values (n, T, R) at `time_h`, all rows given."""
        projected = np.einsum("ntb,ta->nab", values @ self.space.astype(float), self.time)
        forms = self.core[1:].reshape(self.coefficients, -1)
        return np.asarray((projected - self.core[0]).reshape(len(values), -1) @ forms.T)

    def decoder(self, time_h: Array, rows: NDArray[np.int64]) -> Callable[[Array], Array]:
        """The map from coefficients (n, J) to values (n, T', R'), only at the rows asked for."""
        forms, space = self.modes(time_h), self.space[rows].T.astype(float)
        shape, width = (len(time_h), len(rows)), forms.shape[2]
        if len(rows) <= width:  # few rows: one matrix is smaller than the detour by the modes
            table = (forms @ space).reshape(len(forms), -1)
            return lambda c: (table[0] + c @ table[1:]).reshape(-1, *shape)
        table = forms.reshape(len(forms), -1)
        return lambda c: ((table[0] + c @ table[1:]).reshape(-1, width) @ space).reshape(-1, *shape)

    def decode(self, c: Array, time_h: Array, rows: NDArray[np.int64]) -> Array:
        """Values (n, T', R') of coefficients c (n, J)."""
        return self.decoder(time_h, rows)(c)


def factorise(values: Floats, time_h: Array, ranks: Ranks, seed: int) -> tuple[Factors, Array]:
    """Factors and coefficients (n, J) of values (n, T, R)."""
    n, instants, rows = values.shape
    snapshots = np.ascontiguousarray(values.reshape(n * instants, rows))
    space = _enough(Basis.of(snapshots, ranks.space, seed), snapshots.size, ranks.tolerance)
    modes = space.modes.astype(np.float32)
    projected = (snapshots @ space.modes).astype(float).reshape(n, instants, -1)
    width = projected.shape[2]

    along = projected.transpose(0, 2, 1).reshape(n * width, instants)
    time = _enough(Basis.of(along, ranks.time, seed), values.size, ranks.tolerance / 2)
    both = np.einsum("ntb,ta->nab", projected, time.modes).reshape(n, -1)

    mean = both.mean(axis=0)
    rank = min(ranks.coefficients, n - 1)
    runs = _enough(Basis.of(both - mean, rank, seed), values.size, ranks.tolerance / 2)
    core = np.vstack([mean, runs.modes.T]).reshape(-1, time.modes.shape[1], width)
    along_time = np.asarray(time.modes, dtype=float)
    weights = both.reshape(n, time.modes.shape[1], width)
    square = np.einsum("nab,ncb->ac", weights, weights)
    early_h = early_of(time_h, along_time, square)
    return Factors(modes, along_time, time_h, core, early_h), np.asarray((both - mean) @ runs.modes)


def early_of(time_h: Array, modes: Array, square: Array) -> float:
    """t* of the module's text, for time modes (T, A) whose weights have the sum of products (A, A).

    >>> hours = np.array([0.0, 500.0, 1000.0, 2000.0, 4000.0])
    >>> early_of(hours, hours[:, None], np.ones((1, 1))) > 4000
    True
    >>> early_of(np.array([0.0, 1, 10, 100, 1000]), np.ones((5, 1)), np.ones((1, 1)))
    1.0
    """
    if len(time_h) < 4 or time_h[0] > 0:
        return 1.0
    later = time_h[1:]
    leaps = np.flatnonzero(later[1:] > DECADE * later[:-1])
    latest = float(later[leaps[-1] + 1 if len(leaps) else 0])
    if latest <= 1.0:
        return 1.0
    scales = latest * 10.0 ** np.arange(10.0, -10.0, -0.5)
    tried = [float(early) for early in scales if 1.0 < early < 10.0 * time_h[-1]]
    missed = [_missed(np.log1p(time_h / early), modes, square) for early in (*tried, 1.0)]
    return (*tried, 1.0)[int(np.argmin(missed))]


def _missed(clock: Array, modes: Array, square: Array) -> float:
    """How far instants are off that are left out in turn, `TURNS` times, and how far the cubics
    swing from monotone ones between them."""
    between = clock[:-1] + 0.5 * np.diff(clock)
    swing = CubicSpline(clock, modes, axis=0)(between) - PchipInterpolator(clock, modes)(between)
    place, total = np.arange(len(clock)), float(np.einsum("ka,ab,kb->", swing, square, swing))
    for turn in range(min(TURNS, len(clock) - 2)):
        out = ((place - 1) % TURNS == turn) & (place > 0) & (place < len(clock) - 1)
        found = CubicSpline(clock[~out], modes[~out], axis=0)(clock[out]) - modes[out]
        total += float(np.einsum("ka,ab,kb->", found, square, found))
    return total


def _enough(basis: Basis, size: int, tolerance: float) -> Basis:
    """The fewest modes that leave an rms residual below the tolerance (all, if none do)."""
    small = np.flatnonzero(basis.residual() / np.sqrt(size) <= tolerance)
    return basis.head(int(small[0]) + 1) if len(small) else basis
