"""Where inputs that run in time would leave a surrogate's runs.

The runs span a box. What an input may become is refused where it leaves the box (`check_reach`),
unless a drift that moves it is `held` (`core.drift.Drift`): then the input runs to the end of the
runs and stays there,

    x_j(t) = min(max(x_j + Σ a s(t), low_j), high_j)

An effect that a diagnosis adopts is held: its amplitude is calibrated where the readings are, well
inside, and only thin coatings of many hours would ever leave. After that they have too
little of the effect, and nothing is made up.

A held input has a kink, which polynomials follow less well than what is smooth; by how much they
miss at the points that they are fitted at counts as an error of the answer (`missed`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from core.archive import Input
from core.drift import Drift
from core.errors import InputError
from core.monomials import monomials

Array = NDArray[np.float64]


def check_reach(
    own: Input,
    start: Sequence[float],
    drifts: Sequence[Drift],
    ranges: Mapping[str, tuple[float, float]],
    horizon_h: float,
) -> None:
    """Refuse what an input may become outside of the runs, from where it starts.

    ranges  of the drifts' amplitudes, by name

    Raises InputError unless one of the drifts that move it is held.
    """
    moving = [d for d in drifts if d.input == own.name]
    reached = list(start)
    if not any(d.held for d in moving):
        for d in moving:
            s = d.shape.over(0.0, horizon_h)
            ends = product(reached, ranges[d.name], (0.0, s.min(), s.max()))
            reached = [float(d.moved(x, a, at)) for x, a, at in ends]
    slack = 1e-9 * (own.high - own.low)
    if min(reached) < own.low - slack or max(reached) > own.high + slack:
        raise InputError(
            f"course of {own.name}",
            (min(reached), max(reached)),
            f"leaves the runs, {own.low:g} … {own.high:g}",
            "narrow the amplitude or the range, or train on a wider box",
        )


def run(
    now: Array,
    own: Input,
    drifts: Sequence[Drift],
    amplitudes: Mapping[str, Array],
    start: float,
    end: float,
) -> Array:
    """The mean (n,) of an input over a piece of time in which no shape has a point; now: at 0."""
    moving = [d for d in drifts if d.input == own.name]
    for d in moving:
        now = d.moved(now, amplitudes[d.name], d.shape.mean(start, end))
    return np.clip(now, own.low, own.high) if any(d.held for d in moving) else now


def missed(z: Array, degree: int, fitted: Array, y: Array, scale: Array) -> Array:
    """Relative mean square error (R,) of A exp(B) at the points z (S, d) of the fit.

    fitted  coefficients of A and B, (M, 2 R); values y (S, R) and their scale exp(B), (S, R)
    """
    a, b = np.split(monomials(z, degree) @ fitted, 2, axis=1)
    return np.asarray(np.mean((a * np.exp(b) / scale - y / scale) ** 2, axis=0))
