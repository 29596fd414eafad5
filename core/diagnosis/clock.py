"""What a diagnosis knows of time: hours of the rotor, inspections, and where steps may be.

A blade counts its own operating hours; a replaced blade starts from zero while the rotor goes on.
The rotor's hour of a reading is the blade's plus an offset, which the blade's record says, or its
campaigns (`core.ages`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from core.ages import SAME, offsets, undated
from core.diagnosis.grammar import Facts, Readers, few, parts
from core.observation import Inspection

STEPS = 6  # hours at most at which a step is tried


def with_offsets(
    blades: Mapping[str, Facts], readings: Sequence[Inspection], told: Mapping[str, float]
) -> dict[str, Facts]:
    """The blades with their offsets: those `told` (h), others from the campaigns, else 0.

    >>> a = Inspection("1", "old", "elongation", 9000.0, [0.1], campaign="c")
    >>> b = Inspection("2", "new", "elongation", 1000.0, [0.1], campaign="c")
    >>> found = with_offsets({"old": Facts(), "new": Facts()}, [a, b], {})
    >>> found["old"].offset_h, found["new"].offset_h
    (0.0, 8000.0)
    """
    offset = offsets(readings, told)
    return {name: replace(own, offset_h=offset.get(name, 0.0)) for name, own in blades.items()}


def of_no_day(readings: Sequence[Inspection]) -> tuple[str, ...]:
    """That campaigns are of no single day, in words.

    >>> data = [Inspection(str(h), "b", "y", h, [0.1], campaign="gauge") for h in (1e3, 9e3)]
    >>> of_no_day(data)[0][:48]
    'when campaign gauge was is not known: in it blad'
    """
    if not (names := undated(readings)):
        return ()
    one = len(names) == 1
    return (
        f"when campaign{'' if one else 's'} {few(names)} {'was' if one else 'were'} is not known: "
        f"in {'it' if one else 'them'} blades were read at hours that do not go together, or not "
        "with other campaigns; look at time_h there",
    )


def readers(readings: Sequence[Inspection], blades: Mapping[str, Facts]) -> Readers:
    """Instruments, campaigns and where between inspections a step may be."""
    of: dict[str, list[Inspection]] = {}
    for r in readings:
        of.setdefault(r.quantity, []).append(r)
    return Readers(
        {quantity: parts(r.instrument for r in own) for quantity, own in of.items()},
        {quantity: parts(r.campaign for r in own) for quantity, own in of.items()},
        _between({r.time_h + blades[r.blade].offset_h for r in readings}),
        _between({r.time_h for r in readings}),
    )


def _between(at: Iterable[float]) -> tuple[float, ...]:
    """One hour in each interval between inspections, `STEPS` at most; before one at hour 0 is none.

    >>> _between([0.0, 8000.0, 8100.0]), _between([8000.0])
    ((4000.0,), (4000.0,))
    """
    hours = sorted(at)
    apart = SAME * hours[-1] if hours else 0.0
    visits: list[float] = []
    for hour in hours:
        if not visits or hour - visits[-1] > apart:
            visits.append(hour)
    between = [0.5 * (a + b) for a, b in zip([0.0, *visits], visits, strict=False) if b > a]
    if len(between) > STEPS:
        share = (len(between) - 1) / (STEPS - 1)
        between = [between[round(k * share)] for k in range(STEPS)]
    return tuple(between)
