"""Which effects leave again once all are found: those that keep others from being said.

An effect is taken because it gains more than its price. It may do so by making good what the law
lacks elsewhere: a small misfit, with many readings, is worth many nats to whatever cell comes near
it. Such an effect must not be claimed, and it must not stand in the way of what is there. So two
kinds leave, if what is left without them is chance:

    open      those whose turn did not settle on a name, beside others whose turn did
    unsteady  the one without which all others hold in halves, if with it not all do; of several,
              the one that gained least

That they would gain is said with the verdict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from core.diagnosis.conclude import Rival, Turn
from core.diagnosis.search import Search
from core.diagnosis.verdict import Held


@dataclass(frozen=True, slots=True)
class Fewer:
    """What stays, the p of what is then left, and in words what left."""

    rest: Rival
    p: float
    told: str


def without_open(search: Search, taken: Rival, turns: Sequence[Turn]) -> Fewer | None:
    """Without the effects whose turn left their names open.

    None where no effect is open, none is settled, or more than chance is left without them.
    """
    claims = {n: turn.claim(n) for turn in turns for n in turn.took}
    sure = tuple(c for c in taken.effects if claims.get(c.name) is not None)
    if not 0 < len(sure) < len(taken.effects):
        return None
    rest = search.only(taken, sure)
    if rest is None:
        return None
    _, found = search.left(rest, len(turns))
    return _fewer(taken, rest, found.p) if found.word == "adequate" else None


def without_unsteady(search: Search, taken: Rival, turns: Sequence[Turn]) -> Fewer | None:
    """Without the one effect that does not hold in halves, or beside which others do not.

    None where all hold, or do not without any single one of them either, or where more than
    chance is then left.
    """
    if len(taken.effects) < 2:
        return None
    held = _held(search, taken)
    if all(one.stands for one in held):
        return None
    rests = [
        search.only(taken, tuple(c for c in taken.effects if c != out)) for out in taken.effects
    ]
    for rest in sorted((r for r in rests if r is not None), key=lambda r: -r.gained):
        if all(one.stands for one in _held(search, rest)):
            _, found = search.left(rest, len(turns))
            if found.word == "adequate":
                return _fewer(taken, rest, found.p, _why(taken, rest, held))
    return None


def _held(search: Search, taken: Rival) -> tuple[Held, ...]:
    return search.case.halves(search.model, search.state, taken)


def _why(taken: Rival, rest: Rival, held: Sequence[Held]) -> str:
    out = next(c.name for c in taken.effects if c not in rest.effects)
    for one in held:
        if one.effect == out and one.gained is not None and not one.stands:
            first, second = one.gained
            return f", but not in each half by itself ({first:z.1f} and {second:z.1f} {one.by})"
    return ", and amplitudes would not hold between halves beside it"


def _fewer(taken: Rival, rest: Rival, p: float, why: str = "") -> Fewer:
    gone = [c.name for c in taken.effects if c not in rest.effects]
    gain = taken.gained - rest.gained
    told = (
        f"{' and '.join(gone)} would gain {gain:z.1f} nat more{why}; what is left without has "
        f"p = {p:.2g} and no name of its own"
    )
    return Fewer(rest, p, told)
