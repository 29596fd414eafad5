"""No blade whose readings cannot be the model's may carry the rotor away.

A normal likelihood has no bound: one reading that was mistyped by half a millimetre, among six
hundred, moved the gas temperature of a hundred blades by eleven of its standard deviations, for
that blade misses a little less at the box's other end, and each nat of it counts. Where readings
may be gross errors with a probability of e^−DOUBT, and say nothing then, the message of a blade is

    m'_b(s) = (1 − e^−DOUBT) m_b(s) + e^−DOUBT c_b  ≈  max(m_b(s), e^f_b)

(contamination: Box & Tiao, Biometrika 55, 1968; here of a blade's readings as a whole, for within a
blade they cannot be told apart by a message). Its influence is bounded, and where all of m_b lies
below the floor f_b it has none: the shared parameters follow from the others alone, as in a cut
model (Plummer, Statistics and Computing 25, 2015). Its own parameters are fitted to its readings
as before, at the nodes that the others give.

The floor follows from the blade's rows and the model, so that evidence of models is comparable,

    f_b = log density of R residuals of zero at the middle of the priors − ½ chi²_R(e^−20) − DOUBT,

where chi²_R(p) is what noise exceeds with probability p: a blade that `health` does not accuse is
never below it but for its Occam factor. It is for the accused alone. Messages of sound blades fall
far below it away from the posterior, which is how the posterior is found. So nodes are placed
without floors; of those who contradict there the worst get one (`_worst`), and the nodes are placed
anew, until nobody else contradicts. (A sound blade seems to contradict where another one carries
the rotor away, and fits again once that one is bounded.) Where more than `MOST` of the blades that
were read would be bounded, it is the model that is wrong, or the rotor is not one: then none is,
as nobody tells which to believe.

In a small rotor a wrong reading may accuse nobody: a wider noise of all readings makes up for it,
if that costs less than its own misfit. A hundred readings with one of 33 noises, or with two of
blades that were exchanged, are called five times as noisy, and effects of everything else drown in
that. So blades with a visit that is far from what all their others foresee (`doubted`) are tried
with a floor as well; the evidence tells whether the rest at their own noise and a gross error are
likelier than all of them at a wider one, for both are counted.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import numpy as np

from core.calibration.health import contradictions, improbable, most_of
from core.calibration.message import BladeMessage
from core.calibration.weighed import Weighed

DOUBT = 10.0  # nats: −log of the probability that a blade's readings are gross errors
MOST = 0.2  # of the blades that were read
ROUNDS = 6
TRIED = 3  # groups of doubted blades
SURE = 2.0  # nats by which the evidence has to be for a floor that nobody was accused for

Accused = list[dict[str, Any]]


def floor_of(message: BladeMessage) -> float:
    """f_b [nat] of a blade."""
    middle = np.full((1, message.space.dim), 0.5)
    _, s2, rest = message.readings(middle)
    zero = float(rest[0]) + message.offset - 0.5 * float(np.sum(np.log(2 * np.pi * s2)))
    return zero - 0.5 * most_of(s2.shape[1]) - DOUBT


def settled(
    messages: Mapping[str, BladeMessage],
    weigh: Callable[[Mapping[str, float]], Weighed],
    apart: Collection[str] = (),
    doubts: Callable[[Weighed, Accused], Sequence[tuple[str, ...]]] | None = None,
) -> tuple[Weighed, Accused]:
    """The nodes once nobody without a floor contradicts, and who contradicts there.

    weigh   places the nodes with these floors; apart: blades that have one from the beginning
    doubts  groups of blades for which a wider noise may have made up, the likeliest first
    """

    def floored(blades: Collection[str]) -> Weighed:
        return weigh({b: floor_of(messages[b]) for b in sorted(blades)})

    made, accused = _alone(messages, floored, floored(messages.keys() & apart))
    alone = all(one["blade"] in made.floors for one in accused)  # else too many contradict
    for group in list(doubts(made, accused) if alone and doubts is not None else ())[:TRIED]:
        blades = made.floors.keys() | group
        if blades == made.floors.keys() or len(blades) > MOST * len(messages):
            continue
        other = floored(blades)
        if other.log_evidence > made.log_evidence + SURE:
            made, accused = _alone(messages, floored, other)
    return made, [one | {"bounded": one["blade"] in made.floors} for one in accused]


def _alone(
    messages: Mapping[str, BladeMessage],
    floored: Callable[[Collection[str]], Weighed],
    made: Weighed,
) -> tuple[Weighed, Accused]:
    """With floors for those who contradict, the worst first, until nobody else does."""
    first = made
    accused = at_first = _contradict(messages, made)
    for _ in range(ROUNDS):
        more = _worst([one for one in accused if one["blade"] not in made.floors])
        if not more:
            break
        if len(more) + len(made.floors) > MOST * len(messages):
            return first, at_first
        made = floored(more | made.floors.keys())
        accused = _contradict(messages, made)
    return made, accused


def _worst(accused: Accused) -> set[str]:
    """Those whom no shared parameters explain; if there are none, those who miss at least half as
    much as the one who misses most: the rest may contradict because of these.

    >>> one = {"blade": "a", "misfit_nat": 90.0, "own_nat": 1.0, "rows": 3}
    >>> two = {"blade": "b", "misfit_nat": 40.0, "own_nat": 0.5, "rows": 3}
    >>> _worst([one, two]), _worst([one, two | {"own_nat": 39.0}]), _worst([])
    ({'a'}, {'b'}, set())
    """
    never = {one["blade"] for one in accused if improbable(one["own_nat"], one["rows"])}
    most = max((one["misfit_nat"] for one in accused), default=0.0)
    return never or {one["blade"] for one in accused if one["misfit_nat"] >= 0.5 * most}


def _contradict(messages: Mapping[str, BladeMessage], made: Weighed) -> Accused:
    return contradictions(messages, made.columns, made.unit, made.log_p)
