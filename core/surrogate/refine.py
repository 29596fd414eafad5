"""Adaptive sampling: train, look where it matters, run there, again.

It begins with a small maximin design, or with the runs that an archive has. Each round trains the
surrogate on all runs, asks for the region that matters (a posterior, which may rest on that
surrogate), measures the accuracy there (`core.surrogate.accuracy`) and, as long as a goal is not
met, chooses a batch of further runs by their exact reduction of the region's variance
(`core.design.acquisition`). Candidates are a Sobol sequence over the box and points of the region.

Runs are chosen by a process with shorter length scales than the fitted one may have: no longer than
the box, and a nugget of 1e-6 at least. From few runs of a smooth response length scales of several
boxes are fitted; such a process believes in a polynomial and sends every run to the box's far
corners (`core/decisions.md` has what that costs).

Every round is written to ``refinement.json`` beside the runs, with the points that it wants, before
they are run. A refinement that was cut goes on with the points that are missing, and ends with the
same runs as one that was not: a round is a function of the runs, the region and the seed. Runs that
fail are named, tried again by the next call, and until then count as run for the choice of others.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from core.archive import Archive
from core.archive.take import MINIMUM_RUNS
from core.design import Region, choose, maximin_lhs
from core.design.region import sobol
from core.errors import InputError, ModelError, RangeError
from core.rng import seed_of, stream
from core.surrogate.accuracy import Goal, accuracy, cost
from core.surrogate.kernel import Hyper, SharedGP
from core.surrogate.model import Surrogate
from core.surrogate.rounds import Plan, Refined, Round, free, planned, read_log, write_log
from core.surrogate.training import train

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]
Regions = Callable[[Surrogate], tuple[Region, str]]
"""The region that matters by a surrogate, and in words what it is."""
Runs = Callable[[Archive, Mapping[int, Array], Callable[[int], None]], Mapping[int, str]]
"""Write the runs at these points, by index, to the archive, telling how many are done; the reasons
of those that failed."""
CANDIDATES, ELSEWHERE, AROUND = 2048, 128, 512
LONGEST, LEAST_NUGGET = 2.0, 1e-6  # of the process that chooses; the box is 2 wide


def refine(
    archive: Archive,
    runs: Runs,
    regions: Regions,
    goals: Sequence[Goal],
    plan: Plan,
    *,
    progress: Progress = lambda what, done, total: None,
    seen: Callable[[Round, Surrogate], None] = lambda made, surrogate: None,
) -> Refined:
    """Add runs to the archive until every goal is met, or `plan.most` runs are there.

    seen   called after each round, before its runs
    Raises InputError for a plan that makes no sense, RangeError for hours beyond the runs' or at
    their start alone, ModelError where too few runs succeed.
    """
    plan.check()
    if not goals:
        raise InputError("accuracy", "", "names no quantity", "name one at least")
    declared = archive.declaration
    for goal in goals:
        if goal.times_h and not any(goal.times_h):
            problem = (
                "is where runs begin: nothing has happened by then, and nothing is learnt of it"
            )
            raise RangeError("hours", 0.0, problem, "name a later one, alone or beside it")
    for hour in (one for goal in goals for one in goal.times_h):
        if not 0 <= hour <= declared.time_h[-1]:
            problem = f"lies outside 0 … {declared.time_h[-1]:g} h, which the runs cover"
            raise RangeError("hours", hour, problem, "ask inside")
    low, high = (np.array([getattr(i, end) for i in declared.inputs]) for end in ("low", "high"))
    rounds = list(read_log(archive.path))
    failed = _first(archive, runs, plan, rounds, low, high, progress)

    def training(what: str, done: int, total: int) -> None:
        progress("training", done, total)

    while True:
        start = time.monotonic()
        done = archive.done()
        _enough(done, failed, len(low))
        surrogate = train(archive, done, seed=plan.seed, progress=training)
        region, words = regions(surrogate)
        found = tuple(accuracy(surrogate, region, goals))
        room = plan.most - len(done) - len(failed)
        ended = room <= 0 or all(one.met for one in found)
        points: Array = np.zeros((0, len(low)))
        if not ended:
            missing = np.array([planned(rounds)[k] for k in failed]).reshape(-1, len(low))
            wide = region.mixed(
                low, high, plan.elsewhere, ELSEWHERE, seed_of(plan.seed, "elsewhere")
            )
            points = _next(surrogate, wide, goals, min(plan.batch, room), missing, plan.seed)
        held = surrogate.manifest["training"]["held_out"]
        made = Round(
            runs=len(done),
            accuracy=found,
            region=words,
            held_out={g.quantity: held[g.quantity]["rms"] for g in goals if g.quantity in held},
            first=free(done, rounds),
            points=tuple(map(tuple, points.tolist())),
            seconds=round(time.monotonic() - start, 3),
        )
        if rounds and rounds[-1].runs == made.runs and not rounds[-1].points:
            rounds.pop()  # the end of an earlier call, which this one goes on from
        rounds.append(made)
        write_log(archive, rounds)
        seen(made, surrogate)
        if ended:
            return Refined(surrogate, tuple(rounds), failed)
        todo = dict(enumerate(points, made.first))
        failed = {**failed, **_run(archive, runs, todo, plan.most, progress)}


def _first(
    archive: Archive,
    runs: Runs,
    plan: Plan,
    rounds: list[Round],
    low: Array,
    high: Array,
    progress: Progress,
) -> dict[int, str]:
    """Make what earlier rounds wanted, or the first design where the archive is empty."""
    if not rounds and not archive.done():
        n = plan.first(len(low))
        points = maximin_lhs(n, low, high, seed_of(plan.seed, "refine", n))
        begun = Round(0, (), "maximin design", {}, 0, tuple(map(tuple, points.tolist())), 0.0)
        rounds.append(begun)
        write_log(archive, rounds)
    there = set(archive.done())
    todo = {k: x for k, x in planned(rounds).items() if k not in there}
    return _run(archive, runs, todo, plan.most, progress) if todo else {}


def _enough(done: Sequence[int], failed: Mapping[int, str], d: int) -> None:
    need = MINIMUM_RUNS * (d + 1)
    if len(done) < need:
        why = "".join(f"; run {k} failed: {said}" for k, said in [*failed.items()][:1])
        raise ModelError(f"{len(done)} runs are there, and {need} are needed for {d} inputs{why}")


def _run(
    archive: Archive, runs: Runs, todo: Mapping[int, Array], most: int, progress: Progress
) -> dict[int, str]:
    """Make runs; the progress is that of all runs towards the most that there may be."""
    there = len(archive.done())
    total = max(most, there + len(todo))
    progress("runs", there, total)
    return dict(runs(archive, todo, lambda done: progress("runs", there + done, total)))


def candidates(region: Region, low: Array, high: Array, seed: int) -> Array:
    """Where a run may be made, (n, d): evenly over the box, and points of the region."""
    x = sobol(CANDIDATES, low, high, seed_of(seed, "candidates"))
    own = np.flatnonzero(region.weight > 0)
    some = stream(seed, "around").permutation(own)[:AROUND]
    return np.vstack([x, np.clip(region.x[some], low, high)])


def cautious(process: SharedGP) -> SharedGP:
    """The process that chooses runs: at the same points, with length scales of the box at most."""
    own = process.hyper
    lengths = tuple(min(length, LONGEST) for length in own.lengths)
    hyper = Hyper(lengths, max(own.nugget, LEAST_NUGGET), own.trend)
    return SharedGP.condition(process.z, np.zeros((len(process.z), 1)), hyper)


def _next(
    surrogate: Surrogate,
    region: Region,
    goals: Sequence[Goal],
    count: int,
    missing: Array,
    seed: int,
) -> Array:
    """The next `count` runs (count, d), those of `missing` (k, d) taken for run."""
    x = candidates(region, surrogate.low, surrogate.high, seed)
    weight = region.weight * cost(surrogate, region, goals)
    index, _ = choose(
        cautious(surrogate.process),
        surrogate.scaled(x),
        surrogate.scaled(region.x),
        weight / weight.sum(),
        count,
        surrogate.scaled(missing) if len(missing) else None,
    )
    return np.asarray(x[index])
