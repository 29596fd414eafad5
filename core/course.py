"""How an input runs in time: piecewise linear over operating hours, with steps.

A course is given by points (hour, value); between them it is linear, beyond them constant, and two
points at one hour are a step, which counts from that hour on. What follows a course (finite
elements, the surrogate's rule) goes piece by piece and holds the input at its mean on each.

A `Drift` moves an input by an amplitude a along a shape s, x + a s(t) or x (1 + a s(t)): what is
not known of the course is one parameter. A `Bias` does the same to readings, whatever the blade
does. Either may concern some blades only, and run by the rotor's hours instead of the blade's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError

Array = NDArray[np.float64]
How = Literal["plus", "times"]
ITSELF = ""  # a clock that was told already


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
        """The values at both ends of an interval and at the points inside; none is outside these.

        >>> Course.of([(0.0, 0.0), (60.0, 1.2)]).over(0.0, 50.0).tolist()
        [0.0, 1.0]
        """
        inside = [value for hour, value in self.points if start < hour < end]
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


Since = tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True)
class Drift:
    """One input that runs in time.

    name    the amplitude's name; at 0 the input stays
    input   what it moves
    shape   s(t), 0 at the start, or constant
    how     ``plus``: x + a s(t), ``times``: x (1 + a s(t))
    blades  those that it concerns; None: all
    since   (blade, hour of the rotor when the blade's hours were zero): the shape runs by the
            rotor's hours, for a blade that is not named from 0
    """

    name: str
    input: str
    shape: Course
    how: How = "plus"
    blades: tuple[str, ...] | None = None
    since: Since = ()

    def __post_init__(self) -> None:
        _check_how(self.name, self.how)
        starts = self.shape.points[0][0] <= 0.0 and self.shape.at(0.0) != 0.0
        if starts and not self.shape.constant and not self.since:
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

    def of_blade(self, blade: str) -> Drift | None:
        """By this blade's hours; None where it does not concern it."""
        if self.blades is not None and blade not in self.blades:
            return None
        if self.blades is None and not self.since:
            return self
        zero = dict(self.since).get(blade, 0.0)
        return replace(self, shape=self.shape.shifted(zero), blades=None, since=((ITSELF, 0.0),))

    def to_json(self) -> dict[str, Any]:
        """A plain dictionary, the shape as its points; blades and clock only where declared."""
        return {"name": self.name, "input": self.input, **_told(self)}

    @staticmethod
    def from_json(told: Mapping[str, Any]) -> Drift:
        """The inverse of `to_json`."""
        return Drift(**_read(told))


@dataclass(frozen=True, slots=True)
class Bias:
    """What readings have beside what the blade does: y = Y_m + a s(t), or Y_m (1 + a s(t)).

    name        the amplitude's name
    quantity    of the readings; a scalar one or one at a node
    instrument, campaign, blades   whose readings; None: of all
    since       as a drift's
    lasting     true: the blade itself is longer (a tip that rubbed), so predictions have it;
                false: the instrument is wrong
    """

    name: str
    quantity: str
    shape: Course
    how: How = "plus"
    instrument: str | None = None
    campaign: str | None = None
    blades: tuple[str, ...] | None = None
    since: Since = ()
    lasting: bool = False

    def __post_init__(self) -> None:
        _check_how(self.name, self.how)
        if self.lasting and (self.instrument, self.campaign) != (None, None):
            raise InputError(
                f"lasting of {self.name}",
                (self.instrument, self.campaign),
                "cannot be of an instrument or a campaign",
                "what lasts is the blade's",
            )

    def share(self, time_h: float, instrument: str | None, campaign: str | None) -> float:
        """s of a reading of a blade that it concerns; 0 where it is not its.

        >>> one = Bias("offset", "elongation", Course.of(1.0), campaign="c2")
        >>> one.share(10.0, None, "c2"), one.share(10.0, None, "c1")
        (1.0, 0.0)
        """
        for own, given in ((self.instrument, instrument), (self.campaign, campaign)):
            if own is not None and own != given:
                return 0.0
        return float(self.shape.at(time_h))

    def of_blade(self, blade: str) -> Bias | None:
        """By this blade's hours; None where it does not concern it."""
        if self.blades is not None and blade not in self.blades:
            return None
        zero = dict(self.since).get(blade, 0.0)
        return replace(self, shape=self.shape.shifted(zero), blades=None, since=())

    def to_json(self) -> dict[str, Any]:
        """A plain dictionary; options that are not used are left out."""
        told = {"name": self.name, "quantity": self.quantity, **_told(self)}
        for name in ("instrument", "campaign"):
            if getattr(self, name) is not None:
                told[name] = getattr(self, name)
        return told | ({"lasting": True} if self.lasting else {})

    @staticmethod
    def from_json(told: Mapping[str, Any]) -> Bias:
        """The inverse of `to_json`."""
        return Bias(**_read(told))


def _check_how(name: str, how: str) -> None:
    if how not in ("plus", "times"):
        raise InputError(f"how of {name}", how, "is unknown", "use plus or times")


def _told(one: Drift | Bias) -> dict[str, Any]:
    told: dict[str, Any] = {"shape": [list(point) for point in one.shape.points], "how": one.how}
    if one.blades is not None:
        told["blades"] = list(one.blades)
    if one.since:
        told["since"] = dict(one.since)
    return told


def _read(told: Mapping[str, Any]) -> dict[str, Any]:
    given = {**told, "shape": Course.of([(h, v) for h, v in told["shape"]])}
    if given.get("blades") is not None:
        given["blades"] = tuple(given["blades"])
    if "since" in given:
        given["since"] = tuple(sorted((str(b), float(h)) for b, h in given["since"].items()))
    return given
