"""One contestant on one fold: tuned within, fitted, measured.

A trial's random numbers depend on the seed and its own names alone, so that trials may be made in
any order and kept: each is written to a file under a temporary name and renamed.
"""

from __future__ import annotations

import json
import os
import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError
from core.rng import seed_of, stream
from core.surrogate.contest.features import Features
from core.surrogate.contest.kept import Kept
from core.surrogate.contest.regressors import Contestant, Effort, Fitted, Setting
from core.surrogate.contest.score import Errors, rank_of
from core.surrogate.targets import MEAN_CEEQ

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
Clock = Callable[[], float]
Predicted = Sequence[tuple[Rows, Array]]
Judge = Callable[[Predicted], float]
"""From runs left out (positions) and their predicted features to what is lost."""
TEST = "independent"
ALONE = "the features themselves"
"""A control: what is lost by the reduction alone, whoever predicts."""


@dataclass(frozen=True, slots=True)
class Plan:
    """How much is done.

    folds, inner      of the cross-validation, and of the one within its training runs
    configurations    tried by each contestant, the first of its list
    trees, rounds     of forests and of boosters
    features          learnt, at most
    nodes             sampled, over which fields are compared
    timed             points at which predictions are timed
    """

    folds: int = 10
    inner: int = 3
    configurations: int = 6
    trees: int = 100
    rounds: int = 150
    features: int = 40
    nodes: int = 600
    timed: int = 20_000


QUICK = Plan(3, 2, 2, 30, 40, 16, 60, 2000)


@dataclass(frozen=True, slots=True)
class Trial:
    """What came of it: the configuration chosen, the errors; speed and size of the last fit.

    held          share of the joined variance in the fold's features
    bytes         of the regressor;  shared_bytes: of bases and features on the whole mesh
    """

    setting: dict[str, Any]
    tried: int
    held: float
    errors: Errors
    per_million_s: float | None = None
    bytes: int | None = None
    shared_bytes: int | None = None

    def save(self, file: Path) -> None:
        """Write to an npz file, at once or not at all."""
        facts = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "errors"}
        arrays = {f.name: getattr(self.errors, f.name) for f in fields(self.errors)}
        part = file.with_name(f".{file.name}.part")
        with open(part, "wb") as handle:
            np.savez(handle, allow_pickle=False, facts=np.array(json.dumps(facts)), **arrays)
        os.replace(part, file)

    @classmethod
    def load(cls, file: Path) -> Trial:
        """Read what `save` wrote."""
        with np.load(file, allow_pickle=False) as data:
            facts = json.loads(str(data["facts"]))
            errors = Errors(**{f.name: data[f.name] for f in fields(Errors)})
        return cls(errors=errors, **facts)


@dataclass(frozen=True, slots=True)
class Fold:
    """Training runs and runs left out (positions), with the features of both."""

    name: str
    made: Features
    fit: Rows
    left: Rows
    f: Array
    f_left: Array


def folds(n: int, count: int, *key: str | int, seed: int) -> list[tuple[Rows, Rows]]:
    """Training and left-out positions of each fold."""
    order = stream(seed, "contest", n, count, *key).permutation(n)
    left = [np.sort(order[k::count]) for k in range(count)]
    return [(np.setdiff1d(order, one), one) for one in left if len(one)]


def tuned(
    one: Contestant, z: Array, f: Array, judge: Judge, plan: Plan, seed: int
) -> tuple[Setting, int]:
    """The configuration that the judge likes best by inner folds; and how many were tried."""
    inner = folds(len(z), plan.inner, "inner", seed=seed)
    least = min(len(fit) for fit, _ in inner)
    able = [s for s in one.settings if one.carries(least, z.shape[1], s)][: plan.configurations]
    if not able:
        raise InputError("runs", len(z), f"carry no configuration of {one.name}", "make more runs")
    if len(able) == 1:
        return able[0], 1
    effort = Effort(plan.trees, plan.rounds, seed_of(seed, one.name))
    lost = [
        judge([(left, one.fit(z[fit], f[fit], s, effort).predict(z[left])) for fit, left in inner])
        for s in able
    ]
    return able[int(np.argmin(np.nan_to_num(lost, nan=np.inf)))], len(able)


def by_rule(kept: Kept, fold: Fold) -> Judge:
    """The contest's own rule, on training runs of a fold that inner folds left out."""

    def judge(parts: Predicted) -> float:
        errors = [
            Errors.of(kept, fold.made, fold.fit[left], fold.f[left], told) for left, told in parts
        ]
        return rank_of(Errors.joined(errors).told())

    return judge


def trial(
    one: Contestant | None, kept: Kept, fold: Fold, plan: Plan, seed: int, clock: Clock
) -> Trial:
    """One contestant (None: the control `ALONE`) on a fold; the last one is timed and weighed."""
    if one is None:
        errors = Errors.of(kept, fold.made, fold.left, fold.f_left, fold.f_left)
        return Trial({}, 0, fold.made.held, errors)
    z = kept.z
    setting, tried = tuned(one, z[fold.fit], fold.f, by_rule(kept, fold), plan, seed)
    effort = Effort(plan.trees, plan.rounds, seed_of(seed, one.name))
    fitted = one.fit(z[fold.fit], fold.f, setting, effort)
    errors = Errors.of(kept, fold.made, fold.left, fold.f_left, fitted.predict(z[fold.left]))
    facts = dict(setting), tried, fold.made.held, errors
    if fold.name != TEST:
        return Trial(*facts)
    speed = seconds_per_million(fitted, fold.made, z.shape[1], plan.timed, clock)
    size = len(pickle.dumps(fitted.keeps, protocol=5))
    shared = fold.made.nbytes_on(len(kept.nodes), kept.declaration.nodes)
    return Trial(*facts, speed, size, shared)


def seconds_per_million(fitted: Fitted, made: Features, d: int, points: int, clock: Clock) -> float:
    """Of the tip elongation at the last instant, from inputs to mm; the best of three."""
    z = stream(0, "contest-speed", d).uniform(-1.0, 1.0, (points, d))
    forms = made.tip_forms()
    a, b = forms["elongation"]

    def once() -> float:
        start = clock()
        f = fitted.predict(z)
        tip = a + f @ b
        if MEAN_CEEQ in forms:
            log_a, log_b = forms[MEAN_CEEQ]
            tip *= np.exp(log_a + f @ log_b)
        return clock() - start

    return float(f"{min(once() for _ in range(3)) * 1e6 / points:.3g}")
