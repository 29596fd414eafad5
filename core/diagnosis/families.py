"""The built-in families of effects: physical names, each with a sentence and a size.

They are data (`core.family`): a network may bring its own, which stand in place of those here that
concern the same input or reading.
"""

from __future__ import annotations

from collections.abc import Sequence

from core.family import Family, Shape
from core.network import Network

GROWING: tuple[Shape, ...] = ("early", "linear", "late")
FAMILIES = (
    Family(
        "coating wear",
        "the thermal barrier coating loses thickness while the blade runs",
        "input", "tbc_thickness", "times", 0.25, -1, GROWING,
        ("all", "coating_lot"), "blade", "physics", "coating loss",
    ),
    Family(
        "coating spallation",
        "part of the coating is lost at once",
        "input", "tbc_thickness", "times", 0.25, -1, ("step",),
        ("blade", "coating_lot"), "blade", "physics", "coating loss",
    ),
    Family(
        "fouling",
        "the gas gets hotter, or cooler, while the machine runs",
        "input", "t1t_rate", "plus", 0.04, 0, GROWING,
        ("all",), "rotor", "operation", "gas temperature",
    ),
    Family(
        "firing temperature step",
        "the gas temperature was changed on a day",
        "input", "t1t_rate", "plus", 0.02, 0, ("step",),
        ("all",), "rotor", "operation", "gas temperature",
    ),
    Family(
        "cooling flow",
        "coolant flow is not what was declared",
        "input", "cooling_flow", "plus", 0.05, 0, ("constant",),
        ("blade", "lot"), "blade", "physics", "coolant",
    ),
    Family(
        "cooling blockage",
        "cooling passages clog at once",
        "input", "cooling_flow", "plus", 0.05, -1, ("step",),
        ("blade", "lot"), "blade", "physics", "coolant",
    ),
    Family(
        "cooling decline",
        "cooling passages clog while the blades run",
        "input", "cooling_flow", "plus", 0.08, -1, GROWING,
        ("all", "lot"), "blade", "physics", "coolant",
    ),
    Family(
        "accelerating creep",
        "creep grows with its damage (tertiary creep)",
        "input", "tertiary", "plus", 1.5, 1, ("constant",), ("all", "lot"), "blade", "material",
    ),
    Family(
        "gas profile shift",
        "the gas is hottest at another height of the blade",
        "input", "gas_profile_peak", "plus", 0.04, 0, ("constant", "step"), ("all",), "rotor",
        "operation",
    ),
    Family(
        "wall loss",
        "the wall is thinner than declared",
        "input", "wall_loss", "plus", 0.04, 1, ("constant",), ("all", "lot"), "blade", "physics",
    ),
    Family(
        "creep strength of a lot",
        "a casting lot creeps faster or slower than the others",
        "input", "creep_steady", "plus", 1.0, 0, ("constant",), ("lot",), "blade", "material",
    ),
    Family(
        "root settling",
        "every reading of a blade is longer by the same length, from the first one on: the root "
        "moved outward in its slot",
        "reading", "elongation", "plus", None, 1, ("constant",), ("all", "blade"), "blade",
        "physics",
    ),
    Family(
        "tip rub",
        "length is lost at the tip at once, by all blades that were there",
        "reading", "elongation", "plus", None, -1, ("step",), ("all", "blade"), "event", "physics",
    ),
    Family(
        "instrument offset",
        "an instrument reads too much or too little, always by the same",
        "reading", "elongation", "plus", None, 0, ("constant",), ("instrument",), "rotor",
        "sensor", "wrong zero",
    ),
    Family(
        "instrument gain",
        "an instrument reads too much or too little, in proportion",
        "reading", "elongation", "times", 0.1, 0, ("constant",), ("instrument",), "rotor",
        "sensor",
    ),
    Family(
        "instrument drift",
        "an instrument's offset grows in time",
        "reading", "elongation", "plus", None, 0, ("linear",), ("instrument",), "rotor", "sensor",
        "wrong zero",
    ),
    Family(
        "campaign offset",
        "an instrument was set to zero anew for one campaign",
        "reading", "elongation", "plus", None, 0, ("constant",), ("campaign",), "rotor", "sensor",
    ),
)  # fmt: skip


def families_for(network: Network, more: Sequence[Family] = ()) -> tuple[Family, ...]:
    """What is looked for in a rotor: built-in families, the network's own, and `more`.

    A built-in family that concerns the same input or quantity as one of the network's own gives way
    to it: the network knows its physics better.
    """
    own = {(f.target, f.of) for f in network.families}
    return (*(f for f in FAMILIES if (f.target, f.of) not in own), *network.families, *more)
