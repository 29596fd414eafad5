"""Which hour of the rotor a reading was taken at.

A blade counts its own operating hours; a replaced blade starts from zero while the rotor goes on.
The rotor's hour of a reading is the blade's plus an offset: the rotor's hours when the blade's
were zero. Where the blade's record does not say, campaigns tell: all readings of one campaign were
taken at one hour of the rotor, which is that of its oldest blade or later. So a blade's offset is
the largest that its campaigns ask for; and as blades without a campaign in common are linked by
others, the campaigns' hours are asked again with the offsets that were found, until none changes.

A name is of no single day, and says nothing (`undated`), under which one blade was read at hours
that are far apart, or blades whose ages differ by something else than in other campaigns: of two
campaigns that contradict each other so the one that more others contradict, or that has fewer
blades; both, where nothing tells which.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from core.diagnosis.grammar import Facts, Readers, few, parts
from core.observation import Inspection

STEPS = 6  # hours at most at which a step is tried
SAME = 0.02  # share of the longest history within which readings are one inspection


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
    dated = _dated(readings)
    apart = _apart(readings)
    offset: Mapping[str, float] = told
    for _ in range(len({day for day, _ in dated}) + 1):
        hour: dict[str, float] = {}
        for (day, blade), own in dated.items():
            hour[day] = max(hour.get(day, 0.0), own + offset.get(blade, 0.0))
        behind: dict[str, float] = {}
        for (day, blade), own in dated.items():
            behind[blade] = max(behind.get(blade, 0.0), hour[day] - own)
        before, offset = offset, {**behind, **told}
        left = [hour[day] - own - offset[blade] for (day, blade), own in dated.items()]
        if offset == before or max(map(abs, left), default=0.0) <= apart:
            break
    return {name: replace(own, offset_h=offset.get(name, 0.0)) for name, own in blades.items()}


def undated(readings: Sequence[Inspection]) -> tuple[str, ...]:
    """Campaigns that are of no single day."""
    days = {r.campaign for r in readings if r.campaign is not None}
    return tuple(sorted(days - {day for day, _ in _dated(readings)}))


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


def _apart(readings: Sequence[Inspection]) -> float:
    """Hours that are one inspection."""
    return SAME * max((r.time_h for r in readings), default=0.0)


def _dated(readings: Sequence[Inspection]) -> dict[tuple[str, str], float]:
    """By campaign and blade, the hour of the blade then; only of campaigns of one day."""
    apart = _apart(readings)
    ends: dict[tuple[str, str], tuple[float, float]] = {}
    for r in readings:
        if r.campaign is not None:
            low, high = ends.get((r.campaign, r.blade), (r.time_h, r.time_h))
            ends[r.campaign, r.blade] = (min(low, r.time_h), max(high, r.time_h))
    long = {day for (day, _), (low, high) in ends.items() if high - low > apart}
    found = {key: high for key, (_, high) in ends.items() if key[0] not in long}
    odd = _odd(found, apart)
    return {key: hour for key, hour in found.items() if key[0] not in odd}


def _odd(dated: Mapping[tuple[str, str], float], apart: float) -> set[str]:
    """Campaigns to leave out so that in any two of the rest the blades of both are as far apart."""
    days, blades = (sorted({key[k] for key in dated}) for k in (0, 1))
    at = np.full((len(days), len(blades)), np.nan)
    for (day, blade), hour in dated.items():
        at[days.index(day), blades.index(blade)] = hour
    contradict = np.array([_spread(at - row) > apart for row in at]).reshape(len(days), len(days))
    count, out = np.isfinite(at).sum(axis=1), set[int]()
    while contradict.any():
        others = contradict.sum(axis=1)
        worst = np.flatnonzero(others == others.max())
        worst = worst[count[worst] == count[worst].min()]
        contradict[worst] = contradict[:, worst] = False
        out |= {int(k) for k in worst}
    return {days[k] for k in out}


def _spread(later: NDArray[np.float64]) -> NDArray[np.float64]:
    """By how much more some blades aged than others between two days, (D,); rows (D, B)."""
    known = np.isfinite(later)
    high, low = (np.where(known, later, end) for end in (-np.inf, np.inf))
    return np.where(known.any(axis=1), high.max(axis=1) - low.min(axis=1), 0.0)


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
