"""What the study of adaptive designs counts: runs needed for an error, and their ratios."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, slots=True)
class Point:
    """A design of n runs: its error on the pool, rms and 95th percentile; p95 that it claims."""

    n: int
    rms: float
    p95: float
    said: float | None = None


def runs_needed(curve: Sequence[Point], error: float) -> tuple[float, bool]:
    """Runs after which a curve stays at or below an error; False: it did not, a lower bound.

    >>> falling = [Point(16, 0.04, 0), Point(20, 0.02, 0), Point(32, 0.005, 0)]
    >>> round(runs_needed(falling, 0.01)[0], 3), runs_needed(falling, 0.001)[1]
    (25.298, False)
    """
    n = np.array([float(one.n) for one in curve])
    stays = np.maximum.accumulate([one.rms for one in curve][::-1])[::-1]
    if stays[-1] > error:
        return float(n[-1] ** 2 / n[-2]), False
    k = int(np.argmax(stays <= error))
    if k == 0:
        return float(n[0]), True
    share = np.log(stays[k - 1] / error) / np.log(stays[k - 1] / stays[k])
    return float(n[k - 1] * (n[k] / n[k - 1]) ** share), True


def ratios(curve: Sequence[Point], shots: Sequence[Point]) -> dict[str, Any]:
    """n / N by one-shot size N, and their geometric mean."""
    rows, best = [], np.inf
    for k, shot in enumerate(shots):
        best = min(best, shot.rms)
        if k:
            needed, known = runs_needed(curve, best)
            rows.append({"size": shot.n, "error": best, "runs": needed, "reached": known})
    every = [row["runs"] / row["size"] for row in rows]
    for row, value in zip(rows, every, strict=True):
        row["ratio"] = value
    return {
        "by_size": rows,
        "ratio": float(np.exp(np.mean(np.log(every)))),
        "reached": all(row["reached"] for row in rows),
    }


def summary(rows: Sequence[Mapping[str, Any]], limit: float = 0.70) -> dict[str, Any]:
    """Ratios over seeds: mean, sd, range, at each size and together; whether all are below."""
    out: dict[str, Any] = {}
    for name in ("ratios", "uniform_ratios"):
        own = np.array([row[name]["ratio"] for row in rows])
        sizes = [one["size"] for one in rows[0][name]["by_size"]]
        at = {
            str(n): [row[name]["by_size"][k]["ratio"] for row in rows] for k, n in enumerate(sizes)
        }
        out[name] = {
            "median": float(np.median(own)),
            "mean": float(own.mean()),
            "sd": float(own.std(ddof=1)) if len(own) > 1 else None,
            "range": [float(own.min()), float(own.max())],
            "reached": sum(bool(row[name]["reached"]) for row in rows),
            "at_size": {n: float(np.exp(np.mean(np.log(v)))) for n, v in at.items()},
        }
    every = [row["ratios"]["ratio"] for row in rows]
    out["limit"] = limit
    out["met_by_mean"] = float(np.mean(every)) <= limit
    out["seeds_met"] = sum(value <= limit for value in every)
    return out
