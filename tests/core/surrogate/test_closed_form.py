"""A closed form keeps what it declares, and its digest is what it answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from core.builtin import creep_specimens as built
from core.errors import InputError, ModelError
from core.surrogate.closed_form import ClosedForm, FormulaRows
from core.surrogate.formula import FormulaInput

Array = NDArray[np.float64]
INPUTS = (FormulaInput("l", -2.0, 2.0), FormulaInput("s", 0.5, 3.0))


def decay(x: Array, t: Array) -> Array:
    return np.asarray(np.exp(x[..., 0]) * t / x[..., 1])


def form(**given: object) -> ClosedForm:
    own = {"rising": ("l",), "falling": ("s",), "horizon_h": 100.0} | given
    return ClosedForm(INPUTS, {"y": decay}, "decay", positive=("y",), **own)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "wrong",
    [
        {"rising": ("l", "s"), "falling": ()},
        {"rising": (), "falling": ("l",)},
        {"rising": ("k",)},
        {"rising": ("l", "s")},
    ],
)
def test_a_direction_that_the_formula_does_not_keep_is_refused(wrong: dict[str, object]) -> None:
    assert form().direction("l") == 1
    assert form().direction("s") == -1
    with pytest.raises(InputError, match=r"other way|is no input|named twice"):
        form(**wrong)


def test_the_digest_follows_what_is_answered_and_not_how_it_is_written() -> None:
    same = replace(form(), formulas={"y": lambda x, t: t / x[..., 1] * np.exp(x[..., 0])})
    other = replace(form(), formulas={"y": lambda x, t: 1.000001 * decay(x, t)})
    assert same.digest == form().digest
    assert len({form().digest, other.digest, form(horizon_h=90.0).digest}) == 3
    assert built.formula().digest == built.formula.__wrapped__().digest


def test_polynomials_over_the_whole_box_are_given_where_they_hold_and_refused_where_not() -> None:
    made = form().response("y", [10.0])
    x = np.array([[0.3, 1.1], [-1.4, 2.7]])
    assert made.evaluate(x)[0][:, 0] == pytest.approx(decay(x, np.array(10.0)), rel=0.01)
    with pytest.raises(ModelError, match=r"creep-specimens at 300 h is no polynomial"):
        built.formula().response(built.QUANTITY, [300.0])


def test_rows_answer_the_formula_itself_in_any_company_of_inputs() -> None:
    rows = form().rows("y", [10.0, 20.0])
    x = np.array([[0.3, 1.1]])
    assert rows.evaluate(x)[0][0].tolist() == [decay(x, np.array(t))[0] for t in (10.0, 20.0)]
    wide = rows.over(("s", "k", "l"), np.zeros(3), np.ones(3))
    assert wide.evaluate(np.array([[1.1, 9.0, 0.3]]))[0].tolist() == rows.evaluate(x)[0].tolist()
    both = FormulaRows.stack([rows, rows.of_input("l")])
    assert both.evaluate(x)[0][0, 2] == 0.3
    with pytest.raises(ModelError, match="two models"):
        FormulaRows.stack([rows, form(horizon_h=90.0).rows("y", [1.0])])


def test_a_positive_formula_that_begins_from_nothing_is_compiled_at_the_start_as_later() -> None:
    """The logarithm of 0 made every row NaN, those of later hours too."""
    narrow = ClosedForm(
        (FormulaInput("l", 0.0, 0.5), FormulaInput("s", 2.5, 3.0)), {"y": decay}, "decay", 100.0
    )
    rows = replace(narrow, positive=("y",)).response("y", [0.0, 40.0])
    x = np.array([[0.2, 2.7]])
    assert rows.evaluate(x)[0][0] == pytest.approx([0.0, np.exp(0.2) * 40 / 2.7], rel=1e-4)


def test_more_inputs_than_twelve_are_probed_too() -> None:
    inputs = tuple(FormulaInput(f"x{j}", 0.0, 1.0) for j in range(26))

    def fall(x: Array, t: Array) -> Array:
        return np.asarray(t * (x[..., :25].sum(axis=-1) - x[..., 25]))

    made = ClosedForm(inputs, {"y": fall}, "wide", rising=("x24",), falling=("x25",))
    assert len(np.unique(made._probes[0].round(9), axis=1).T) == 26
    with pytest.raises(InputError, match="goes the other way"):
        replace(made, rising=("x25",), falling=())
