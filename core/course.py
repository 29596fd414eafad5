"""How an input runs in time: piecewise linear over operating hours, with steps.

A course is given by points (hour, value); between them it is linear, beyond them constant, and two
points at one hour are a step, which counts from that hour on. What follows a course (finite
elements, the surrogate's rule) goes piece by piece and holds the input at its mean on each.

A `Drift` moves an input by an amplitude a along a shape s, x + a s(t) or x (1 + a s(t)): what is
not known of the course is one parameter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

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

    def mean(self, start: float, end: float) -> float:
        """The mean over an interval that holds no point inside."""
        middle = 0.5 * (start + end)
        return float(self.at(middle))

    def cuts(self, count: int) -> list[float]:
        """Hours between which the input hardly changes: its points, and each ramp in parts.

        A ramp gets so many of `count` parts as it has of the whole change.

        >>> Course.of([(0.0, 1.0), (8.0, 0.5)]).cuts(4)
        [0.0, 2.0, 4.0, 6.0, 8.0]
        """
        change = float(np.sum(np.abs(np.diff(self.values))))
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


@dataclass(frozen=True, slots=True)
class Drift:
    """One input that runs in time.

    name   the amplitude's name; at 0 the input stays
    input  what it moves
    shape  s(t), 0 at the start
    how    ``plus``: x + a s(t), ``times``: x (1 + a s(t))
    """

    name: str
    input: str
    shape: Course
    how: Literal["plus", "times"] = "plus"

    def __post_init__(self) -> None:
        if self.how not in ("plus", "times"):
            raise InputError(f"how of {self.name}", self.how, "is unknown", "use plus or times")
        if self.shape.points[0][0] <= 0.0 and self.shape.at(0.0) != 0.0:
            raise InputError(
                f"shape of {self.name}", self.shape.points, "does not start from 0", "subtract it"
            )

    def moved(self, x: Array | float, amplitude: Array | float, s: float) -> Array:
        """The input where the shape is s.

        >>> ramp = Course.of([(0.0, 0.0), (100.0, -1.0)])
        >>> Drift("wear", "coating", ramp, "times").moved(1.2, 0.5, ramp.mean(0.0, 100.0))
        array(0.9)
        """
        return np.asarray(x + amplitude * s if self.how == "plus" else x * (1.0 + amplitude * s))

    def to_json(self) -> dict[str, Any]:
        """A plain dictionary, the shape as its points."""
        points = [list(point) for point in self.shape.points]
        return {"name": self.name, "input": self.input, "shape": points, "how": self.how}

    @staticmethod
    def from_json(told: Mapping[str, Any]) -> Drift:
        """The inverse of `to_json`."""
        return Drift(**{**told, "shape": Course.of([(h, v) for h, v in told["shape"]])})
