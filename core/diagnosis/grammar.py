"""What a model may lack, as a grammar: target × shape in time × whom × which clock.

    target   an input of the simulation, calibrated or dormant (a coating that wears: its creep
             follows), or a reading (a scanner with an offset)
    shape    constant | early | linear | late | step at an unknown hour
    whom     all blades | one lot | one coating lot | one blade | one instrument | one campaign
    clock    the blade's own hours, or the rotor's: what happens to the machine happens to old and
             new blades on one day; an event happens to those that are there on that day

A `Family` is a physical effect with a name and a sentence; it spans several cells of the grammar,
for how wear runs in time is not what it is called. `cells` lists those that a rotor's readings
could tell of: no lot where none was given, no instrument where there is one only. Families are
data (`core.family`): a network may bring its own, which stand in place of those here that concern
the same input or reading.

The size of an effect is the standard deviation that is expected of it a priori if it is there;
`sign` says in which direction physics lets it go.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from core.course import Course
from core.family import Family, Shape, Whom
from core.network import Network

REFERENCE_H = 50_000.0  # what grows has its size by then


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


@dataclass(frozen=True, slots=True)
class Cell:
    """One effect that could be there.

    value    of whom: the lot's, blade's, instrument's or campaign's name; None: all
    step_h   hour of a step
    """

    family: Family
    shape: Shape
    whom: Whom
    value: str | None = None
    step_h: float | None = None

    @property
    def name(self) -> str:
        """What it is called: family and whom, however it runs in time.

        >>> Cell(FAMILIES[0], "linear", "coating_lot", "C2").name
        'coating wear (coating lot C2)'
        """
        return self._of(self.family.name)

    @property
    def cause(self) -> str:
        """What it is called whatever its course: that of all families of its cause.

        >>> Cell(FAMILIES[0], "linear", "coating_lot", "C2").cause
        'coating loss (coating lot C2)'
        """
        return self._of(self.family.cause or self.family.name)

    def _of(self, what: str) -> str:
        who = {"all": "", "coating_lot": "coating lot "}.get(self.whom, f"{self.whom} ")
        return what if self.value is None else f"{what} ({who}{self.value})"

    @property
    def course(self) -> Course:
        """Its shape s(t) over the clock's hours, of the order of 1."""
        if self.shape == "constant":
            return Course.of([(-1e9, 0.0), (-1e9, 1.0)])
        if self.shape == "step":
            hour = self.step_h or 0.0
            return Course.of([(hour, 0.0), (hour, 1.0)])
        share = [k / 10 for k in range(11)]
        power = {"early": 0.5, "linear": 1.0, "late": 2.0}[self.shape]
        ends = [(REFERENCE_H * s, s**power) for s in share]
        slope = power / REFERENCE_H
        return Course.of([*ends, (4 * REFERENCE_H, 1.0 + 3 * REFERENCE_H * slope)])


@dataclass(frozen=True, slots=True)
class Facts:
    """What a blade is besides its readings.

    offset_h  the rotor's hours when this blade's were zero
    """

    lot: str | None = None
    coating_lot: str | None = None
    offset_h: float = 0.0


def there(cell: Cell, own: Facts) -> bool:
    """Whether a blade was on the rotor when a cell's step happened.

    >>> rub = next(f for f in FAMILIES if f.name == "tip rub")
    >>> [there(Cell(rub, "step", "all", None, 1e4), Facts(offset_h=h)) for h in (0.0, 2e4)]
    [True, False]
    """
    return cell.step_h is None or own.offset_h < cell.step_h


@dataclass(frozen=True, slots=True)
class Readers:
    """Instruments and campaigns of a rotor's readings, and hours between its inspections.

    between_h  of the rotor's hours, one for each interval between inspections: where a step may be
    """

    instruments: tuple[str, ...]
    campaigns: tuple[str, ...]
    between_h: tuple[float, ...]


def cells(
    families: Iterable[Family],
    inputs: Sequence[str],
    quantities: Sequence[str],
    blades: Mapping[str, Facts],
    readers: Readers,
) -> list[Cell]:
    """The cells that these readings could tell of.

    inputs  that the simulation has; a family of another input is left out
    """
    lots = sorted({f.lot for f in blades.values() if f.lot is not None})
    coats = sorted({f.coating_lot for f in blades.values() if f.coating_lot is not None})
    values: dict[str, Sequence[str | None]] = {
        "all": [None],
        "lot": lots if len(lots) > 1 else [],
        "coating_lot": coats if len(coats) > 1 else [],
        "blade": sorted(blades) if len(blades) > 1 else [],
        "instrument": readers.instruments if len(readers.instruments) > 1 else [],
        "campaign": readers.campaigns if len(readers.campaigns) > 1 else [],
    }
    found = []
    for family in families:
        if family.of not in (inputs if family.target == "input" else quantities):
            continue
        for whom in family.whom:
            for shape in family.shapes:
                steps = readers.between_h if shape == "step" else (None,)
                found += [
                    Cell(family, shape, whom, value, hour)
                    for value in values[whom]
                    for hour in steps
                ]
    return found
