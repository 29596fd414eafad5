"""Names before courses: what several courses share is theirs together."""

from __future__ import annotations

from core.diagnosis.choice import by_name
from core.diagnosis.families import FAMILIES
from core.diagnosis.grammar import Cell

WEAR, SPALLED = FAMILIES[0], FAMILIES[1]
OFFSET = next(f for f in FAMILIES if f.name == "campaign offset")
CELLS = [
    Cell(WEAR, "linear", "coating_lot", "C2"),
    Cell(WEAR, "early", "coating_lot", "C2"),
    Cell(SPALLED, "step", "coating_lot", "C2", 9000.0),
    Cell(SPALLED, "step", "coating_lot", "C2", 19000.0),
    Cell(WEAR, "linear", "coating_lot", "C1"),
    Cell(OFFSET, "constant", "campaign", "c1"),
]


def test_two_courses_of_a_name_outweigh_one_of_another() -> None:
    """As in the main job: at once 39 and 9 % of the evidence, by wear 34 and 17 %."""
    assert by_name({(0,): -1.08, (1,): -1.77, (2,): -0.94, (3,): -2.4}, CELLS) == (0,)
    assert by_name({(0,): -1.08, (2,): -0.94}, CELLS) == (2,), "the control: a course each"


def test_a_name_is_of_whom_it_concerns_too() -> None:
    assert by_name({(0,): -1.0, (4,): -1.1, (2,): -0.9}, CELLS) == (2,)


def test_pairs_are_names_of_their_own() -> None:
    assert by_name({(0, 5): 3.0, (1, 5): 2.9, (2, 5): 3.2, (0,): 3.1}, CELLS) == (0, 5)
