"""How old the blades of a rotor are, and which hour of the rotor a reading was taken at.

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

So campaigns tell how old each blade is now (`ages`), the rotor's hour being that of its newest
reading. A blade of no campaign is as old as at its own last reading, or older; one that was never
read counts as one that began with the rotor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from core.observation import Inspection

SAME = 0.02  # share of the longest history within which readings are one inspection


@dataclass(frozen=True, slots=True)
class Age:
    """A blade's operating hours now, and what tells them."""

    hours: float
    by: Literal["campaign", "reading", "rotor"]


def ages(blades: Sequence[str], readings: Sequence[Inspection]) -> dict[str, Age]:
    """How old these blades are at the hour of the rotor's newest reading.

    readings  those that count, of blades that have left among them; none: every blade is new

    >>> a = Inspection("1", "old", "elongation", 9000.0, [0.1], campaign="c")
    >>> b = Inspection("2", "new", "elongation", 1000.0, [0.1], campaign="c")
    >>> c = Inspection("3", "old", "elongation", 17000.0, [0.2], campaign="d")
    >>> d = Inspection("4", "odd", "elongation", 6000.0, [0.1])
    >>> [age.hours for age in ages(["old", "new", "odd", "unread"], [a, b, c, d]).values()]
    [17000.0, 9000.0, 6000.0, 17000.0]
    """
    behind, own = offsets(readings, {}), dict[str, float]()
    dated = {blade for _, blade in _dated(readings)}
    for r in readings:
        own[r.blade] = max(own.get(r.blade, 0.0), r.time_h)
    now = max((hour + behind.get(blade, 0.0) for blade, hour in own.items()), default=0.0)
    found = {}
    for blade in blades:
        if blade in dated:
            found[blade] = Age(now - behind[blade], "campaign")
        elif blade in own:
            found[blade] = Age(own[blade], "reading")
        else:
            found[blade] = Age(now, "rotor")
    return found


def offsets(readings: Sequence[Inspection], told: Mapping[str, float]) -> dict[str, float]:
    """By blade the rotor's hours when the blade's were zero: those `told` (h), else by campaigns.

    A blade of no campaign has none here.
    """
    dated = _dated(readings)
    apart = _apart(readings)
    offset = dict(told)
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
    return offset


def undated(readings: Sequence[Inspection]) -> tuple[str, ...]:
    """Campaigns that are of no single day."""
    days = {r.campaign for r in readings if r.campaign is not None}
    return tuple(sorted(days - {day for day, _ in _dated(readings)}))


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
