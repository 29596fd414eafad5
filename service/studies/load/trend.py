"""Windows of time, percentiles in them, and whether a course grows.

A course is said to grow where the Theil-Sen slope (the median of the slopes between all pairs of
points, which a few outliers do not move) is above zero with its whole 95 % interval, and adds more
than `SHARE` of the median over the time that was watched. The first `WARM` of the time is left out:
caches fill. From less than `ENOUGH_S` seconds nothing is concluded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import theilslopes

from service.studies.load.crowd import Answered

PERCENTILES = (50, 95, 99)
WARM, SHARE, ENOUGH_S = 0.25, 0.05, 600.0
LEAST_POINTS = 8


def percentiles(values: Sequence[float]) -> dict[str, float | None]:
    """p50, p95, p99 and the largest, ms; None where there is nothing.

    >>> percentiles([0.001 * i for i in range(1, 101)])["p99"]
    99.0
    """
    if not values:
        return dict.fromkeys([*(f"p{p}" for p in PERCENTILES), "max"])
    sorted_ms = np.sort(np.asarray(values)) * 1e3
    found = np.percentile(sorted_ms, PERCENTILES, method="inverted_cdf")
    told: dict[str, float | None] = {
        f"p{p}": round(float(v), 1) for p, v in zip(PERCENTILES, found, strict=True)
    }
    return told | {"max": round(float(sorted_ms[-1]), 1)}


def summary(answered: Sequence[Answered]) -> dict[str, Any]:
    """Counts, latencies of what was answered as it should be, and what was not."""
    told: dict[str, Any] = {}
    for name, kinds in (("posts", ("post",)), ("reads", ("rotor", "prediction", "readings"))):
        own = [one for one in answered if one.kind in kinds]
        good = [one.took_s for one in own if one.good]
        told[name] = {"answered": len(own), "good": len(good), **percentiles(good)}
    wrong: dict[str, int] = {}
    for one in (one for one in answered if not one.good):
        key = f"{one.kind}: {one.status} {one.problem[:160]}".strip()
        wrong[key] = wrong.get(key, 0) + 1
    return told | {"not_good": dict(sorted(wrong.items())[:20])}


def slope(at_s: Sequence[float], values: Sequence[float | None]) -> dict[str, Any]:
    """The course in words and numbers: ``grows``, ``flat`` or ``too short to tell``.

    per_hour   Theil-Sen slope, in the course's unit an hour, with its 95 % interval
    """
    pairs = [(t, v) for t, v in zip(at_s, values, strict=True) if v is not None]
    last = max(at_s, default=0.0)
    pairs = [(t, v) for t, v in pairs if t >= WARM * last]
    if len(pairs) < LEAST_POINTS:
        return {"verdict": "too short to tell"}
    t, v = np.array(pairs).T
    found = theilslopes(v, t / 3600.0, alpha=0.95)
    median = float(np.median(v))
    added = float(found.slope) * (t[-1] - t[0]) / 3600.0
    grows = found.low_slope > 0 and added > SHARE * max(abs(median), 1e-9)
    verdict = "grows" if grows else "flat"
    return {
        "verdict": verdict if last >= ENOUGH_S else "too short to tell",
        "median": round(median, 3),
        "per_hour": round(float(found.slope), 3),
        "interval": [round(float(found.low_slope), 3), round(float(found.high_slope), 3)],
    }


def trends(samples: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The slope of each process' memory, the backlog, its age, and the 99th percentiles."""
    at = [float(one["at_s"]) for one in samples]
    names = sorted({name for one in samples for name in one["memory_mb"]})
    told = {f"memory of {n} [MiB]": [one["memory_mb"].get(n) for one in samples] for n in names}
    told["backlog [entries]"] = [one["gauges"].get("backlog_entries") for one in samples]
    told["oldest entry [s]"] = [one["gauges"].get("oldest_entry_seconds") for one in samples]
    for name in ("posts", "reads"):
        told[f"p99 of {name} [ms]"] = [one[name]["p99"] for one in samples]
    return {name: slope(at, values) for name, values in told.items()}
