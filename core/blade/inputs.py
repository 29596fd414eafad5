"""What a blade run is given: the four inputs that are calibrated, and those that sleep.

The network calibrates coating, gas temperature and the two creep deviates (`BOUNDS`). A *dormant*
input stays at its nominal value, the declared blade, until an effect is suspected that acts
through it: a starved cooling passage, creep that accelerates with damage, gas that has moved along
the span, a wall that oxidation has thinned. The simulation archive holds them, so that such an
effect goes through the model and is no curve added to its output. What they change of the
declared blade (`core.blade.properties`) is assumed and plausible, like the blade itself.

    cooling_flow       coolant film h_c · flow^0.8                (Dittus and Boelter 1930)
    tertiary           c of r_s (1 + c D)
    gas_profile_peak   span fraction where the gas is hottest
    wall_loss          wall thickness · (1 − loss)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from core.blade.properties import Properties
from core.errors import InputError, RangeError

BOUNDS: dict[str, tuple[float, float]] = {
    "tbc_thickness": (2 / 3, 4 / 3),
    "t1t_rate": (0.8, 1.0),
    "creep_transient": (-3.0, 3.0),
    "creep_steady": (-3.0, 3.0),
}
"""Inputs in their order, with the box that the model covers."""


@dataclass(frozen=True, slots=True)
class Dormant:
    """A dormant input: its box, its nominal value, and what it makes of the declared blade."""

    low: float
    high: float
    nominal: float
    changed: Callable[[Properties, float], Properties]


def _cooling(p: Properties, flow: float) -> Properties:
    film = p.service.coolant_film * flow**0.8
    return replace(p, service=replace(p.service, coolant_film=film))


def _tertiary(p: Properties, acceleration: float) -> Properties:
    return replace(p, creep=replace(p.creep, damage_acceleration=acceleration))


def _profile(p: Properties, peak: float) -> Properties:
    return replace(p, service=replace(p.service, profile_peak=peak))


def _wall(p: Properties, loss: float) -> Properties:
    g, left = p.geometry, 1.0 - loss
    thinner = replace(g, wall_root=g.wall_root * left, wall_tip=g.wall_tip * left)
    return replace(p, geometry=thinner)


DORMANT: dict[str, Dormant] = {
    "cooling_flow": Dormant(0.85, 1.10, 1.0, _cooling),
    "tertiary": Dormant(0.0, 4.0, 0.0, _tertiary),
    "gas_profile_peak": Dormant(0.52, 0.72, Properties().service.profile_peak, _profile),
    "wall_loss": Dormant(0.0, 0.10, 0.0, _wall),
}
"""Dormant inputs in their order; a run that does not name one has the declared blade's."""

IN_TIME = (*BOUNDS, "cooling_flow", "gas_profile_peak")
"""Inputs that may change while the blade runs: what sets its temperature, and the creep law's."""


def declared(properties: Properties, inputs: Mapping[str, float]) -> Properties:
    """The blade with the dormant inputs that are given.

    >>> declared(Properties(), {"tertiary": 0.5}).creep.damage_acceleration
    0.5
    """
    for name, dormant in DORMANT.items():
        if name in inputs:
            properties = dormant.changed(properties, inputs[name])
    return properties


def check_inputs(
    inputs: Mapping[str, float], bounds: Mapping[str, tuple[float, float]] | None = None
) -> dict[str, float]:
    """The four inputs in their order, then the dormant ones that are given; or an error that says
    which one and why.

    bounds   boxes in place of those declared here, by name

    >>> check_inputs({"creep_steady": 1, "tbc_thickness": 1, "t1t_rate": 0.9, "creep_transient": 0})
    {'tbc_thickness': 1.0, 't1t_rate': 0.9, 'creep_transient': 0.0, 'creep_steady': 1.0}
    """
    boxes = BOUNDS | {name: (one.low, one.high) for name, one in DORMANT.items()}
    boxes |= bounds or {}
    known = (*BOUNDS, *DORMANT)
    for name in inputs:
        if name not in known:
            raise InputError(
                name, inputs[name], "is not an input of the blade", f"give {', '.join(known)}"
            )
    checked = {}
    for name in known:
        if name not in inputs:
            if name in DORMANT:
                continue
            raise InputError(name, None, "is missing", f"give all of {', '.join(BOUNDS)}")
        checked[name] = _inside(name, inputs[name], boxes[name])
    return checked


def _inside(name: str, given: float, box: tuple[float, float]) -> float:
    try:
        value = float(given)
    except (TypeError, ValueError):
        raise InputError(name, given, "is not a number", "give a number") from None
    low, high = box
    slack = 1e-12 * max(abs(low), abs(high))
    if not math.isfinite(value):
        raise RangeError(name, value, "is not finite", f"give {low:.4g} … {high:.4g}")
    if not low - slack <= value <= high + slack:
        raise RangeError(name, value, f"lies outside {low:.4g} … {high:.4g}", "give a value inside")
    return value
