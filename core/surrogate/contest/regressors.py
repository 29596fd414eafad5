"""The seven contestants, each with six configurations.

Inputs z (n, d) in [-1, 1], outputs y (n, F): features. A configuration is what changes from one try
to the next; everything else is fixed and stands here. The first entries are those that a short
contest tries. The number of trees is no configuration: more never hurt where they are independent,
and boosters learn slowly enough for theirs.

    polynomial chaos    degree and norm of the terms; searched or least squares (`chaos`)
    gaussian process    degree of the trend, and which features its likelihood looks at; length
                        scales and nugget by maximum likelihood (`core.surrogate.likelihood`)
    extra trees         inputs tried at a split, runs in a leaf at least
    random forest       the same
    LightGBM, XGBoost, CatBoost     see `boosters`

Controls stand beside and win nothing: the mean of the runs, and a Gaussian process as the
library scikit-learn has it without a word said (squared exponential with one length for all
inputs, no trend, no nugget, outputs as they are), once on scaled inputs and once on inputs in
their own units. It warns that it has not converged; that is what the control is there to show.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import ExtraTreesRegressor, RandomForestRegressor
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor

from core.monomials import multi_indices
from core.surrogate.contest.chaos import Chaos
from core.surrogate.kernel import SharedGP
from core.surrogate.likelihood import fit_hyper

Array = NDArray[np.float64]
Setting = Mapping[str, Any]
Predictor = Callable[[Array], Array]


@dataclass(frozen=True, slots=True)
class Effort:
    """What a contestant may spend: trees of a forest, rounds of a booster, its random seed."""

    trees: int
    rounds: int
    seed: int


@dataclass(frozen=True, slots=True)
class Fitted:
    """predict: (n, d) → (n, F);  keeps: what has to be stored for it."""

    predict: Predictor
    keeps: Any


Fit = Callable[[Array, Array, Setting, Effort], Fitted]
Carries = Callable[[int, int, Setting], bool]


@dataclass(frozen=True, slots=True)
class Contestant:
    """A regressor and its search space.

    carries    whether n runs of d inputs are enough for a configuration
    package    that must be installed, if any (extra `contest`)
    """

    name: str
    settings: tuple[Setting, ...]
    fit: Fit
    carries: Carries = lambda n, d, setting: True
    package: str | None = None


def _chaos(z: Array, y: Array, setting: Setting, effort: Effort) -> Fitted:
    made = Chaos.fit(z, y, setting["degree"], setting["q"], sparse=setting["sparse"])
    used = np.any(made.weights != 0, axis=1)
    small = Chaos(made.table[used], made.weights[used], made.error)
    return Fitted(small, (small.table, small.weights))


def _process(z: Array, y: Array, setting: Setting, effort: Effort) -> Fitted:
    variance = np.var(y, axis=0)
    before = np.cumsum(variance) - variance
    chosen = before < setting["leading"] * variance.sum()
    hyper = fit_hyper(z, y, np.asarray(chosen / chosen.sum(), dtype=float), setting["trend"])
    made = SharedGP.condition(z, y, hyper)
    return Fitted(lambda new: made.mean(new)[0], (made.z, made.weights, made.beta))


def _trend_carried(n: int, d: int, setting: Setting) -> bool:
    return n >= 2 * len(multi_indices(d, setting["trend"]))


def _forest(kind: type[ExtraTreesRegressor] | type[RandomForestRegressor]) -> Fit:
    def fit(z: Array, y: Array, setting: Setting, effort: Effort) -> Fitted:
        made = kind(
            effort.trees,
            max_features=setting["inputs"],
            min_samples_leaf=setting["leaf"],
            random_state=effort.seed % 2**32,
            n_jobs=1,
        ).fit(z, y)
        return Fitted(lambda new: np.asarray(made.predict(new)).reshape(len(new), -1), made)

    return fit


def _mean(z: Array, y: Array, setting: Setting, effort: Effort) -> Fitted:
    mean = y.mean(axis=0)
    return Fitted(lambda new: np.tile(mean, (len(new), 1)), mean)


def _as_it_comes(z: Array, y: Array, setting: Setting, effort: Effort) -> Fitted:
    half = np.array(setting["half"])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        made = GaussianProcessRegressor().fit(half * z, y)
    return Fitted(lambda new: np.asarray(made.predict(half * new)).reshape(len(new), -1), made)


FORESTS: tuple[Setting, ...] = tuple(
    {"inputs": inputs, "leaf": leaf} for leaf in (1, 2) for inputs in (1.0, 0.5, 1)
)
CHAOS: tuple[Setting, ...] = (
    {"degree": 3, "q": 1.0, "sparse": True},
    {"degree": 2, "q": 1.0, "sparse": False},
    {"degree": 4, "q": 1.0, "sparse": True},
    {"degree": 5, "q": 1.0, "sparse": True},
    {"degree": 5, "q": 0.75, "sparse": True},
    {"degree": 8, "q": 0.6, "sparse": True},
)
PROCESS: tuple[Setting, ...] = tuple(
    {"trend": trend, "leading": leading} for leading in (0.99, 0.9999) for trend in (2, 1, 0)
)
OWN = (
    Contestant("polynomial chaos", CHAOS, _chaos),
    Contestant("gaussian process", PROCESS, _process, _trend_carried),
    Contestant("extra trees", FORESTS, _forest(ExtraTreesRegressor)),
    Contestant("random forest", FORESTS, _forest(RandomForestRegressor)),
)
MEAN, PLAIN, UNSCALED = (
    "mean of the runs",
    "scikit-learn's process, scaled inputs",
    "scikit-learn's process, inputs in own units",
)


def controls(half: Array) -> tuple[Contestant, ...]:
    """What stands beside; half the interval of each input in its own unit, (d,)."""
    return (
        Contestant(MEAN, ({},), _mean),
        Contestant(PLAIN, ({"half": [1.0] * len(half)},), _as_it_comes),
        Contestant(UNSCALED, ({"half": half.tolist()},), _as_it_comes),
    )
