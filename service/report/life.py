"""When blades pass a limit, before and after.

As permanent elongation and creep strain never fall, the hour T at which a blade passes a limit has
P(T ≤ t) = P(y(t) ≥ limit). So the quantiles of T are where the quantiles of the course pass: its
97.5 % passes first, at the 2.5 % of T. Of a quantity that is at or above the limit at hour 0 and
lower at the model's last hour the limit is passed from above, as of `core.life`, and its 2.5 %
passes first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

Json = Mapping[str, Any]
NEVER = 1e12  # h: the order of those that do not pass


@dataclass(frozen=True, slots=True)
class Life:
    """Hours of a blade until the limit: 2.5, 50 and 97.5 %; None: not within the model's hours."""

    early: float | None
    median: float | None
    late: float | None


@dataclass(frozen=True, slots=True)
class Lives:
    """Of one blade by both models, and its hours at its latest reading of any kind; 0: none."""

    blade: str
    now_h: float
    before: Life
    after: Life

    @property
    def moved_h(self) -> float | None:
        """By how much the median moves; None where one lies beyond the model's hours."""
        if self.before.median is None or self.after.median is None:
            return None
        return self.after.median - self.before.median


def passing(hours: Sequence[float], course: Sequence[float], limit: float) -> float | None:
    """The first hour at which a course passes a limit, linear between its hours; None: not by then.

    >>> passing([0.0, 100.0, 200.0], [0.0, 0.4, 0.6], 0.5)
    150.0
    >>> passing([0.0, 100.0], [0.0, 0.4], 0.5) is None
    True
    """
    y = list(accumulate(course, max))
    for k, value in enumerate(y):
        if value >= limit:
            if k == 0:
                return float(hours[0])
            share = (limit - y[k - 1]) / (value - y[k - 1])
            return hours[k - 1] + share * (hours[k] - hours[k - 1])
    return None


def lives(courses: Json, readings: Sequence[Json], limit: float) -> list[Lives]:
    """Of every blade, in the order of the medians after; those beyond the model's hours last."""
    hours = courses["time_h"]
    now: dict[str, float] = dict(zip(courses["blades"], courses.get("now_h", ()), strict=False))
    for r in readings if not now else ():  # of a release that told it of single values alone
        now[r["blade"]] = max(now.get(r["blade"], 0.0), r["time_h"])

    def life(course: Json, i: int) -> Life:
        mean, order, side = course["mean"][i], ("high", "median", "low"), 1.0
        if mean[0] >= limit and mean[-1] < mean[0]:
            order, side = ("low", "median", "high"), -1.0
        early, median, late = (
            passing(hours, [side * y for y in course[k][i]], side * limit) for k in order
        )
        return Life(early, median, late)

    found = [
        Lives(b, now.get(b, 0.0), life(courses["before"], i), life(courses["after"], i))
        for i, b in enumerate(courses["blades"])
    ]
    return sorted(
        found, key=lambda one: (NEVER if one.after.median is None else one.after.median, one.blade)
    )
