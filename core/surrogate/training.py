"""From an archive to a surrogate.

1. Each part's target is put in Tucker form. Where a quantity allows several forms (mises: its
   logarithm or itself) five-fold cross-validation decides, by the error of the quantity itself.
2. All coefficients get one Gaussian process. Its hyperparameters maximise the restricted
   likelihood of the coefficients that make up 99 % of each part's variance; parts weigh the
   same. The degree of the trend (0, 1, 2) is the one of smallest leave-one-out error.
3. Errors: leave-one-out residuals give the covariance C; ten-fold cross-validation over the
   training runs, bases refitted each time, gives the factor f by which the 95 % intervals have
   to grow to cover 95 %, and the power of v that errors go with. Test runs are never looked at
   here. The same folds tell how far each quantity is off at runs that were left out, in its own
   unit (`Held`).

Runs of the same inputs count once, the first of them: a run whose twin stays foretells itself when
it is left out, and the error would be that of no surrogate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.archive import Archive, Quantity
from core.archive.take import MINIMUM_RUNS
from core.errors import ModelError
from core.rng import stream
from core.surrogate.fitting import (
    SAMPLED_ROWS,
    Fitted,
    assemble,
    hyper_of,
    reduced,
    typical_variance,
)
from core.surrogate.held_out import FOLDS, calibrate, folds
from core.surrogate.kernel import SharedGP
from core.surrogate.model import Surrogate
from core.surrogate.targets import DEFORMATION, Target, invert, targets_of

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]


def train(
    archive: Archive,
    indices: Sequence[int] | None = None,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> Surrogate:
    """Train on the runs `indices` of an archive (default: all of them)."""
    declared, d = archive.declaration, len(archive.declaration.inputs)
    low = np.array([item.low for item in declared.inputs])
    high = np.array([item.high for item in declared.inputs])
    chosen, x = _single(archive, archive.done() if indices is None else indices, high - low)
    if len(chosen) < MINIMUM_RUNS * (d + 1):
        raise ModelError(
            f"{len(chosen)} runs are too few for {d} inputs: make {MINIMUM_RUNS * (d + 1)} or more"
        )
    say = progress or (lambda what, done, total: None)
    z = 2.0 * (x - low) / (high - low) - 1.0

    fitted: dict[str, Fitted] = {}
    steps = len(declared.quantities) + 1 + FOLDS
    for candidates in targets_of(archive, chosen):
        say(f"reducing {candidates[0].name}", min(len(fitted), len(declared.quantities)), steps)
        best = candidates[0]
        if len(candidates) > 1:
            best = min(candidates, key=lambda t: _form_error(z, t, seed))
        fitted[best.name] = reduced(best, seed)
    say("fitting the process", len(declared.quantities), steps)
    hyper = hyper_of(z, fitted)
    process, parts = assemble(z, fitted, hyper)
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
        cells=(mesh.kind, np.asarray(mesh.cells, dtype=np.int64)) if mesh.kind else None,
        process=process,
        parts=parts,
        v_typical=typical_variance(process),
    )
    targets = {name: one.target for name, one in fitted.items()}
    found = calibrate(
        z, targets, hyper, seed, lambda k: say("calibrating the errors", steps - FOLDS + k, steps)
    )
    parts = {
        name: replace(part, inflation=found[name].inflation, power=found[name].power)
        for name, part in parts.items()
    }
    bases = {
        name: {
            "form": part.form,
            "space": part.factors.space.shape[1],
            "time": part.factors.time.shape[1],
            "coefficients": part.factors.coefficients,
            "held_out_percent": round(100 * found[name].lost, 4),
            "inflation": round(part.inflation, 4),
            "power": round(part.power, 4),
        }
        for name, part in parts.items()
    }
    notes: dict[str, Any] = {"runs": len(chosen), "seed": seed, "hyper": asdict(hyper)}
    notes |= {"bases": bases, "held_out": {name: one.to_json() for name, one in found.items()}}
    return replace(made, parts=parts, manifest={"training": notes})


def _single(
    archive: Archive, indices: Sequence[int], width: Array
) -> tuple[tuple[int, ...], Array]:
    """The first run of each inputs, to 1e-9 of their `width` (d,), and these, (n, d)."""
    x = archive.inputs(indices)
    first = np.sort(np.unique(np.round(x / width, 9), axis=0, return_index=True)[1])
    return tuple(indices[k] for k in first), x[first]


def _form_error(z: Array, target: Target, seed: int) -> float:
    """Root-mean-square error of y over five folds, the hyperparameters those of all runs."""
    rows = target.values.shape[2]
    sampled = stream(seed, "form", target.name).permutation(rows)[: min(rows, SAMPLED_ROWS)]
    small = replace(target, values=target.values[:, :, sampled])
    hyper = hyper_of(z, {target.name: reduced(small, seed)}, trends=(1,))
    error = []
    for kept, left in folds(len(z), 5, seed):
        fold = reduced(replace(small, values=small.values[kept]), seed)
        (c,), _ = SharedGP.condition(z[kept], fold.c, hyper).mean_and_variance(z[left])
        mean = fold.factors.decode(c, target.time_h, np.arange(len(sampled)))
        y = invert(target.form, small.values[left], target.time_h)
        error.append(np.mean((invert(target.form, mean, target.time_h) - y) ** 2))
    return float(np.sqrt(np.mean(error)))
