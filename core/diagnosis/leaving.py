"""Which effects leave again once all are found: those that keep others from being said.

An effect is taken because it gains more than its price. It may do so by making good what the law
lacks elsewhere: a small misfit, with many readings, is worth many nats to whatever cell comes near
it. Such an effect must not be claimed, and it must not stand in the way of what is there. So two
kinds leave, if what is left without them is chance:

    open      those whose turn did not settle on a name, beside others whose turn did
    unsteady  the one without which the amplitudes of all others hold, if with it they do not;
              of several, the one that gained least

That they would gain is said with the verdict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from core.diagnosis.conclude import Rival, Turn
from core.diagnosis.search import Search


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
    """Without the one effect beside which amplitudes do not hold between halves.

    None where they hold, or do not without any single one of them either, or where more than
    chance is then left.
    """
    if len(taken.effects) < 2 or _steady(search, taken):
        return None
    rests = [
        search.only(taken, tuple(c for c in taken.effects if c != out)) for out in taken.effects
    ]
    for rest in sorted((r for r in rests if r is not None), key=lambda r: -r.gained):
        if _steady(search, rest):
            _, found = search.left(rest, len(turns))
            if found.word == "adequate":
                why = ", and amplitudes would not hold between halves beside it"
                return _fewer(taken, rest, found.p, why)
    return None


def _steady(search: Search, taken: Rival) -> bool:
    held = search.case.halves(search.model, search.state, taken)
    return all(h.agrees for h in held)


def _fewer(taken: Rival, rest: Rival, p: float, why: str = "") -> Fewer:
    gone = [c.name for c in taken.effects if c not in rest.effects]
    gain = taken.gained - rest.gained
    told = (
        f"{' and '.join(gone)} would gain {gain:.1f} nat more{why}; what is left without has "
        f"p = {p:.2g} and no name of its own"
    )
    return Fewer(rest, p, told)
