"""A name is claimed only where it has the evidence of its own turn."""

from __future__ import annotations

from typing import Any

import pytest

from core.diagnosis import conclude as module
from core.diagnosis.conclude import Rival, Turn, apart, conclude, reweighed
from core.diagnosis.families import FAMILIES
from core.diagnosis.grammar import Cell
from core.diagnosis.hypotheses import Hypothesis
from core.diagnosis.verdict import Held, Verdict
from core.family import Shape

NOTHING: Any = None
ALARM = Verdict("not separable", 0.002, None, (), None, (), {}, {}, (), ())


def turn(took: str, **weights: float) -> Turn:
    """Hypotheses of one name each; all were calibrated that a turn may take."""
    found = [Hypothesis((i,), (n,), 9.0, w) for i, (n, w) in enumerate(weights.items())]
    ordered = tuple(sorted(found, key=lambda h: -h.weight))
    taken = (took,) if took else ()
    return Turn(ordered, taken, {taken: Rival((), NOTHING, NOTHING, 9.0)} if took else {})


def said(names: tuple[str, ...], *turns: Turn, after: float = 0.4, **more: Any) -> Verdict:
    held, refused = more.get("held", ()), more.get("refused", {})
    return conclude(ALARM, names, after, turns, 20.0, held, refused)


def test_the_name_with_the_evidence_is_claimed() -> None:
    found = said(("wear",), turn("wear", wear=0.97, offset=0.03))
    assert (found.word, found.names) == ("effect", ("wear",))
    assert "20.0 nat" in found.reasons[0]


def test_a_rival_that_could_not_be_calibrated_keeps_its_evidence_from_the_one_that_was() -> None:
    # The scan holds `cooling`; the runs have no room for it, `wear` is the next that has.
    found = said(
        ("wear",),
        turn("wear", cooling=0.93, wear=0.07),
        refused={("cooling",): "finds no room"},
    )
    assert found.word == "not separable"
    assert found.names == ("cooling", "wear")


def test_without_the_threshold_the_wrong_name_would_be_claimed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "NAMED", 0.0)
    found = said(("wear",), turn("wear", cooling=0.93, wear=0.07))
    assert (found.word, found.names) == ("effect", ("wear",))


def test_a_later_turn_that_takes_nothing_does_not_speak_for_the_first() -> None:
    shared = turn("wear", wear=0.6, offset=0.4)
    found = said(("wear",), shared, turn("", offset=1.0))
    assert (found.word, found.names) == ("not separable", ("offset", "wear"))
    settled = said(("wear",), turn("wear", wear=0.99, offset=0.01), turn("", offset=1.0))
    assert (settled.word, settled.names) == ("effect", ("wear",))


def test_every_turn_has_to_settle() -> None:
    first, second = turn("wear", wear=0.99, gain=0.01), turn("offset", offset=0.95, gain=0.05)
    both = said(("wear", "offset"), first, second)
    assert (both.word, both.names) == ("effect", ("offset", "wear"))
    doubtful = said(("wear", "offset"), first, turn("offset", offset=0.55, gain=0.45))
    assert (doubtful.word, doubtful.names) == ("not separable", ("gain", "offset", "wear"))
    assert doubtful.reasons == ("2 names share the evidence beside wear",)
    assert doubtful.beside == ("wear",), "it is sure: the others are not told apart"
    assert both.beside == ()


def test_an_open_one_that_chance_explains_leaves_the_others_their_names_and_is_told() -> None:
    first, second = turn("wear", wear=0.99, gain=0.01), turn("offset", offset=0.55, gain=0.45)
    told = "offset would gain 5.1 nat more"
    found = conclude(ALARM, ("wear",), 0.3, [first, second], 20.0, (), {}, [told])
    assert (found.word, found.names) == ("effect", ("wear",))
    assert found.reasons[1] == told


