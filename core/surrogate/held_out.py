"""How a surrogate does at runs left out: ten folds, bases refitted in each (`training`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from core.rng import stream
from core.surrogate.fitting import assemble, reduced, typical_variance
from core.surrogate.kernel import Hyper
from core.surrogate.targets import MEAN_CEEQ, Target, invert

Array = NDArray[np.float64]
Runs = NDArray[np.int64]
FOLDS = 10


def folds(n: int, count: int, seed: int) -> Iterator[tuple[Runs, Runs]]:
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
    for k, (kept, left) in enumerate(folds(len(z), FOLDS, seed)):
        fold_done(k)
        if not len(left):
            continue
        fold = {
            name: reduced(replace(target, values=target.values[kept]), seed)
            for name, target in targets.items()
        }
        process, parts = assemble(z[kept], fold, hyper)
        v_typical = typical_variance(process)
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
