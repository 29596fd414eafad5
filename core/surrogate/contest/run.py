"""All trials of a contest; those that are there already are read.

They lie in a folder whose name holds the digest of the runs, the plan, the seed and the code that
makes them: a contest that was cut goes on, one of other runs or other code begins anew.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError
from core.surrogate.contest.boosters import SEVEN, installed
from core.surrogate.contest.features import SETS, Features, targets
from core.surrogate.contest.kept import Kept
from core.surrogate.contest.regressors import Contestant, controls
from core.surrogate.contest.trial import ALONE, TEST, Clock, Fold, Plan, Trial, folds, trial
from core.surrogate.targets import Target

Rows = NDArray[np.int64]
Progress = Callable[[int, int], None]
BESIDE = 4
"""Controls: three regressors that win nothing, and the features alone."""


def chosen(names: Sequence[str]) -> tuple[list[Contestant], list[str]]:
    """Contestants that can take part, and the names of those whose package is not installed."""
    known = {one.name: one for one in SEVEN}
    if unknown := [name for name in names if name not in known]:
        raise InputError("only", unknown, "are no contestants", f"use {', '.join(known)}")
    asked = [one for one in SEVEN if not names or one.name in names]
    return [one for one in asked if installed(one)], [o.name for o in asked if not installed(o)]


def run(
    kept: Kept,
    training: int,
    contestants: Sequence[Contestant],
    plan: Plan,
    *,
    seed: int,
    clock: Clock,
    folder: Path,
    progress: Progress = lambda done, total: None,
) -> dict[str, dict[str, dict[str, Trial]]]:
    """All trials, by set of targets, contestant or control, and fold; those in `folder` are read.

    training   the first so many of the runs; the others are independent
    """
    if not 1 < training < len(kept.indices) - 1:
        raise InputError(
            "training",
            training,
            f"leaves {len(kept.indices) - training} of {len(kept.indices)} runs to be measured on",
            "keep two independent runs or more",
        )
    own = folder / f"contest-{digest(kept, training, plan, seed)[:12]}"
    own.mkdir(parents=True, exist_ok=True)
    beside = controls(np.array([(i.high - i.low) / 2 for i in kept.declaration.inputs]))
    who: list[tuple[str, Contestant | None]] = [(c.name, c) for c in (*contestants, *beside)]
    who.append((ALONE, None))
    tests = np.arange(training, len(kept.indices))
    parts = [(str(k), *two) for k, two in enumerate(folds(training, plan.folds, seed=seed))]
    parts.append((TEST, np.arange(training), tests))
    found: dict[str, dict[str, dict[str, Trial]]] = {s: {n: {} for n, _ in who} for s in SETS}
    done, total = 0, trials(len(contestants), plan.folds)
    for which in SETS:
        made: dict[str, Target] = {}
        for name, fit, left in parts:
            files = {n: own / f"{which}-{name}-{plain(n)}.npz" for n, _ in who}
            fold = None
            for label, one in who:
                if not files[label].exists():
                    made = made or targets(kept, which)
                    fold = fold or _fold(name, made, fit, left, plan, seed)
                    trial(one, kept, fold, plan, seed, clock).save(files[label])
                found[which][label][name] = Trial.load(files[label])
                done += 1
                progress(done, total)
    return found


def trials(contestants: int, folds: int) -> int:
    """How many there are of so many contestants, the controls beside.

    >>> trials(7, 10)
    242
    """
    return len(SETS) * (folds + 1) * (contestants + BESIDE)


def _fold(
    name: str, parts: Mapping[str, Target], fit: Rows, left: Rows, plan: Plan, seed: int
) -> Fold:
    made, f = Features.of(parts, fit, plan.features, seed)
    return Fold(name, made, fit, left, f, made.encode(parts, left))


def _sources() -> Iterator[Path]:
    own = Path(__file__).parent
    yield from (own / f"{n}.py" for n in ("boosters", "chaos", "features", "kept", "regressors"))
    yield from (own / f"{n}.py" for n in ("run", "score", "trial"))
    yield from (own.parent / f"{n}.py" for n in ("kernel", "likelihood", "targets", "tucker"))


def digest(kept: Kept, training: int, plan: Plan, seed: int) -> str:
    """SHA-256 of everything that the trials come of."""
    total = sha256(kept.declaration.to_json().encode())
    total.update(json.dumps([asdict(plan), kept.indices, training, seed]).encode())
    for array in (kept.x, kept.nodes, *(kept.arrays[n] for n in sorted(kept.arrays))):
        total.update(np.ascontiguousarray(array).data)
    for file in _sources():
        total.update(file.read_bytes())
    return total.hexdigest()


def plain(name: str) -> str:
    """A contestant's name in the name of a file.

    >>> plain("scikit-learn's process, scaled inputs")
    'scikit-learn-s-process-scaled-inputs'
    """
    return re.sub(r"[^a-z0-9]+", "-", name.lower())