def test_of_a_pair_the_one_that_is_sure_keeps_its_name_when_the_other_has_left() -> None:
    pair = Hypothesis((0, 1), ("wear", "offset"), 9.0, 0.6)
    other = Hypothesis((0, 2), ("wear", "gain"), 9.0, 0.4)
    both = Turn((pair, other), ("wear", "offset"), {})
    assert said(("wear", "offset"), both).word == "not separable"
    assert said(("wear",), both).names == ("wear",)


def test_an_effect_that_left_again_is_not_claimed() -> None:
    first, second = turn("gain", gain=0.95, wear=0.05), turn("wear", wear=0.99, offset=0.01)
    found = said(("wear",), first, second)
    assert (found.word, found.names) == ("effect", ("wear",))


def worn(shape: Shape, family: int = 0) -> Cell:
    return Cell(FAMILIES[family], shape, "coating_lot", "C2")


def test_where_the_course_is_open_the_cause_is_claimed_and_said() -> None:
    cells = (worn("linear"), worn("step", 1), Cell(FAMILIES[0], "linear", "coating_lot", "C1"))
    names = [c.name for c in cells]

    def of(*weights: float) -> Turn:
        pairs = zip(names, weights, strict=True)
        one = turn(names[0], **dict(pairs))
        return Turn(one.hypotheses, one.took, one.rivals, cells)

    found = said((names[0],), of(0.55, 0.43, 0.02))
    assert (found.word, found.names) == ("effect", ("coating loss (coating lot C2)",))
    assert "how coating loss (coating lot C2) runs is open" in found.reasons[1]
    sure = said((names[0],), of(0.95, 0.03, 0.02))
    assert sure.names == ("coating wear (coating lot C2)",)
    other = said((names[0],), of(0.5, 0.1, 0.4))
    assert other.word == "not separable"
    assert other.names == ("coating loss (coating lot C2)", names[2])
    named = said((names[0],), of(0.58, 0.02, 0.4))
    assert named.names == (names[2], names[0])


def test_no_set_has_a_name_and_its_cause_side_by_side() -> None:
    cells = (worn("linear"), worn("step", 1), Cell(FAMILIES[0], "linear", "coating_lot", "C1"))
    names = [c.name for c in cells]
    weights = {names[0]: 0.53, names[1]: 0.05, names[2]: 0.38, "gain": 0.04}
    one = turn(names[0], **weights)
    found = said((names[0],), Turn(one.hypotheses, one.took, one.rivals, cells))
    assert found.word == "not separable"
    assert set(found.names) == {names[0], names[1], names[2]}, "wear has its cause's evidence"


def test_names_are_counted_without_the_sure_one_that_they_share_the_evidence_beside() -> None:
    pair = Hypothesis((0, 1), ("wear", "offset"), 9.0, 0.6)
    other = Hypothesis((0, 2), ("wear", "gain"), 9.0, 0.4)
    both = Turn((pair, other), ("offset",), {})
    found = said(("wear", "offset"), turn("wear", wear=0.99, gain=0.01), both)
    assert (found.names, found.beside) == (("gain", "offset", "wear"), ("wear",))
    assert found.reasons == ("2 names share the evidence beside wear",)


def test_of_a_single_name_that_is_open_its_share_is_told() -> None:
    """A scanner was set anew, and 34 % of the evidence was for that alone: of root settling beside
    it "1 names share the evidence" was said."""
    both = Hypothesis((0, 1), ("offset", "settling"), 9.0, 0.66)
    alone = Hypothesis((0,), ("offset",), 9.0, 0.34)
    found = said(("offset", "settling"), Turn((both, alone), ("offset", "settling"), {}))
    assert (found.word, found.names) == ("not separable", ("offset", "settling"))
    assert found.beside == ("offset",)
    assert found.reasons == (
        "settling has 66% of the evidence beside offset, where 90% are asked for",
    )


def test_a_set_holds_what_was_taken_even_where_another_cause_has_the_evidence() -> None:
    found = said(("wear",), turn("wear", cooling=0.99, wear=0.01))
    assert (found.word, found.names) == ("not separable", ("cooling", "wear"))


