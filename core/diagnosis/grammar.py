"""What a model may lack, as a grammar: target × shape in time × whom × which clock.

    target   an input of the simulation, calibrated or dormant (a coating that wears: its creep
             follows), or a reading (a scanner with an offset)
    shape    constant | early | linear | late | step at an unknown hour
    whom     all blades | one lot | one coating lot | one blade | one instrument | one campaign
    clock    the blade's own hours, or the rotor's: what happens to the machine happens to old and
             new blades on one day; an event happens to those that are there on that day

A `Family` is a physical effect with a name and a sentence; it spans several cells of the grammar,
for how wear runs in time is not what it is called. `cells` lists those that a rotor's readings
could tell of: no lot where none was given, no instrument where there is one only.

The size of an effect is the standard deviation that is expected of it a priori if it is there;
`sign` says in which direction physics lets it go.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from core.course import Course
from core.family import Family, Shape, Whom

REFERENCE_H = 50_000.0  # what grows has its size by then, or by the model's horizon
UNTIL = 1.2  # of it: nothing is known of wear beyond


@dataclass(frozen=True, slots=True)
class Cell:
    """One effect that could be there.

    value    of whom: the lot's, blade's, instrument's or campaign's name; None: all
    step_h   hour of a step
    reference_h  by when what grows has its size
    """

    family: Family
    shape: Shape
    whom: Whom
    value: str | None = None
    step_h: float | None = None
    reference_h: float = REFERENCE_H

    @property
    def name(self) -> str:
        """What it is called: family and whom, however it runs in time.

        >>> from core.diagnosis.families import FAMILIES
        >>> Cell(FAMILIES[0], "linear", "coating_lot", "C2").name
        'coating wear (coating lot C2)'
        """
        return self._of(self.family.name)

    @property
    def cause(self) -> str:
        """What it is called whatever its course: that of all families of its cause.

        >>> from core.diagnosis.families import FAMILIES
        >>> Cell(FAMILIES[0], "linear", "coating_lot", "C2").cause
        'coating loss (coating lot C2)'
        """
        return self._of(self.family.cause or self.family.name)

    def _of(self, what: str) -> str:
        who = {"all": "", "coating_lot": "coating lot "}.get(self.whom, f"{self.whom} ")
        return what if self.value is None else f"{what} ({who}{self.value})"

    @property
    def course(self) -> Course:
        """Its shape s(t) over the clock's hours, of the order of 1; constant beyond `UNTIL`."""
        if self.shape == "constant":
            return Course.of([(-1e9, 0.0), (-1e9, 1.0)])
        if self.shape == "step":
            hour = self.step_h or 0.0
            return Course.of([(hour, 0.0), (hour, 1.0)])
        share = [k / 10 for k in range(11)]
        power = {"early": 0.5, "linear": 1.0, "late": 2.0}[self.shape]
        ends = [(self.reference_h * s, s**power) for s in share]
        return Course.of([*ends, (UNTIL * self.reference_h, 1.0 + (UNTIL - 1.0) * power)])


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

    >>> from core.diagnosis.families import FAMILIES
    >>> rub = next(f for f in FAMILIES if f.name == "tip rub")
    >>> [there(Cell(rub, "step", "all", None, 1e4), Facts(offset_h=h)) for h in (0.0, 2e4)]
    [True, False]
    """
    return cell.step_h is None or own.offset_h < cell.step_h


@dataclass(frozen=True, slots=True)
class Readers:
    """Instruments and campaigns of a rotor's readings (`parts`), and hours between its inspections.

    instruments, campaigns  by quantity: who read it, not who read something else
    between_h  of the rotor's hours, one for each interval between inspections: where a step may be
    ages_h     the same of the blades' own hours
    """

    instruments: Mapping[str, tuple[str, ...]]
    campaigns: Mapping[str, tuple[str, ...]]
    between_h: tuple[float, ...]
    ages_h: tuple[float, ...]


def few(names: Sequence[str], most: int = 5) -> str:
    """The first of some names, and how many more there are.

    >>> few(["a", "b"]), few(["a", "b", "c", "d"], 2)
    ('a, b', 'a, b and 2 more')
    """
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def parts(names: Iterable[str | None]) -> tuple[str, ...]:
    """The names, sorted; none where they tell nothing apart. What has no name is a part, too.

    >>> parts(["b", "a", "a"]), parts(["a", "a"]), parts(["a", None])
    (('a', 'b'), (), ('a',))
    """
    found = set(names)
    return tuple(sorted(n for n in found if n is not None)) if len(found) > 1 else ()


def cells(
    families: Iterable[Family],
    inputs: Sequence[str],
    quantities: Sequence[str],
    blades: Mapping[str, Facts],
    readers: Readers,
    horizon_h: float = REFERENCE_H,
) -> list[Cell]:
    """The cells that these readings could tell of.

    inputs     that the simulation has; a family of another input is left out
    horizon_h  of the model: what grows is as large as expected by then, or by `REFERENCE_H`
    """
    reference = min(REFERENCE_H, horizon_h)
    lots = parts(f.lot for f in blades.values())
    coats = parts(f.coating_lot for f in blades.values())
    values: dict[str, Sequence[str | None]] = {
        "all": [None],
        "lot": lots,
        "coating_lot": coats,
        "blade": sorted(blades) if len(blades) > 1 else [],
    }
    found = []
    for family in families:
        where = readers.ages_h if family.clock == "blade" else readers.between_h
        if family.of not in (inputs if family.target == "input" else quantities):
            continue
        who = {
            "instrument": readers.instruments.get(family.of, ()),
            "campaign": readers.campaigns.get(family.of, ()),
        }
        for whom in family.whom:
            for shape in family.shapes:
                steps = where if shape == "step" else (None,)
                found += [
                    Cell(family, shape, whom, value, hour, reference)
                    for value in (values | who)[whom]
                    for hour in steps
                ]
    return found
