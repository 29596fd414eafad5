"""How far the surrogate is from runs it has not seen.

`errors` compares predictions with independent runs of an archive: relative errors of the tip
elongation, of CEEQ and damage at the worst place (in each run the node of the largest CEEQ at
the end, and the named critical node), root-mean-square errors of the fields, and the share of
true values inside the surrogate's own 95 % intervals. `polynomial_error` is what compiling to
polynomials adds, over a seeded sample of the box.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.archive import Archive
from core.errors import BladetwinError
from core.rng import stream
from core.surrogate.model import DEGREE, Surrogate
from core.surrogate.targets import DEFORMATION

Array = NDArray[np.float64]
EARLY_H = 1000.0
NORMAL_95 = 1.959964


def _relative(mean: Array, true: Array) -> Array:
    return np.asarray(np.abs(mean - true) / np.abs(true))


def _spread(error: Array) -> dict[str, float]:
    """Median and 95th percentile in per cent.

    >>> _spread(np.array([0.01, 0.02, 0.03]))
    {'median_percent': 2.0, 'p95_percent': 2.9}
    """
    median, high = np.quantile(error, [0.5, 0.95])
    return {
        "median_percent": round(100 * float(median), 4),
        "p95_percent": round(100 * float(high), 4),
    }


def _inside(mean: Array, sd: Array, true: Array) -> Array:
    return np.asarray(np.abs(true - mean) <= NORMAL_95 * sd)


def errors(model: Surrogate, archive: Archive, indices: Sequence[int]) -> dict[str, Any]:
    """Errors on the runs `indices`; percentages over instants from 1000 h and at the end."""
    time = model.time_h
    late = time >= EARLY_H
    x = archive.inputs(indices)
    out: dict[str, Any] = {"runs": len(indices), "from_h": EARLY_H}
    if "elongation" in model.quantities:
        out["elongation"] = _elongation(model, archive, indices, x, late)
    for name in ("ceeq", "creep_damage", "mises"):
        if name in model.quantities:
            out[name] = _field(model, archive, indices, x, late, name)
    if DEFORMATION in model.quantities:
        out[DEFORMATION] = _deformation(model, archive, indices, x)
    return out


def _elongation(
    model: Surrogate, archive: Archive, indices: Sequence[int], x: Array, late: NDArray[np.bool_]
) -> dict[str, Any]:
    true = archive.stack("elongation", indices).astype(float)
    mean, sd = model.predict(x, "elongation", model.time_h)
    return {
        "from_1000_h": _spread(_relative(mean[:, late], true[:, late])),
        "at_horizon": _spread(_relative(mean[:, -1], true[:, -1])),
        "rmse_mm": float(np.sqrt(np.mean((mean - true) ** 2))),
        "coverage_95": round(float(np.mean(_inside(mean, sd, true)[:, 1:])), 4),
    }


def _field(
    model: Surrogate,
    archive: Archive,
    indices: Sequence[int],
    x: Array,
    late: NDArray[np.bool_],
    name: str,
) -> dict[str, Any]:
    square, inside, worst, critical = [], [], [], []
    for k, index in enumerate(indices):
        true = archive.stack(name, [index])[0].astype(float)
        mean, sd = (one[0] for one in model.predict(x[k], name, model.time_h))
        square.append(np.mean((mean - true) ** 2))
        inside.append(np.mean(_inside(mean, sd, true)[1:]))
        place = int(np.argmax(true[-1]))
        worst.append(_relative(mean[late, place], true[late, place]))
        if "critical" in model.named:
            node = model.named["critical"]
            critical.append(_relative(mean[late, node], true[late, node]))
    found = {
        "worst_node_from_1000_h": _spread(np.array(worst)),
        "worst_node_at_horizon": _spread(np.array(worst)[:, -1]),
        "rmse": float(np.sqrt(np.mean(square))),
        "coverage_95": round(float(np.mean(inside)), 4),
    }
    if critical:
        found["critical_node_from_1000_h"] = _spread(np.array(critical))
    return found


def _deformation(
    model: Surrogate, archive: Archive, indices: Sequence[int], x: Array
) -> dict[str, Any]:
    square, inside, hot = [], [], []
    for k, index in enumerate(indices):
        total = archive.stack("displacement", [index])[0].astype(float)
        true = total - total[0]
        mean, sd = (one[0] for one in model.predict(x[k], DEFORMATION, model.time_h))
        square.append(np.mean((mean - true) ** 2))
        inside.append(np.mean(_inside(mean, sd, true)[1:]))
        mean, _ = model.predict(x[k], "displacement", model.time_h)
        hot.append(np.mean((mean[0] - total) ** 2))
    return {
        "rmse_mm": float(np.sqrt(np.mean(square))),
        "worst_run_rmse_mm": float(np.sqrt(np.max(square))),
        "displacement_rmse_mm": float(np.sqrt(np.mean(hot))),
        "coverage_95": round(float(np.mean(inside)), 4),
    }


def polynomial_error(
    model: Surrogate, *, degree: int = DEGREE, seed: int = 0, samples: int = 2000
) -> dict[str, Any]:
    """Relative error that `response` adds to `predict`, per quantity at the named nodes."""
    rng = stream(seed, "polynomial-error", degree)
    x = rng.uniform(model.low, model.high, (samples, len(model.inputs)))
    times = np.array([t for t in (1000.0, 8000.0, 24_000.0, 50_000.0) if t <= model.horizon_h])
    times = times if len(times) else model.time_h[-1:]
    out: dict[str, Any] = {"degree": degree, "samples": samples}
    for name, quantity in model.quantities.items():
        nodes = None if quantity.kind == "scalar" else sorted(set(model.named.values()))
        if nodes == []:
            raise BladetwinError("the model names no node to measure the polynomials at")
        direct, _ = model.predict(x, name, times, nodes)
        compiled, _ = model.response(name, times, nodes, degree).evaluate(x)
        direct = direct.reshape(samples, -1)
        scale = (
            np.abs(direct) if quantity.kind != "vector field" else np.abs(direct).max(1)[:, None]
        )
        error = np.abs(compiled - direct) / scale
        out[name] = _spread(error) | {"max_percent": round(100 * float(error.max()), 4)}
    return out
