"""What a run of the study is held against: nothing lost, refused or growing, and latencies.

The 99th percentiles are judged over the whole run, its first seconds with empty caches included,
and count from when a request was due (see `crowd`). How much two workers bring is judged over
pairs of runs next to one another in time, one worker and two in alternating order, by the median
of the pairs' ratios: a neighbour that takes the processor for a while spoils one pair.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

NO_AIMS: Mapping[str, float] = {}


def faults(told: Mapping[str, Any], aims_ms: Mapping[str, float] = NO_AIMS) -> list[str]:
    """Sentences on what is not as it should be; none: the run passes.

    told     a run as `run.loaded` tells it
    aims_ms  the largest 99th percentile of ``posts`` and ``reads``, ms; one left out is not judged
    """
    found = []
    if told["posted"] != told["applied"]:
        found.append(f"{told['posted']} readings were acknowledged and {told['applied']} applied")
    found += [f"{count} × {what}" for what, count in told["not_good"].items()]
    if told["locked"]:
        found.append("a database was locked")
    found += [f"{name} grows" for name, one in told["trends"].items() if one["verdict"] == "grows"]
    for name, most in aims_ms.items():
        p99 = told[name]["p99"]
        if p99 is not None and p99 > most:
            found.append(f"p99 of {name} is {p99:g} ms, asked for {most:g} ms at most")
    return found


def order(pairs: int) -> list[int]:
    """Workers of each run, one after the other, so that no number always comes first.

    >>> order(3)
    [1, 2, 2, 1, 1, 2]
    """
    return [n for pair in range(pairs) for n in ((1, 2) if pair % 2 == 0 else (2, 1))]


def gain(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Rotors a second of two workers over those of one: each pair's ratio, and their median.

    rows  runs of `run.worked_off` in the order of `order`

    >>> one, two = {"workers": 1, "rotors_per_s": 4.0}, {"workers": 2, "rotors_per_s": 7.0}
    >>> gain([one, two, {**two, "rotors_per_s": 8.0}, one])
    {'ratios': [1.75, 2.0], 'median': 1.875}
    """
    ratios = []
    for first, second in zip(rows[::2], rows[1::2], strict=True):
        by = {row["workers"]: row["rotors_per_s"] for row in (first, second)}
        ratios.append(round(by[2] / by[1], 3))
    return {"ratios": ratios, "median": round(median(ratios), 3)}
