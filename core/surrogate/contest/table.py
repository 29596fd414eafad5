"""All trials together: one row for each contestant and set of targets, and who is first."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from typing import Any

from core.surrogate.contest.regressors import MEAN, PLAIN, UNSCALED
from core.surrogate.contest.score import RULE as RULE
from core.surrogate.contest.score import Errors, rank_of
from core.surrogate.contest.trial import ALONE, TEST, Trial

Row = dict[str, Any]
Trials = Mapping[str, Mapping[str, Mapping[str, Trial]]]
CONTROL_NAMES = (MEAN, PLAIN, UNSCALED, ALONE)
PAPER: Row = {
    "first": "extra trees",
    "cv_rmse": 0.10513,
    "r2_test": 0.97,
    "second_best_worse_by_percent": 15.0,
    "features": 20,
    "runs": 66,
}
"""Sec. 4.2 of the published method. It tells that the best error is 15 % smaller than the second
best; it does not tell the others, nor how features are scaled, nor how any regressor was tuned."""


def rows(found: Trials) -> list[Row]:
    """Contestants first, by the rule; then the controls."""
    made = []
    for which, by_name in found.items():
        for name, trials in by_name.items():
            kept = [t for fold, t in trials.items() if fold != TEST]
            last = trials[TEST]
            told = Errors.joined([t.errors for t in kept]).told()
            made.append(
                {
                    "name": name,
                    "targets": which,
                    "control": name in CONTROL_NAMES,
                    "rank": float(f"{rank_of(told):.5g}"),
                    "cross_validation": told,
                    "independent": last.errors.told(),
                    "setting": last.setting,
                    "settings_of_folds": settings(kept),
                    "tried": last.tried,
                    "seconds_per_million": last.per_million_s,
                    "regressor_bytes": last.bytes,
                    "shared_bytes": last.shared_bytes,
                }
            )
    return sorted(made, key=lambda row: (row["control"], row["rank"]))


def best(rows: list[Row]) -> dict[str, str]:
    """Who is first by the rule among those that are no controls."""
    first = min((row for row in rows if not row["control"]), key=lambda row: float(row["rank"]))
    return {"name": first["name"], "targets": first["targets"]}


def settings(trials: list[Trial]) -> list[dict[str, Any]]:
    """Which configurations the folds chose, the most frequent first."""
    every = Counter(json.dumps(t.setting, sort_keys=True) for t in trials)
    return [{"setting": json.loads(text), "folds": n} for text, n in every.most_common()]


def held(found: Trials) -> dict[str, float]:
    """Least share of the joined variance that a fold's features hold, by set of targets."""
    return {which: min(t.held for t in by_name[ALONE].values()) for which, by_name in found.items()}
