"""Names that share the evidence earn a place together where none does by itself; none is claimed.

One effect under six names has one gain: each has to gain its choice among six as well, all of them
together do not.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from core.calibration.online import update
from core.diagnosis import Case, Diagnosis, Facts, diagnose, to_json
from core.diagnosis.conclude import Rival, Turn
from core.diagnosis.grammar import Cell
from core.diagnosis.hypotheses import Hypothesis
from core.diagnosis.rivals import rivals_of
from core.diagnosis.search import EARNED
from core.diagnosis.together import by_share, shared, together
from tests.core.diagnosis.test_diagnose import BEND, MODEL, SPEC, readings

ALIKE = tuple(replace(BEND, name=f"bend {k}") for k in range(6))
NAMES = tuple(f.name for f in ALIKE)


@cache
def told(size: float) -> tuple[Diagnosis, Case]:
    data = readings(lambda b, t: size * t**2)
    case = Case(SPEC, data, {b: Facts() for b in SPEC.blades}, ALIKE)
    model = replace(MODEL, network=replace(MODEL.network, families=ALIKE))
    return diagnose(model, update(model, SPEC, data), case), case


def test_one_effect_under_six_names_earns_its_place_by_all_of_them() -> None:
    found, case = told(0.08)
    [gain] = {round(g, 6) for _, g in found.tried}
    assert EARNED < gain < EARNED + math.log(len(NAMES)), "by itself none of them does"
    assert found.verdict.word == "unattributed"
    assert (found.verdict.names, found.effects) == ((), ())
    assert found.verdict.several == NAMES
    assert f"6 do together, by {gain:.1f} nat: bend 0, bend 1" in found.verdict.reasons[0]
    cells = found.turns[0].cells
    prices = {c: EARNED + math.log(len(cells)) for c in cells}
    assert together(found.turns[0], prices) == pytest.approx(gain, abs=1e-6)
    assert {n for r in rivals_of(found, case) for n in r.names} == set(NAMES)
    assert [share for _, share in found.rivals] == pytest.approx([0.2] * 5)
    assert found.foretold
    assert to_json(found, case)["several"] == list(NAMES)


def test_where_they_do_not_nothing_is_told_of_them() -> None:
    found, case = told(0.05)
    assert found.verdict.word == "unattributed"
    assert (found.verdict.several, found.rivals, found.foretold) == ((), (), False)
    assert to_json(found, case)["several"] == []
    assert found.verdict.reasons == ("no effect of the grammar earns its place in the model",)
    assert rivals_of(found, case) == []


def test_what_earns_its_place_by_itself_is_told_as_ever() -> None:
    found, _ = told(0.15)
    assert found.effects
    assert found.verdict.reasons[0] == "6 names share the evidence"
    assert found.foretold


def test_what_was_taken_and_left_again_is_no_name_that_shares_the_evidence() -> None:
    """Nor is anything told anew of a verdict that has names, but in which order they are read."""
    found, _ = told(0.08)
    [turn] = found.turns
    prices = {c: EARNED + math.log(len(turn.cells)) for c in turn.cells}
    bare = replace(found.verdict, several=(), reasons=("nothing earns its place",))
    assert shared(bare, [turn], prices).several == NAMES
    assert shared(bare, [replace(turn, took=("bend 0",))], prices) == bare
    assert shared(bare, [], prices) == bare
    many = replace(bare, several=("other", *NAMES[::-1]))
    assert shared(many, [turn], prices) == replace(many, several=(*NAMES, "other"))


def weighed(log_bf: np.ndarray, cells: tuple[Cell, ...]) -> Turn:
    """A turn of single cells that share the prior evenly, of which the three best are calibrated.

    Their gains are known; of the others the scan says the same."""
    weight = np.exp(log_bf - np.logaddexp.reduce(log_bf))
    order = np.argsort(-weight)
    every = [Hypothesis((i,), (cells[i].name,), log_bf[i], weight[i]) for i in order]
    rivals = {
        (cells[i].name,): Rival((cells[i],), MODEL, lambda: None, log_bf[i])  # type: ignore[arg-type, return-value]
        for i in order[2::-1]
    }
    return Turn(tuple(every), (), rivals, cells)


def test_sound_readings_seldom_gain_as_much_and_without_priors_they_would() -> None:
    """Against the exact mean of all Bayes factors: ln B_i = I z² / (2 (1 + I)) − ln(1 + I) / 2 for
    amplitudes from N(0, 1) of information I."""
    rng, count, sets = np.random.default_rng(5), 8, 4000
    cells = tuple(Cell(replace(BEND, name=f"f{k}"), "constant", "all", None) for k in range(count))
    prices = {c: EARNED + math.log(count) for c in cells}
    information = np.geomspace(0.5, 20.0, count)
    z = rng.normal(size=(sets, count))
    log_bf = 0.5 * information * z**2 / (1.0 + information) - 0.5 * np.log1p(information)
    ours = np.array([together(weighed(row, cells), prices) for row in log_bf])
    exact = np.logaddexp.reduce(log_bf, axis=1) - math.log(count)
    assert ours == pytest.approx(exact, abs=1e-9)
    assert np.mean(ours >= EARNED) < math.exp(-EARNED)
    free = np.mean(np.logaddexp.reduce(log_bf, axis=1) >= EARNED)
    assert free > math.exp(-EARNED), "a sum of all that pays for no choice"


def test_names_come_by_what_they_have_of_the_evidence_causes_by_that_of_all_their_courses() -> None:
    worn, spalled = (replace(BEND, name=n, cause="coating loss") for n in ("worn", "spalled"))
    cells = tuple(Cell(f, "constant", "all", None) for f in (worn, spalled, BEND))
    turn = weighed(np.log([0.35, 0.25, 0.4]), cells)
    assert turn.in_doubt == ("bend", "coating loss")
    assert by_share(turn.in_doubt, [turn]) == ("coating loss", "bend")
    more = weighed(np.log([0.05, 0.9, 0.05]), cells)
    assert by_share(("bend", "spalled"), [turn, more]) == ("spalled", "bend")


def test_a_turn_without_a_single_cell_that_was_calibrated_says_nothing() -> None:
    cells = (Cell(BEND, "constant", "all", None),)
    turn = Turn((Hypothesis((0,), ("bend",), 9.0, 1.0),), (), {}, cells)
    assert together(turn, {cells[0]: EARNED}) == -math.inf