def test_what_has_no_room_in_the_runs_is_told_and_not_claimed() -> None:
    found = said((), turn("", cooling=0.98), refused={("cooling",): "finds no room in the runs"})
    assert (found.word, found.names) == ("unattributed", ())
    assert "cooling could not be calibrated: finds no room in the runs" in found.reasons


def test_nothing_is_claimed_while_more_is_there_or_halves_disagree() -> None:
    fine = turn("wear", wear=0.99, offset=0.01)
    assert said(("wear",), fine, after=0.01).word == "unattributed"
    apart_ = Held("early and late", (0.1, 1.9), 0.3)
    found = said(("wear",), fine, held=(apart_,))
    assert found.word == "unattributed"
    assert "early and late" in found.reasons[0]


def test_an_effect_that_both_halves_have_is_claimed_and_said_to_vary() -> None:
    fine = turn("wear", wear=0.99, offset=0.01)
    varies = Held("early and late", (9.0, 3.0), 1.0, "wear", alone=True, gained=(50.0, 80.0))
    found = said(("wear",), fine, held=(varies,))
    assert (found.word, found.names) == ("effect", ("wear",))
    assert found.reasons[-1] == (
        "wear is found early and late in each by itself (50 and 80 nat), but not with one "
        "amplitude: it is 9 and 3 times the expected one early and late, where 3 sd of the "
        "difference are 3; a forecast with one amplitude for all is too sure"
    )


def test_one_that_a_half_does_not_have_by_itself_is_not_claimed() -> None:
    fine = turn("wear", wear=0.99, offset=0.01)
    for gained, amplitudes in (((50.0, 4.9), (9.0, 3.0)), ((50.0, 80.0), (9.0, -3.0))):
        half = Held("early and late", amplitudes, 1.0, "wear", alone=True, gained=gained)
        found = said(("wear",), fine, held=(half,))
        assert found.word == "unattributed"
        assert ("not found early and late in each by itself" in found.reasons[0]) is (
            min(gained) < 5.0
        )


def test_too_many_names_are_no_answer() -> None:
    many = {f"n{i}": 0.125 for i in range(8)}
    found = said(("n0",), turn("n0", **many))
    assert (found.word, found.names) == ("unattributed", ())
    assert "8 names" in found.reasons[0]


def test_orders_of_a_pair_are_one_hypothesis_with_the_weight_of_both() -> None:
    found = apart(
        (
            Hypothesis((0, 1), ("a", "b"), 5.0, 0.3),
            Hypothesis((2, 0), ("b", "a"), 6.0, 0.45),
            Hypothesis((3,), ("c",), 4.0, 0.25),
        )
    )
    assert [(set(h.names), h.weight) for h in found] == [({"a", "b"}, 0.75), ({"c"}, 0.25)]


def test_the_filters_evidence_replaces_the_scans_and_leaves_the_others_in_proportion() -> None:
    a, b, c = (
        Hypothesis((i,), (n,), 9.0, w)
        for i, n, w in zip(range(3), "abc", (0.5, 0.3, 0.2), strict=True)
    )
    found = {h.names: h.weight for h in reweighed((a, b, c), {(0,): 30.0, (1,): 31.0})}
    total = 0.5 + 0.3 * 2.718281828 + 0.2
    assert found[("b",)] == pytest.approx(0.3 * 2.718281828 / total)
    assert found[("c",)] == pytest.approx(0.2 / total)
    assert reweighed((a, b, c), {}) == (a, b, c)


def test_nothing_is_named_whose_amplitude_has_no_room() -> None:
    end = "the amplitude of wear leans on 0.1, no room: the runs end there"
    fine = turn("wear", wear=0.99, offset=0.01)
    found = conclude(ALARM, ("wear",), 0.4, [fine], 20.0, (), {}, ends=[end])
    assert (found.word, found.names, found.reasons) == ("unattributed", (), (end,))
