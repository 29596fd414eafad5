"""Inputs that run in time, and readings that are off, each by an amplitude that is a parameter.

A `Drift` moves an input by an amplitude a along a shape s, x + a s(t) or x (1 + a s(t)): what is
not known of the course is one parameter. A `Bias` does the same to readings, whatever the blade
does. Either may concern some blades only, and run by the rotor's hours instead of the blade's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from core.course import Course
from core.errors import InputError

Array = NDArray[np.float64]
How = Literal["plus", "times"]
ITSELF = ""  # a clock that was told already
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
    held    where the input would leave the simulation's runs it stays at their end
            (`core.surrogate.reach`); else it is refused
    """

    name: str
    input: str
    shape: Course
    how: How = "plus"
    blades: tuple[str, ...] | None = None
    since: Since = ()
    held: bool = field(
        default=False, repr=False
    )  # digests of drifts that are not stay as they were

    def __post_init__(self) -> None:
        _check_how(self.name, self.how)
        if self.shape.at(0.0) != 0.0 and not self.shape.constant and not self.since:
            raise InputError(
                f"shape of {self.name}", self.shape.points, "does not start from 0", "subtract it"
            )

    def moved(self, x: Array | float, amplitude: Array | float, s: Array | float) -> Array:
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
        told = {"name": self.name, "input": self.input, **_told(self)}
        return told | ({"held": True} if self.held else {})

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
    for name, kind, said in (("blades", list | tuple, "list"), ("since", Mapping, "mapping")):
        if given.get(name) is not None and not isinstance(given[name], kind):
            what = f"{name} of {told.get('name')}"
            raise InputError(what, given[name], f"is no {said}", f"give a {said} of blades")
    if given.get("blades") is not None:
        given["blades"] = tuple(given["blades"])
    if "since" in given:
        since = given["since"] or {}
        given["since"] = tuple(sorted((str(b), float(h)) for b, h in since.items()))
    return given
