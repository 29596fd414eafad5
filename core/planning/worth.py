"""By how much an inspection would narrow a quantity of interest.

The quantity θ is a blade's own elongation (or strain) at an hour, say when it is to be replaced, or
a parameter. To second order, as if θ and the readings y were jointly normal with the particles'
moments (`core.planning.ahead`),

    Var[θ | y] = Var θ − c_θy C_yy⁻¹ c_yθ

whatever y will turn out to be: the value of information of a linear-Gaussian model (Lindley 1956;
Raiffa & Schlaifer 1961). Readings of other blades count through the shared parameters alone. A set
grows by the reading that narrows θ most, given those before it.

On linear models it is exact; where the posterior is skew or leans on a bound, the truth depends on
what is read, and this is its typical size. The noise of covariances from n particles makes a
worthless reading look as if it took 1/n of the variance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.calibration.state import RotorState, shared_posterior
from core.errors import InputError
from core.model import Model
from core.planning.ahead import Drawn, Expected, expected
from core.planning.candidates import Candidate
from core.smc.particles import normalised

Array = NDArray[np.float64]
Json = dict[str, Any]
TINY = 1e-300  # stands for the variance of what is known, as nothing's at the start


@dataclass(frozen=True, slots=True)
class Target:
    """What is to be known better: a blade's `quantity` at `time_h`, or a `parameter`.

    A local parameter needs its blade; a shared one has none.
    """

    blade: str | None = None
    quantity: str | None = None
    time_h: float | None = None
    parameter: str | None = None


@dataclass(frozen=True)
class Worth:
    """What readings would leave of the target's sd.

    mean, sd  of the target now
    single    every candidate with the sd that it alone would leave, smallest first
    grown     the set, reading by reading: the sd left by the first, the first two, …
    """

    mean: float
    sd: float
    single: tuple[tuple[Candidate, float], ...]
    grown: tuple[tuple[Candidate, float], ...]


def worth(
    model: Model,
    state: RotorState,
    target: Target,
    asked: Sequence[Candidate],
    known: Mapping[str, Mapping[str, float]] | None = None,
    count: int = 3,
    most: int | None = None,
) -> Worth:
    """Candidates by what they would leave of the target's sd, and the best set of `count`.

    most   particles of a blade that are used; None: all

    Raises InputError for a target that the state knows nothing of, and without candidates.
    """
    aim = _aim(model, state, target, known, most)
    stays = float(aim.noise[0])  # surrogate and discrepancy: no reading takes it away
    told = expected(model, state, asked, known, most=most)
    variance = float(_own(aim))
    unit = max(variance, TINY)
    c = told.cross(aim)[:, 0]
    each = np.array([_own(told, i) for i in range(len(asked))]) + told.noise
    left = np.maximum(variance - c**2 / each, 0.0)
    order = sorted(range(len(asked)), key=lambda i: (round(float(left[i] / unit), 9), i))
    single = tuple((asked[i], math.sqrt(left[i] + stays)) for i in order)
    grown = tuple(
        (one, math.sqrt(rest + stays))
        for one, rest in _grown(told, c, each, variance, asked, count)
    )
    return Worth(float(aim.mean[0]), math.sqrt(variance + stays), single, grown)


def _own(one: Expected, i: int = 0) -> float:
    """Variance without noise; of what has no blade, over the nodes."""
    blade, column = one.place[i]
    if blade not in one.blades:
        return float(one.node_w @ one.nodes[:, i] ** 2)
    w, f = one.blades[blade]
    return float(w @ f[:, column] ** 2)


def _grown(
    told: Expected, c: Array, each: Array, variance: float, asked: Sequence[Candidate], count: int
) -> tuple[tuple[Candidate, float], ...]:
    """Variances left; greedy, by conditioning everything on what was taken: Cholesky's columns."""
    taken: list[int] = []
    grown: list[tuple[Candidate, float]] = []
    columns = np.zeros((len(asked), 0))
    aim, left, own = c.copy(), variance, each.copy()
    covariance = told.cross(told)
    while len(taken) < min(count, len(asked)):
        gain = np.where(own > 1e-12 * each, aim**2 / np.maximum(own, 1e-300), 0.0)
        gain[taken] = 0.0
        i = int(np.argmax(np.round(gain / max(variance, TINY), 9)))
        if gain[i] <= 1e-6 * variance:
            break
        row = covariance[:, i] + np.where(np.arange(len(asked)) == i, told.noise, 0.0)
        column = (row - columns @ columns[i]) / np.sqrt(own[i])
        left -= float(gain[i])
        aim = aim - column * aim[i] / np.sqrt(own[i])
        own = own - column**2
        columns = np.c_[columns, column]
        taken.append(i)
        grown.append((asked[i], max(left, 0.0)))
    return tuple(grown)


def _aim(
    model: Model,
    state: RotorState,
    target: Target,
    known: Mapping[str, Mapping[str, float]] | None,
    most: int | None,
) -> Expected:
    """The target as one column."""
    if target.parameter is not None:
        return _parameter(state, target, most)
    if target.blade is None or target.quantity is None or target.time_h is None:
        raise InputError(
            "target", None, "is not complete", "give blade, quantity and time_h, or a parameter"
        )
    one = Candidate(target.blade, target.quantity, target.time_h, 0.0)
    return expected(model, state, [one], known, noise=False, most=most)


def _parameter(state: RotorState, target: Target, most: int | None) -> Expected:
    name, zero = target.parameter or "", np.zeros(1)
    if name in state.meta["local"] and target.blade is not None:
        drawn = Drawn.of(state, target.blade, most)
        mean, off, given = drawn.centred(drawn.posterior.column(name)[:, None])
        blades = {target.blade: (drawn.w, off)}
        return Expected(mean, zero, blades, given, drawn.node_w, ((target.blade, 0),))
    if name not in state.meta["shared"]:
        remedy = f"use one of {[*state.meta['shared']]}, or with a blade {[*state.meta['local']]}"
        raise InputError("parameter", name, "is not known here", remedy)
    x = shared_posterior(state.meta, state.arrays.__getitem__).column(name)
    w = normalised(state.arrays["shared/log_w"])
    return Expected(np.array([w @ x]), zero, {}, (x - w @ x)[:, None], w, (("", 0),))
