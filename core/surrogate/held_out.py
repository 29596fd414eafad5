"""How a surrogate does at runs left out: ten folds, bases refitted in each (`training`).

Of each run that was left out and each part, w is the factor by which its intervals would have to
grow to cover 95 % of its rows and instants. Where the error went with v alone, w would not depend
on v. With the bases' loss in it, it does:

    log w_i ~ a + b log(v_i / v_typical),      p = 1 + 2 b          (`core.surrogate.part`)

b by Theil and Sen's median of slopes, taken where the 95 % interval of it lies below 0, and for
parts that stand alone: of those put together with others v has one power. Above 0, where errors of
something smooth shrink faster than v says, p stays 1: intervals are too wide where runs are close,
and no narrower than v where they are closer than any was left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import theilslopes

from core.rng import stream
from core.surrogate.fitting import assemble, reduced, typical_variance
from core.surrogate.kernel import Hyper
from core.surrogate.targets import DEFORMATION, ELASTIC, MEAN_CEEQ, Target, invert

Array = NDArray[np.float64]
Runs = NDArray[np.int64]
FOLDS = 10
SURE = 1.959964  # sds of a normal deviate that 95 % lie within
TOGETHER = (MEAN_CEEQ, ELASTIC, DEFORMATION)  # parts of what others are put together from


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
    power      p of the module's text
    lost       what the bases alone lose of it: ||g - decoded(encoded(g))|| / ||g - mean g||
    rms, p95   of the error of y at runs left out, over runs, instants and rows [unit of y]
    spread     rms over instants and rows of the standard deviation of y between runs [unit]
    worst      the run with the largest rms error, among those trained on, and that error [unit]
    """

    inflation: float
    power: float
    lost: float
    rms: float
    p95: float
    spread: float
    worst: int
    worst_rms: float

    def to_json(self) -> dict[str, float]:
        """Plain data; factors and power are told elsewhere."""
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
    seen: dict[str, list[tuple[Array, Array]]] = {name: [] for name in targets}
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
            seen[name].append((v / v_typical, np.abs(true - mean) / sd))
            again = part.factors.decode(part.factors.encode(true), target.time_h, rows)
            spread = true - target.values[kept].mean(axis=0)
            lost[name].append(np.array([np.sum((true - again) ** 2), np.sum(spread**2)]))
            off[name][left] = mean
    out = {}
    for name in targets:
        v, off_by = (np.concatenate(column) for column in zip(*seen[name], strict=True))
        power = power_of(v, off_by) if alone(name, targets[name].form) else 1.0
        off_by *= (v ** (0.5 * (1.0 - power)))[:, None, None]
        factor = float(np.quantile(off_by, 0.95)) / SURE
        residual, total = np.sum(lost[name], axis=0)
        share = float(np.sqrt(residual / max(total, np.finfo(float).tiny)))
        out[name] = _held((factor, power, share), name, targets, off)
    return out


def alone(name: str, form: str) -> bool:
    """Whether a part is a quantity, or its logarithm, and no other is put together with it.

    >>> alone("ceeq", "log rate"), alone("mean_ceeq", "log rate"), alone("elongation", "per ceeq")
    (True, False, False)
    """
    return form != "per ceeq" and name not in TOGETHER


def power_of(v: Array, off_by: Array) -> float:
    """p of the module's text.

    v       relative variances of the runs over the typical one, (n,)
    off_by  errors there in standard deviations, (n, T, R)

    >>> v, sds = np.geomspace(0.01, 10, 40), np.linspace(0, 3, 50)[None, :, None]
    >>> [round(power_of(v, sds * (v**b)[:, None, None]), 6) for b in (0.2, 0.0, -0.2)]
    [1.0, 1.0, 0.6]
    """
    wide = np.quantile(off_by.reshape(len(v), -1), 0.95, axis=1)
    used = (wide > 0) & (v > 0)
    if len(np.unique(v[used])) < 3:
        return 1.0
    b, _, _, high = theilslopes(np.log(wide[used]), np.log(v[used]), 0.95)
    return float(max(1.0 + 2.0 * b, 0.0)) if high < 0 else 1.0


def _held(
    told: tuple[float, float, float],
    name: str,
    targets: Mapping[str, Target],
    means: Mapping[str, Array],
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
        *told,
        float(np.sqrt(np.mean(error**2))),
        float(np.quantile(np.abs(error), 0.95)),
        float(np.sqrt(np.mean(np.var(true, axis=0)))),
        worst,
        float(by_run[worst]),
    )
