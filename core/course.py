"""How an input runs in time: piecewise linear over operating hours, with steps.

A course is given by points (hour, value); between them it is linear, beyond them constant, and two
points at one hour are a step, which counts from that hour on. What follows a course (finite
elements, the surrogate's rule) goes piece by piece and holds the input at its mean on each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Course:
    """An input's value over operating hours: points (hour, value), hours never falling."""

    points: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        hours = [hour for hour, _ in self.points]
        if not hours or not all(math.isfinite(v) for point in self.points for v in point):
            raise InputError("course", self.points, "is no course", "give finite (hour, value)")
        if any(b < a for a, b in pairwise(hours)) or any(
            a == b == c for a, b, c in zip(hours, hours[1:], hours[2:], strict=False)
        ):
            raise InputError("course", self.points, "is out of order", "sort it by hours")

    @staticmethod
    def of(given: float | Sequence[tuple[float, float]] | Course) -> Course:
        """A constant, points, or a course as it is."""
        if isinstance(given, Course):
            return given
        if isinstance(given, Sequence):
            return Course(tuple((float(hour), float(value)) for hour, value in given))
        return Course(((0.0, float(given)),))

    @property
    def constant(self) -> bool:
        return len({value for _, value in self.points}) == 1

    @property
    def values(self) -> Array:
        """The values at the points; no other is larger or smaller."""
        return np.array([value for _, value in self.points])

    def over(self, start: float, end: float) -> Array:
        """The values at both ends of an interval and at the points inside, those of a step at its
        end before and after it: the course is nowhere larger or smaller there.

        >>> Course.of([(0.0, 0.0), (60.0, 1.2)]).over(0.0, 50.0).tolist()
        [0.0, 1.0]
        """
        inside = [value for hour, value in self.points if start < hour <= end]
        return np.array([float(self.at(start)), *inside, float(self.at(end))])

    def at(self, hours: Array | float) -> Array:
        """Values at hours; at a step, the one after it.

        >>> Course.of([(0.0, 1.0), (10.0, 1.0), (10.0, 2.0)]).at(np.array([9.0, 10.0])).tolist()
        [1.0, 2.0]
        """
        x, y = np.array(self.points).T
        found = np.interp(hours, x, y)
        for (a, _), (b, after) in pairwise(self.points):
            if a == b:
                found = np.where(np.asarray(hours) == b, after, found)
        return np.asarray(found)

    def shifted(self, zero: float) -> Course:
        """The same, counted from an hour of its own.

        >>> Course.of([(0.0, 0.0), (10.0, 1.0)]).shifted(4.0).at(2.0)
        array(0.6)
        """
        return Course(tuple((hour - zero, value) for hour, value in self.points))

    def mean(self, start: float, end: float) -> float:
        """The mean over an interval that holds no point inside."""
        middle = 0.5 * (start + end)
        return float(self.at(middle))

    def cuts(self, count: int) -> list[float]:
        """Hours between which the input hardly changes: its points, and each ramp in parts.

        A ramp over the whole range of the course gets `count` parts, a smaller one fewer; so does
        every way of one that goes to and fro, for what is lost between the parts grows with the
        square of their step.

        >>> Course.of([(0.0, 1.0), (8.0, 0.5)]).cuts(4)
        [0.0, 2.0, 4.0, 6.0, 8.0]
        >>> Course.of([(0.0, 1.0), (8.0, 0.5), (12.0, 1.0)]).cuts(2)
        [0.0, 4.0, 8.0, 10.0, 12.0]
        """
        change = float(np.ptp(self.values))
        found = {hour for hour, _ in self.points}
        for (a, low), (b, high) in pairwise(self.points):
            if b > a and low != high:
                parts = math.ceil(count * abs(high - low) / change - 1e-9)
                found |= set(np.linspace(a, b, parts + 1).tolist())
        return sorted(found)


def pieces(courses: Mapping[str, Course], until: float, count: int) -> list[tuple[float, float]]:
    """Intervals of [0, until] on which every course is held at its mean, in order."""
    cuts = {h for course in courses.values() for h in course.cuts(count) if 0 < h < until}
    return list(pairwise([0.0, *sorted(cuts), until]))
