"""What a run of the study is held against: nothing lost, refused or growing, and latencies.

Memory and the backlog must not grow. A latency grows with the log, for an update looks at all
readings of its rotor: it must stay below what is asked of it for as many readings as a rotor has in
service. `LIFE_H` hours of the study's load are some 10,700 a rotor; 100 blades in 30 outages with
three quantities each have 9,000.

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
# What a latency may come to; of a reading's age until it counts: what a person takes for at once.
LATENCIES = {"p99 of posts [ms]": 250.0, "p99 of reads [ms]": 100.0, "oldest entry [s]": 1.0}
LIFE_H = 10.0


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
    for name, one in told["trends"].items():
        if one["verdict"] == "grows" and name not in LATENCIES:
            found.append(f"{name} grows")
        if one["verdict"] == "grows" and name in LATENCIES and _reaches(one, LATENCIES[name]):
            most = f"{LATENCIES[name]:g} within {LIFE_H:g} h of this load"
            found.append(f"{name} grows, and comes to {most}")
    for name, asked in aims_ms.items():
        p99 = told[name]["p99"]
        if p99 is not None and p99 > asked:
            found.append(f"p99 of {name} is {p99:g} ms, asked for {asked:g} ms at most")
    return found


def _reaches(course: Mapping[str, Any], most: float) -> bool:
    """Whether a course that goes on as it went, by the steeper end of its slope's interval, comes
    to `most` within `LIFE_H` hours."""
    return bool(course["median"] + LIFE_H * course["interval"][1] >= most)


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
