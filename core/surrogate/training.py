"""From an archive to a surrogate.

1. Each part's target is put in Tucker form. Where a quantity allows several forms (mises: its
   logarithm or itself) five-fold cross-validation decides, by the error of the quantity itself.
2. All coefficients get one Gaussian process. Its hyperparameters maximise the restricted
   likelihood of the coefficients that make up 99 % of each part's variance; parts weigh the
   same. The degree of the trend (0, 1, 2) is the one of smallest leave-one-out error.
3. Errors: leave-one-out residuals give the covariance C; ten-fold cross-validation over the
   training runs, bases refitted each time, gives the factor f by which the 95 % intervals have
   to grow to cover 95 %. Test runs are never looked at here. The same folds tell how far each
   quantity is off at runs that were left out, in its own unit (`Held`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from core.archive import Archive, Quantity
from core.archive.take import MINIMUM_RUNS
from core.errors import ModelError
from core.response import multi_indices
from core.rng import stream
from core.surrogate.kernel import Hyper, SharedGP, fit_hyper
from core.surrogate.model import Surrogate
from core.surrogate.part import Part
from core.surrogate.targets import (
    DEFORMATION,
    ELASTIC,
    MEAN_CEEQ,
    Target,
    invert,
    targets_of,
)
from core.surrogate.tucker import Factors, Ranks, factorise

Array = NDArray[np.float64]
Runs = NDArray[np.int64]
Progress = Callable[[str, int, int], None]
FOLDS = 10
LEADING = 0.99
TRENDS = (0, 1, 2)
SAMPLED_ROWS = 240
RANKS = {
    "scalar": Ranks(1, 12, 30, 2e-5),
    "field": Ranks(32, 14, 48, 6e-4),
    ELASTIC: Ranks(12, 1, 24, 1e-5),
}


@dataclass(frozen=True, slots=True)
class _Fitted:
    """A part before its errors are known: target on sampled rows, factors, coefficients."""

    target: Target
    factors: Factors
    c: Array
    cut_time: Array
    cut_space: Array


def train(
    archive: Archive,
    indices: Sequence[int] | None = None,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> Surrogate:
    """Train on the runs `indices` of an archive (default: all of them)."""
    chosen = tuple(archive.done() if indices is None else indices)
    declared, d = archive.declaration, len(archive.declaration.inputs)
    if len(chosen) < MINIMUM_RUNS * (d + 1):
        raise ModelError(
            f"{len(chosen)} runs are too few for {d} inputs: make {MINIMUM_RUNS * (d + 1)} or more"
        )
    say = progress or (lambda what, done, total: None)
    low = np.array([item.low for item in declared.inputs])
    high = np.array([item.high for item in declared.inputs])
    z = 2.0 * (archive.inputs(chosen) - low) / (high - low) - 1.0

    fitted: dict[str, _Fitted] = {}
    steps = len(declared.quantities) + 1 + FOLDS
    for candidates in targets_of(archive, chosen):
        say(f"reducing {candidates[0].name}", min(len(fitted), len(declared.quantities)), steps)
        best = candidates[0]
        if len(candidates) > 1:
            best = min(candidates, key=lambda t: _form_error(z, t, seed))
        fitted[best.name] = _reduce(best, seed)
    say("fitting the process", len(declared.quantities), steps)
    hyper = _hyper(z, fitted)
    process, parts = _assemble(z, fitted, hyper)
    quantities = {q.name: q for q in declared.quantities}
    if DEFORMATION in fitted:
        unit = quantities["displacement"].unit
        quantities[DEFORMATION] = Quantity(DEFORMATION, unit, "vector field")
    mesh = archive.mesh()
    made = Surrogate(
        inputs=declared.inputs,
        time_h=np.array(declared.time_h),
        quantities=quantities,
        points=np.asarray(mesh.points, dtype=float),
        named=dict(mesh.named),
        process=process,
        parts=parts,
        v_typical=_typical_variance(process),
    )
    targets = {name: one.target for name, one in fitted.items()}
    found = calibrate(
        z, targets, hyper, seed, lambda k: say("calibrating the errors", steps - FOLDS + k, steps)
    )
    parts = {name: replace(part, inflation=found[name].inflation) for name, part in parts.items()}
    bases = {
        name: {
            "form": part.form,
            "space": part.factors.space.shape[1],
            "time": part.factors.time.shape[1],
            "coefficients": part.factors.coefficients,
            "held_out_percent": round(100 * found[name].lost, 4),
            "inflation": round(part.inflation, 4),
        }
        for name, part in parts.items()
    }
    notes: dict[str, Any] = {"runs": len(chosen), "seed": seed, "hyper": asdict(hyper)}
    notes |= {"bases": bases, "held_out": {name: one.to_json() for name, one in found.items()}}
    return replace(made, parts=parts, manifest={"training": notes})


def _assemble(
    z: Array, fitted: Mapping[str, _Fitted], hyper: Hyper
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


def _reduce(target: Target, seed: int) -> _Fitted:
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
    return _Fitted(
        small,
        factors,
        c,
        np.sqrt(np.mean(square, axis=1)),
        np.sqrt(np.mean(square, axis=0) / total),
    )


def _columns(fitted: Mapping[str, _Fitted]) -> tuple[dict[str, slice], Array]:
    columns, start = {}, 0
    for name, one in fitted.items():
        columns[name] = slice(start, start + one.c.shape[1])
        start += one.c.shape[1]
    return columns, np.hstack([one.c for one in fitted.values()])


def _hyper(z: Array, fitted: Mapping[str, _Fitted], trends: Sequence[int] = TRENDS) -> Hyper:
    """Hyperparameters of each trend; the trend of the smallest leave-one-out error.

    That error is the geometric mean over the parts of sum_j e_j^2: a part that is hard to learn
    has no louder voice than one that is easy.
    """
    columns, joined = _columns(fitted)
    share = np.concatenate([_leading(np.var(one.c, axis=0)) for one in fitted.values()])
    share /= len(fitted)
    best, smallest = None, np.inf
    for trend in trends:
        if len(z) < 2 * len(multi_indices(z.shape[1], trend)):
            break
        hyper = fit_hyper(z, joined, share, trend)
        e, _ = SharedGP.condition(z, joined, hyper).left_out()
        error = float(np.mean([np.log(np.sum(e[:, own] ** 2)) for own in columns.values()]))
        if error < smallest:
            best, smallest = hyper, error
    assert best is not None
    return best


def _leading(variance: Array) -> Array:
    """Equal weights on the coefficients that make up `LEADING` of a part's variance.

    >>> _leading(np.array([0.9, 0.095, 0.005])).tolist()
    [0.5, 0.5, 0.0]
    """
    before = np.cumsum(variance) - variance
    chosen = before < LEADING * variance.sum()
    return np.asarray(chosen / chosen.sum())


def _typical_variance(process: SharedGP) -> float:
    """Median of v over the box."""
    d = process.z.shape[1]
    points = 2.0 * qmc.Sobol(d, scramble=False).random_base2(9) - 1.0
    return float(np.median(process.mean_and_variance(points)[1]))


def _folds(n: int, count: int, seed: int) -> Iterator[tuple[Runs, Runs]]:
    """Training and left-out runs of each fold."""
    order = stream(seed, "folds", n, count).permutation(n)
    for k in range(count):
        left = np.sort(order[k::count])
        yield np.setdiff1d(order, left), left


@dataclass(frozen=True, slots=True)
class Held:
    """What ten-fold cross-validation, bases refitted in each fold, tells of a part.

    inflation  factor by which the 95 % intervals must grow to cover 95 % of what was left out
    lost       what the bases alone lose of it: ||g - decoded(encoded(g))|| / ||g - mean g||
    rms, p95   of the error of y at runs left out, over runs, instants and rows [unit of y]
    spread     rms over instants and rows of the standard deviation of y between runs [unit]
    worst      the run with the largest rms error, among those trained on, and that error [unit]
    """

    inflation: float
    lost: float
    rms: float
    p95: float
    spread: float
    worst: int
    worst_rms: float

    def to_json(self) -> dict[str, float]:
        """Plain data; the two factors are told elsewhere."""
        told = asdict(self)
        return {name: told[name] for name in ("rms", "p95", "spread", "worst", "worst_rms")}


def calibrate(
    z: Array,
    targets: Mapping[str, Target],
    hyper: Hyper,
    seed: int,
    fold_done: Callable[[int], None] = lambda k: None,
) -> dict[str, Held]:
    """How each part does at runs that were left out, by ten-fold cross-validation."""
    seen: dict[str, list[Array]] = {name: [] for name in targets}
    lost: dict[str, list[Array]] = {name: [] for name in targets}
    off = {name: np.zeros(target.values.shape) for name, target in targets.items()}
    for k, (kept, left) in enumerate(_folds(len(z), FOLDS, seed)):
        fold_done(k)
        if not len(left):
            continue
        fold = {
            name: _reduce(replace(target, values=target.values[kept]), seed)
            for name, target in targets.items()
        }
        process, parts = _assemble(z[kept], fold, hyper)
        v_typical = _typical_variance(process)
        (c,), v = process.mean_and_variance(z[left])
        for name, part in parts.items():
            target = targets[name]
            rows = np.arange(target.values.shape[2])
            mean = part.factors.decode(c[:, part.columns], target.time_h, rows)
            scale = part.scale(target.time_h, rows, v_typical)
            sd = np.maximum(scale * np.sqrt(v)[:, None, None], np.finfo(float).tiny)
            true = target.values[left]
            seen[name].append(np.abs(true - mean) / sd)
            again = part.factors.decode(part.factors.encode(true), target.time_h, rows)
            spread = true - target.values[kept].mean(axis=0)
            lost[name].append(np.array([np.sum((true - again) ** 2), np.sum(spread**2)]))
            off[name][left] = mean
    out = {}
    for name in targets:
        factor = np.quantile(np.concatenate([s.ravel() for s in seen[name]]), 0.95) / 1.959964
        residual, total = np.sum(lost[name], axis=0)
        share = float(np.sqrt(residual / max(total, np.finfo(float).tiny)))
        out[name] = _held(float(factor), share, name, targets, off)
    return out


def _held(
    factor: float, lost: float, name: str, targets: Mapping[str, Target], means: Mapping[str, Array]
) -> Held:
    """Errors of y itself: a part that is learnt as a share of mean CEEQ is multiplied by it."""

    def of(values: Mapping[str, Array]) -> Array:
        target, ceeq = targets[name], None
        if target.form == "per ceeq":
            scale = targets[MEAN_CEEQ]
            ceeq = invert(scale.form, values[MEAN_CEEQ], scale.time_h)[:, :, 0]
        return invert(target.form, values[name], target.time_h, ceeq)

    true = of({key: target.values for key, target in targets.items()})
    error = of(means) - true
    by_run = np.sqrt(np.mean(error**2, axis=(1, 2)))
    worst = int(by_run.argmax())
    return Held(
        factor,
        lost,
        float(np.sqrt(np.mean(error**2))),
        float(np.quantile(np.abs(error), 0.95)),
        float(np.sqrt(np.mean(np.var(true, axis=0)))),
        worst,
        float(by_run[worst]),
    )


def _form_error(z: Array, target: Target, seed: int) -> float:
    """Root-mean-square error of y over five folds, the hyperparameters those of all runs."""
    rows = target.values.shape[2]
    sampled = stream(seed, "form", target.name).permutation(rows)[: min(rows, SAMPLED_ROWS)]
    small = replace(target, values=target.values[:, :, sampled])
    hyper = _hyper(z, {target.name: _reduce(small, seed)}, trends=(1,))
    error = []
    for kept, left in _folds(len(z), 5, seed):
        fold = _reduce(replace(small, values=small.values[kept]), seed)
        (c,), _ = SharedGP.condition(z[kept], fold.c, hyper).mean_and_variance(z[left])
        mean = fold.factors.decode(c, target.time_h, np.arange(len(sampled)))
        y = invert(target.form, small.values[left], target.time_h)
        error.append(np.mean((invert(target.form, mean, target.time_h) - y) ** 2))
    return float(np.sqrt(np.mean(error)))
