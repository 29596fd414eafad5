"""Parts of a surrogate fitted: bases, one process for all coefficients (`training`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from core.monomials import multi_indices
from core.rng import stream
from core.surrogate.kernel import Hyper, SharedGP, carries
from core.surrogate.likelihood import fit_hyper
from core.surrogate.part import Part
from core.surrogate.targets import ELASTIC, Target
from core.surrogate.tucker import Factors, Ranks, factorise

Array = NDArray[np.float64]
LEADING = 0.99
LEAST_MOVED = 1e-12  # of the mean square
TRENDS = (0, 1, 2)
SAMPLED_ROWS = 240
RANKS = {
    "scalar": Ranks(1, 12, 30, 2e-5),
    "field": Ranks(32, 14, 48, 6e-4),
    ELASTIC: Ranks(12, 1, 24, 1e-5),
}


@dataclass(frozen=True, slots=True)
class Fitted:
    """A part before its errors are known: target on sampled rows, factors, coefficients."""

    target: Target
    factors: Factors
    c: Array
    cut_time: Array
    cut_space: Array


def assemble(
    z: Array, fitted: Mapping[str, Fitted], hyper: Hyper
) -> tuple[SharedGP, dict[str, Part]]:
    """The process of all coefficients, and the parts with the covariance of their errors."""
    columns, joined = _columns(fitted)
    process = SharedGP.condition(z, joined, hyper)
    e, v = process.left_out()
    left_out = (e / np.sqrt(len(v) * v)[:, None]).T
    parts = {
        name: Part(
            one.target.form,
            one.factors,
            columns[name],
            left_out[columns[name]],
            one.cut_time,
            one.cut_space.astype(np.float32),
            1.0,
        )
        for name, one in fitted.items()
    }
    return process, parts


def reduced(target: Target, seed: int) -> Fitted:
    """A target in Tucker form, on the rows that its errors are sampled at."""
    rows = target.values.shape[2]
    kind = target.name if target.name in RANKS else ("scalar" if rows == 1 else "field")
    ranks = RANKS[kind]
    if target.form == "raw" or (kind != "scalar" and target.form == "per ceeq"):
        ranks = replace(ranks, tolerance=ranks.tolerance * float(np.std(target.values)))
    factors, c = factorise(target.values, target.time_h, ranks, seed)
    square = np.zeros(target.values.shape[1:])
    decode = factors.decoder(target.time_h, np.arange(rows))
    for i in range(len(c)):
        square += (target.values[i] - decode(c[i : i + 1])[0]) ** 2 / len(c)
    total = max(float(np.mean(square)), np.finfo(float).tiny)
    sampled = np.sort(
        stream(seed, "sampled-rows", target.name).permutation(rows)[: min(rows, SAMPLED_ROWS)]
    )
    small = replace(target, values=target.values[:, :, sampled])
    return Fitted(
        small,
        factors,
        c,
        np.sqrt(np.mean(square, axis=1)),
        np.sqrt(np.mean(square, axis=0) / total),
    )


def _columns(fitted: Mapping[str, Fitted]) -> tuple[dict[str, slice], Array]:
    columns, start = {}, 0
    for name, one in fitted.items():
        columns[name] = slice(start, start + one.c.shape[1])
        start += one.c.shape[1]
    return columns, np.hstack([one.c for one in fitted.values()])


def hyper_of(z: Array, fitted: Mapping[str, Fitted], trends: Sequence[int] = TRENDS) -> Hyper:
    """Hyperparameters of each trend; the trend of the smallest leave-one-out error.

    That error is the geometric mean over the parts of sum_j e_j^2: a part that is hard to learn
    has no louder voice than one that is easy. A part that is the same in every run has none.
    """
    columns, joined = _columns(fitted)
    moving = {name for name, one in fitted.items() if moves(one)} or set(fitted)
    share = np.concatenate(
        [
            _leading(np.var(one.c, axis=0)) if name in moving else np.zeros(one.c.shape[1])
            for name, one in fitted.items()
        ]
    )
    share /= len(moving)
    best, smallest = None, np.inf
    for trend in _carried(z, trends):
        hyper = fit_hyper(z, joined, share, trend)
        e, _ = SharedGP.condition(z, joined, hyper).left_out()
        left = [np.sum(e[:, own] ** 2) for name, own in columns.items() if name in moving]
        error = float(np.mean(np.log(left)))
        if error < smallest:
            best, smallest = hyper, error
    assert best is not None
    return best


def _carried(z: Array, trends: Sequence[int]) -> list[int]:
    """The trends that inputs z (n, d) carry, by two runs for each term; the constant one where they
    carry none of them (two inputs that move together, say).

    >>> line = np.linspace(-1, 1, 9)[:, None]
    >>> _carried(line, TRENDS), _carried(np.hstack([line, line]), (1,))
    ([0, 1, 2], [0])
    """
    enough = [t for t in trends if len(z) >= 2 * len(multi_indices(z.shape[1], t))]
    return [t for t in enough if carries(z, t)] or [0]


def moves(one: Fitted) -> bool:
    """Whether a part differs between runs by more than the rounding of single precision."""
    values = one.target.values
    largest = max(float(np.mean(values**2, axis=0).sum()), np.finfo(float).tiny)
    return bool(np.var(values, axis=0).sum() > LEAST_MOVED * largest)


def _leading(variance: Array) -> Array:
    """Equal weights on the coefficients that make up `LEADING` of a part's variance.

    >>> _leading(np.array([0.9, 0.095, 0.005])).tolist()
    [0.5, 0.5, 0.0]
    """
    before = np.cumsum(variance) - variance
    chosen = before < LEADING * variance.sum()
    return np.asarray(chosen / chosen.sum())


def typical_variance(process: SharedGP) -> float:
    """Median of v over the box."""
    d = process.z.shape[1]
    points = 2.0 * qmc.Sobol(d, scramble=False).random_base2(9) - 1.0
    return float(np.median(process.mean_and_variance(points)[1]))
