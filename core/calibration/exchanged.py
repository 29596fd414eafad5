"""Two blades' readings of one visit, the other way round: the evidence that they were exchanged.

A blade's own parameters make up for a wrong reading of its own size, so that two blades whose
readings were exchanged (B07 read as B12, B12 as B07) are within the noise, and both forecasts are
wrong. That each has just what the other lacks is no chance. With the readings of visit v of blades
a and b exchanged, the rotor's evidence over what it is as delivered is

    log BF = log Σ_k w_k exp(log m'_a(s_k) + log m'_b(s_k) − log m_a(s_k) − log m_b(s_k)),

m' the messages of the exchanged readings and w_k the nodes' weights. If nothing was exchanged the
mean of BF over data is one, whichever pair; so of N pairs of a visit one of
log BF ≥ log(N ODDS / VISIT) is met with a probability of VISIT / ODDS at most (Markov), whatever
the rotor; 1 / (1 + 1/ODDS) is the least probability of an exchange that is told, where one visit in
1/VISIT has one.
That holds where the model does: an effect that it lacks, as the zero of an instrument some noises
off, can look like an exchange, and so can one misread value. Where the visits of the blades that
look exchanged nowhere scatter s times as much as their noise says (`noisier`), log BF counts 1/s²
of what it is; where exchanges explain all that is improbable, nothing improbable is left there.

Which of the thousands of pairs are weighed is told by a look at all of them (`cavity`): a reading
foreseen by the others of blade a, held against that of b, both near the rotor's best node. Blades
that are accused (`health`) are weighed with each other in any case. Of pairs that share a blade the
likeliest is told, and as its rivals those whose evidence is not `RIVAL` times less. Two blades that
were read at no other visit are each other's: nothing tells them apart.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.calibration.cavity import Seen, Visit, seen_of, visits_of
from core.calibration.message import BladeMessage
from core.calibration.noisier import Looks, Scatter, kind
from core.calibration.weighed import Weighed, said
from core.observation import Inspection
from core.smc.particles import log_sum_exp

Array = NDArray[np.float64]
VISIT = 0.01  # probability that a visit has an exchange
ODDS = 9.0  # of an exchange that is told
RIVAL = 20.0  # times less likely than the one that is told, and not told any more
ROUGH = 6.0  # nats that a look may be off
PLACES = 64  # of each shared parameter's range: what a look is at is rounded to them
KEPT = 2000  # looks
MOST = 24  # pairs of all visits that are weighed
Pair = tuple[str, str]
Kept = OrderedDict[tuple[str, bytes], dict[Visit, Seen]]
Messages = Callable[[Mapping[str, Sequence[Inspection]]], Mapping[str, BladeMessage]]


@dataclass(frozen=True, slots=True)
class Exchange:
    """A pair of blades at a visit, and by how much the evidence is for their exchange [nat]."""

    gain: float
    visit: Visit
    pair: Pair

    def order(self) -> tuple[float, Visit, Pair]:
        return -self.gain, self.visit, self.pair


def least_gain(pairs: int) -> float:
    """log BF from which on one of so many pairs is told.

    >>> round(least_gain(190), 2), round(least_gain(4950), 2)
    (12.05, 15.31)
    """
    return math.log(pairs * ODDS / VISIT)


def looks(messages: Mapping[str, BladeMessage], made: Weighed, kept: Kept) -> Looks:
    """What all other readings of each blade foresee of each of its visits (`cavity`).

    kept  looks of before: they are at places that few nodes move (`PLACES`)
    """
    at = np.round(made.unit[[int(np.argmax(made.log_p))]] * PLACES) / PLACES
    found = {}
    for blade in sorted(messages):
        key = (messages[blade].name, at.tobytes())
        if key not in kept:
            kept[key] = seen_of(messages[blade], at)
            while len(kept) > KEPT:
                kept.popitem(last=False)
        kept.move_to_end(key)
        found[blade] = kept[key]
    return found


def exchanged(
    messages: Mapping[str, BladeMessage],
    made: Weighed,
    accused: Collection[str],
    messages_of: Messages,
    looked: Looks,
    scatter: Scatter,
) -> list[dict[str, Any]]:
    """Pairs of blades whose readings of a visit look exchanged, the clearest first.

    messages_of  the messages of blades with these readings
    looked       at each blade's visits (`looks`)
    scatter      how far they are off
    """
    visits: dict[Visit, dict[str, Seen]] = {}
    for blade, own in looked.items():
        for visit, seen in own.items():
            visits.setdefault(visit, {})[blade] = seen
    worth: list[Exchange] = []
    counts: dict[Visit, int] = {}
    for visit, seen_there in visits.items():
        counts[visit], found = _looked(visit, seen_there, accused)
        worth += found
    worth.sort(key=Exchange.order)
    weighed = [_weighed(one, messages, made, messages_of) for one in worth[:MOST]]
    clear = []
    left = sorted(weighed, key=Exchange.order)
    while left:
        first = left.pop(0)
        if not first.gain >= least_gain(counts[first.visit]):
            continue
        rivals = [one for one in left if {*one.pair} & {*first.pair}]
        left = [one for one in left if one not in rivals]
        clear.append((first, [o for o in rivals if o.gain >= first.gain - math.log(RIVAL)]))
    paired = {blade for first, _ in clear for blade in first.pair}
    told = []
    for first, near in clear:
        there, count = visits[first.visit], counts[first.visit]
        others = paired if looked.keys() - paired else first.pair
        gain = first.gain / scatter.variance({kind(there[b]) for b in first.pair}, others)
        if not gain >= least_gain(count):
            continue
        odds = gain - math.log(count / VISIT)
        told.append(
            _named(first, visits)
            | {
                "readings": [[r.id for r in there[b].readings] for b in first.pair],
                "gained_nat": round(gain, 1),
                "probability": round(1.0 / (1.0 + math.exp(-odds)), 6),
                "rivals": [_named(rival, visits) for rival in near],
            }
        )
    return told


def _looked(
    visit: Visit, seen: Mapping[str, Seen], accused: Collection[str]
) -> tuple[int, list[Exchange]]:
    """How many pairs of a visit can be exchanged, and those that are worth weighing, by what a look
    at them says [nat]."""
    groups: dict[tuple[object, ...], list[str]] = {}
    for blade, one in seen.items():
        groups.setdefault((one.alike, len(one.value)), []).append(blade)
    count, found = 0, []
    for blades in groups.values():
        values = np.array([seen[b].value for b in blades])
        says = np.array([seen[b].log_density(values) for b in blades])
        own = np.diag(says)
        gain = says + says.T - own[:, None] - own
        others = np.array([seen[b].others for b in blades])
        bad = np.array([b in accused for b in blades])
        gain[bad[:, None] & bad] = np.inf
        gain[~(others[:, None] | others)] = -np.inf
        gain[np.tril_indices(len(blades))] = -np.inf
        count += int(np.sum(gain > -np.inf))
        found += [(gain[i, j], blades[i], blades[j]) for i, j in np.argwhere(gain > 0.0)]
    least = least_gain(max(count, 1)) - ROUGH
    return count, [Exchange(float(g), visit, (a, b)) for g, a, b in found if g >= least]


def _weighed(
    one: Exchange,
    messages: Mapping[str, BladeMessage],
    made: Weighed,
    messages_of: Messages,
) -> Exchange:
    """With its evidence by the messages themselves."""
    a, b = one.pair
    turned = messages_of(other_way_round(messages[a], messages[b], one.visit))
    moved = np.zeros(len(made.unit))
    for blade, message in turned.items():
        moved += message.column(made.unit) - said(blade, made.columns[blade], made.floors)
    log_w = made.log_w
    return replace(one, gain=log_sum_exp(log_w + moved) - log_sum_exp(log_w))


def other_way_round(
    one: BladeMessage, two: BladeMessage, visit: Visit
) -> dict[str, list[Inspection]]:
    """The readings of two blades; those of a visit say what the other's do: value, noise, and the
    instrument."""
    of = {m.rows.readings[0].blade: list(m.rows.readings) for m in (one, two)}
    (a, mine), (b, theirs) = of.items()
    places = zip(*(visits_of(own)[visit] for own in (mine, theirs)), strict=True)
    for i, j in places:
        first, second = mine[i], theirs[j]
        mine[i], theirs[j] = _saying(first, second), _saying(second, first)
    return {a: mine, b: theirs}


def _saying(reading: Inspection, other: Inspection) -> Inspection:
    return replace(reading, values=other.values, sigma=other.sigma, instrument=other.instrument)


def _named(one: Exchange, visits: Mapping[Visit, Mapping[str, Seen]]) -> dict[str, Any]:
    """Which blades, and when."""
    hours = [visits[one.visit][blade].readings[0].time_h for blade in one.pair]
    return {"blades": [*one.pair], "campaign": one.visit[0] or None, "time_h": hours}


def in_words(one: Mapping[str, Any]) -> str:
    """What a state says of an exchange.

    >>> other = {"blades": ["B07", "B03"], "campaign": None, "time_h": [16000.0, 15500.0]}
    >>> one = {"blades": ["B07", "B12"], "campaign": "C2", "time_h": [16000.0, 16000.0],
    ...     "readings": [["r4"], ["r9"]], "gained_nat": 27.8, "rivals": [other]}
    >>> for part in in_words(one).split(": "):
    ...     print(part)
    readings of blades B07 and B12 in campaign C2 (16,000 h) look exchanged, or one of them is wrong
    the other way round they are likelier by 27.8 nat (or B07 and B03 at 16,000 and 15,500 h); look at r4, r9
    """  # noqa: E501
    rivals = ", ".join(map(_when, one["rivals"]))
    instead = f" (or {rivals})" if rivals else ""
    ids = ", ".join(name for own in one["readings"] for name in own[:3])
    return (
        f"readings of blades {_when(one)} look exchanged, or one of them is wrong: the other way "
        f"round they are likelier by {one['gained_nat']:g} nat{instead}; look at {ids}"
    )


def _when(one: Mapping[str, Any]) -> str:
    hours = " and ".join(dict.fromkeys(f"{hour:,.0f}" for hour in one["time_h"]))
    campaign = one["campaign"]
    when = f"at {hours} h" if campaign is None else f"in campaign {campaign} ({hours} h)"
    return f"{' and '.join(one['blades'])} {when}"
