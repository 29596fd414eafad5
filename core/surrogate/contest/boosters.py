"""The three boosters, of the extra `contest`.

Each learns with the squared error on one thread and a fixed seed. LightGBM has one model for each
feature and may fit lines in its leaves; XGBoost has one model for each feature as well; CatBoost
has trees with a vector of all features in each leaf (``MultiRMSE``). LightGBM's defaults ask for 20
runs in a leaf and three in a bin of a histogram, which 66 runs do not have: three and one here.
"""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from core.surrogate.contest.regressors import OWN, Contestant, Effort, Fitted, Setting

Array = NDArray[np.float64]


def _scaled(y: Array) -> tuple[Array, Array, Array]:
    mean, spread = y.mean(axis=0), y.std(axis=0)
    spread = np.where(spread > 0, spread, 1.0)
    return (y - mean) / spread, mean, spread


def _lightgbm(z: Array, y: Array, setting: Setting, effort: Effort) -> Fitted:
    import lightgbm

    options = {
        "objective": "regression",
        "learning_rate": 0.1,
        "num_leaves": setting["leaves"],
        "linear_tree": setting["lines"],
        "min_data_in_leaf": 3,
        "min_data_in_bin": 1,
        "num_threads": 1,
        "deterministic": True,
        "force_row_wise": True,
        "seed": effort.seed % 2**31,
        "verbosity": -1,
    }
    scaled, mean, spread = _scaled(y)
    models = []
    for j in range(y.shape[1]):
        data = lightgbm.Dataset(z, label=scaled[:, j], params=options)
        models.append(lightgbm.train(options, data, effort.rounds))

    def predict(new: Array) -> Array:
        columns = [np.asarray(one.predict(new, num_threads=1)) for one in models]
        return np.asarray(mean + spread * np.column_stack(columns))

    return Fitted(predict, models)


def _xgboost(z: Array, y: Array, setting: Setting, effort: Effort) -> Fitted:
    import xgboost

    options = {
        "objective": "reg:squarederror",
        "tree_method": "hist",
        "eta": setting["rate"],
        "max_depth": setting["depth"],
        "nthread": 1,
        "seed": effort.seed % 2**31,
        "verbosity": 0,
    }
    scaled, mean, spread = _scaled(y)
    model = xgboost.train(options, xgboost.DMatrix(z, label=scaled, nthread=1), effort.rounds)

    def predict(new: Array) -> Array:
        got = np.asarray(model.predict(xgboost.DMatrix(new, nthread=1)), dtype=float)
        return np.asarray(mean + spread * got.reshape(len(new), -1))

    return Fitted(predict, model)


def _catboost(z: Array, y: Array, setting: Setting, effort: Effort) -> Fitted:
    import catboost

    unit = float(y.std())
    model = catboost.CatBoostRegressor(
        loss_function="MultiRMSE",
        iterations=effort.rounds,
        learning_rate=0.1,
        depth=setting["depth"],
        l2_leaf_reg=setting["l2"],
        random_seed=effort.seed % 2**31,
        thread_count=1,
        allow_writing_files=False,
        verbose=False,
    ).fit(z, y / unit)

    def predict(new: Array) -> Array:
        got = np.asarray(model.predict(new, thread_count=1), dtype=float)
        return np.asarray(unit * got.reshape(len(new), -1))

    return Fitted(predict, model)


BOOSTERS = (
    Contestant(
        "LightGBM",
        tuple({"leaves": n, "lines": lines} for lines in (False, True) for n in (4, 8, 16)),
        _lightgbm,
        package="lightgbm",
    ),
    Contestant(
        "XGBoost",
        tuple({"depth": depth, "rate": rate} for rate in (0.1, 0.3) for depth in (2, 3, 5)),
        _xgboost,
        package="xgboost",
    ),
    Contestant(
        "CatBoost",
        tuple({"depth": depth, "l2": l2} for l2 in (1.0, 3.0) for depth in (3, 4, 6)),
        _catboost,
        package="catboost",
    ),
)
SEVEN = (*OWN, *BOOSTERS)


def installed(one: Contestant) -> bool:
    """Whether it can take part here."""
    return one.package is None or find_spec(one.package) is not None
