"""Names that earn a place in the model together, and none of them by itself.

An effect goes into the model if it gains its price, `EARNED` nats and the log of what it was chosen
from (`core.diagnosis.search`). Where blades are of one age, wear, fouling and cooling that declines
move three readings of a blade alike: each gains 4 nats where 6 are asked for, and yet that one of
them is there has more evidence than each. With the prior weight π_i of each hypothesis, and its
Bayes factor B_i against none, that is

    B = Σ_i π_i B_i = π_k B_k / w_k

of any k that the particle filter weighed, w_k its share of the evidence. With nothing there the
expectation of B is one, so that it reaches e^`EARNED` in no more than e^−`EARNED` of sound rotors
(Markov), as each price by itself has it. Then nothing is claimed, for no name has earned it; but
what shares the evidence is told, what to read next, and what each of them forecasts.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from core.diagnosis.conclude import Turn
from core.diagnosis.grammar import Cell
from core.diagnosis.search import EARNED
from core.diagnosis.verdict import Verdict

SHOWN = 6  # names in words


def together(turn: Turn, prices: Mapping[Cell, float]) -> float:
    """log B of all that a turn weighed [nat]; −inf where no single cell was calibrated.

    prices  what each cell has to gain: `EARNED` − log π_i
    """
    index = {cell: i for i, cell in enumerate(turn.cells)}
    gains: dict[tuple[int, ...], float] = {
        (index[one.effects[-1]],): one.gained
        for names, one in turn.rivals.items()
        if len(names) == 1 and one.effects[-1] in prices
    }
    known = [h for h in turn.hypotheses if h.cells in gains]
    if not known:
        return -math.inf
    best = max(known, key=lambda h: h.weight)
    owed = prices[turn.cells[best.cells[0]]] - EARNED
    return gains[best.cells] - owed - math.log(best.weight)


def shared(verdict: Verdict, turns: Sequence[Turn], prices: Mapping[Cell, float]) -> Verdict:
    """A verdict of which nothing came into the model, with the names that earn a place together;
    of one with too many names to be an answer, those that have the most evidence first.

    Fewer than two of them are none: a name whose evidence is its own has its price to gain.
    """
    if verdict.several:
        return replace(verdict, several=by_share(verdict.several, turns))
    if verdict.word != "unattributed" or not turns or turns[0].took:
        return verdict
    gained, names = together(turns[0], prices), by_share(turns[0].in_doubt, turns)
    if gained < EARNED or len(names) < 2:
        return verdict
    first, *rest = verdict.reasons
    told = ", ".join(names[:SHOWN]) + ", …" * (len(names) > SHOWN)
    why = f"{first} by itself; {len(names)} do together, by {gained:z.1f} nat: {told}"
    return replace(verdict, several=names, reasons=(why, *rest))


def by_share(names: Iterable[str], turns: Sequence[Turn]) -> tuple[str, ...]:
    """Names, or causes, in the order of their largest share of a turn's evidence."""
    shares: dict[str, float] = {}
    for turn in turns:
        own: dict[str, float] = {}
        for name, share in turn.evidence.items():
            called = turn.called(name)
            own[called] = own.get(called, 0.0) + share
        shares = {n: max(own.get(n, 0.0), shares.get(n, 0.0)) for n in own | shares}
    return tuple(sorted(names, key=lambda n: (-shares.get(n, 0.0), n)))
