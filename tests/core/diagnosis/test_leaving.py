"""An effect beside which the others' amplitudes do not hold leaves, if the rest is enough."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, cast

import pytest

from core.diagnosis.conclude import Rival
from core.diagnosis.families import FAMILIES
from core.diagnosis.grammar import Cell
from core.diagnosis.leaving import without_unsteady
from core.diagnosis.search import Search
from core.diagnosis.verdict import Held, Verdict

A, B, C = (Cell(f, f.shapes[0], "all") for f in FAMILIES[:3])
GAINED = {frozenset((A, B, C)): 40.0, frozenset((A, B)): 30.0, frozenset((A, C)): 20.0}
NOTHING: Any = None


class Stub:
    """A search whose every answer is set: which sets hold, what is left of them."""

    model = state = NOTHING

    def __init__(self, steady: Collection[frozenset[Cell]], enough: bool) -> None:
        self.steady, self.enough, self.case = steady, enough, self
        self.asked: list[frozenset[Cell]] = []

    def halves(self, model: Any, state: Any, taken: Rival) -> tuple[Held, ...]:
        holds = frozenset(taken.effects) in self.steady
        return (Held("early and late", (1.0, 1.0), 0.1), Held("x", (1.0, 1.0 + (not holds)), 0.1))

    def only(self, taken: Rival, effects: tuple[Cell, ...]) -> Rival | None:
        gained = GAINED.get(frozenset(effects))
        return None if gained is None else Rival(effects, NOTHING, NOTHING, gained)

    def left(self, taken: Rival, turn: int) -> tuple[None, Verdict]:
        self.asked.append(frozenset(taken.effects))
        word = "adequate" if self.enough else "unattributed"
        return None, Verdict(word, 0.2, None, (), None, (), {}, {}, (), ())


def left(steady: Collection[frozenset[Cell]], enough: bool = True) -> tuple[Any, Stub]:
    search = Stub(steady, enough)
    taken = Rival((A, B, C), NOTHING, NOTHING, GAINED[frozenset((A, B, C))])
    return without_unsteady(cast(Search, search), taken, []), search


def test_of_those_without_which_the_rest_holds_the_one_that_gained_least_leaves() -> None:
    fewer, _ = left([frozenset((A, B)), frozenset((A, C))])
    assert fewer.rest.effects == (A, B)
    assert fewer.told == (
        f"{C.name} would gain 10.0 nat more, and amplitudes would not hold between halves beside "
        "it; what is left without has p = 0.2 and no name of its own"
    )
    fewer, _ = left([frozenset((A, C))])
    assert fewer.rest.effects == (A, C)


@pytest.mark.parametrize(
    ("steady", "enough"),
    [
        ([frozenset((A, B, C)), frozenset((A, B))], True),  # it holds: nothing has to leave
        ([], True),  # no single one is at fault
        ([frozenset((B, C))], True),  # which could not be calibrated
        ([frozenset((A, B))], False),  # more than chance is left
    ],
)
def test_none_leaves_where_that_mends_nothing(steady: list[frozenset[Cell]], enough: bool) -> None:
    assert left(steady, enough)[0] is None


def test_one_that_is_not_found_in_each_half_by_itself_leaves_and_is_told_so() -> None:
    class Parted(Stub):
        def halves(self, model: Any, state: Any, taken: Rival) -> tuple[Held, ...]:
            gained = {A: (270.0, 300.0), B: (100.0, 90.0), C: (10.0, -0.4)}
            return tuple(
                Held("early and late", (1.0, 3.0 if c == A else 1.0), 0.1, c.name, gained=gained[c])
                for c in taken.effects
            )

    taken = Rival((A, B, C), NOTHING, NOTHING, GAINED[frozenset((A, B, C))])
    fewer = without_unsteady(cast(Search, Parted([], True)), taken, [])
    assert fewer is not None
    assert fewer.rest.effects == (A, B)
    assert fewer.told.startswith(
        f"{C.name} would gain 10.0 nat more, but not in each half by itself (10.0 and -0.4 early "
        "and late); what is left"
    )


def test_a_single_effect_that_does_not_hold_stays_and_is_told_by_the_verdict() -> None:
    alone = Rival((A,), NOTHING, NOTHING, 9.0)
    assert without_unsteady(cast(Search, Stub([], True)), alone, []) is None
