"""Which regressor: a contest by cross-validation.

The published method takes extremely randomised trees. With 66 runs, four inputs and a smooth
response the choice decides more than anything else, so it is measured: every contestant learns
the logarithm of a positive curve (the tip elongation from 1000 h on) from the same folds of the
same training runs, and the relative errors at the runs left out are reported, best first. The
process that `train` uses is one of them, with hyperparameters fitted inside each fold.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from core.archive import Archive
from core.errors import ModelError
from core.monomials import monomials, multi_indices
from core.rng import seed_of, stream
from core.surrogate.kernel import SharedGP
from core.surrogate.likelihood import fit_hyper

if TYPE_CHECKING:
    from sklearn.ensemble import ExtraTreesRegressor, RandomForestRegressor

Array = NDArray[np.float64]
Contestant = Callable[[Array, Array, Array], Array]
FROM_H = 1000.0
FOLDS = 10
TREES = 100


def _process(z: Array, y: Array, new: Array) -> Array:
    share = np.full(y.shape[1], 1.0 / y.shape[1])
    trend = 2 if len(z) >= 2 * len(multi_indices(z.shape[1], 2)) else 0
    process = SharedGP.condition(z, y, fit_hyper(z, y, share, trend))
    (mean,), _ = process.mean_and_variance(new)
    return mean


def _polynomial(degree: int) -> Contestant:
    def fit(z: Array, y: Array, new: Array) -> Array:
        found = np.linalg.lstsq(monomials(z, degree), y, rcond=None)[0]
        return np.asarray(monomials(new, degree) @ found)

    return fit


def contestants(n: int, d: int, seed: int) -> dict[str, Contestant]:
    """Those that n runs of d inputs can carry."""
    # here, because whoever loads a model that was built loads this module, and no tree
    from sklearn.ensemble import ExtraTreesRegressor, RandomForestRegressor

    def trees(kind: type[ExtraTreesRegressor] | type[RandomForestRegressor]) -> Contestant:
        state = seed_of(seed, kind.__name__) % 2**32
        return lambda z, y, new: np.asarray(
            kind(TREES, random_state=state).fit(z, y).predict(new)
        ).reshape(len(new), -1)

    found: dict[str, Contestant] = {"gaussian process": _process}
    for name, degree in (("quadratic", 2), ("cubic", 3)):
        if len(multi_indices(d, degree)) <= n:
            found[name] = _polynomial(degree)
    found["extra trees"] = trees(ExtraTreesRegressor)
    found["random forest"] = trees(RandomForestRegressor)
    return found


def contest(
    archive: Archive, indices: Sequence[int], *, quantity: str = "elongation", seed: int = 0
) -> list[dict[str, str | float]]:
    """Rows of name, median_percent, p95_percent; the best 95th percentile first."""
    time = np.array(archive.declaration.time_h)
    y = archive.stack(quantity, indices)[:, time >= FROM_H].astype(float)
    if y.ndim != 2 or y.size == 0 or np.any(y <= 0):
        raise ModelError(f"the contest needs a curve that is positive from {FROM_H:g} h on")
    low = np.array([item.low for item in archive.declaration.inputs])
    high = np.array([item.high for item in archive.declaration.inputs])
    z = 2.0 * (archive.inputs(indices) - low) / (high - low) - 1.0
    order = stream(seed, "contest").permutation(len(z))
    smallest = len(z) - -(-len(z) // FOLDS)
    rows: list[dict[str, str | float]] = []
    for name, fit in contestants(smallest, z.shape[1], seed).items():
        error = np.empty_like(y)
        for k in range(FOLDS):
            left = order[k::FOLDS]
            kept = np.setdiff1d(order, left)
            error[left] = np.abs(np.expm1(fit(z[kept], np.log(y[kept]), z[left]) - np.log(y[left])))
        median, p95 = (round(100 * float(q), 3) for q in np.quantile(error, [0.5, 0.95]))
        rows.append({"name": name, "median_percent": median, "p95_percent": p95})
    return sorted(rows, key=lambda row: float(row["p95_percent"]))
