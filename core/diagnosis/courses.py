"""Where it is open how a cause runs in time, the model gets two courses, as shares of one.

A coating that wears and one that came off at once move three readings of a blade alike, and go on
differently: one of them in the model forecasts too surely, and which of them it is hangs on a
tenth of a nat. With both, y = f(a_1 s_1(t) + a_2 s_2(t)), each with a prior of its own, the
readings say what they can, the sum, and leave open what they must, its parts: forecasts lie between
those of the courses alone, and their bands span both. A course that is neither, as most are that
were drawn by no formula, is nearer to a sum than to either.

The other course is that of the weightiest rival (`alternatives.shares`) which differs in one effect
of the same cause (claimed, its course open) and another name, with `OPEN` of the evidence at least.
Both stay unless one alone has `AGAINST` nats more evidence, or an amplitude leans on the end of its
room; then all is as without. Names, amplitudes in halves and all else that a verdict rests on are
of one course.

In simulations of a linear law, read so that which of two courses it is stays open, a forecast at
twice the hours by the better course alone is off by 2.7 of its sds (rms) where the truth is any
share of the two and by 3.4 where it is one of them; by both by 0.9 and 1.3, and nearer
(`tests/core/diagnosis/test_courses.py`).

The posterior is expected on the line between those of the courses alone: with means m_1, m_2 and
covariances C_1, C_2, and any share of them as likely as another,

    mean (m_1 + m_2) / 2,     covariance (C_1 + C_2) / 2 + (m_1 − m_2)(m_1 − m_2)ᵀ / 12.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

from core.calibration.start import Start
from core.diagnosis.conclude import Rival
from core.diagnosis.grammar import Cell
from core.diagnosis.search import EARNED, Search

OPEN = 0.1
AGAINST = EARNED  # as much as an effect has to gain, to be taken


def other_course(
    taken: Rival, rivals: Sequence[tuple[Rival, float]], causes: Collection[str]
) -> tuple[Rival, Cell, Cell] | None:
    """The weightiest rival that runs otherwise, its effect, and that of `taken` in its place.

    causes  those that are claimed with their course open
    """
    for rival, share in rivals:
        more = [c for c in rival.effects if c not in taken.effects]
        less = [c for c in taken.effects if c not in rival.effects]
        if share < OPEN or len(more) != 1 or len(less) != 1:
            continue
        alike = more[0].cause == less[0].cause and more[0].name != less[0].name
        if alike and less[0].cause in causes:
            return rival, more[0], less[0]
    return None


def with_both(
    search: Search,
    taken: Rival,
    rivals: Sequence[tuple[Rival, float]],
    causes: Collection[str],
    leans: Callable[[Cell, Rival], str | None],
) -> tuple[Rival, str] | None:
    """What is taken with another course beside its own, and that in words; None: one is enough.

    causes  those that are claimed with their course open
    leans   tells of an effect in a rival that its amplitude has no room
    """
    if (found := other_course(taken, rivals, causes)) is None:
        return None
    rival, more, own = found
    made = search.calibrated(
        (*taken.effects, more),
        lambda: Start.of(taken.model, taken.state).between(Start.of(rival.model, rival.state)),
    )
    if made is None or made.gained < taken.gained - AGAINST:
        return None
    if any(leans(cell, made) is not None for cell in made.effects):
        return None
    return made, (
        f"{own.name} and {more.name} are both in the model, as shares of one course: they gain "
        f"{made.gained:z.1f} nat, {own.name} alone {taken.gained:z.1f}"
    )
