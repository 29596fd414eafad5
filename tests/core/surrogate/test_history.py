"""The rule for inputs that change in time, against finite elements with the same histories."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.builtin import rotor_blade
from core.course import Course, pieces
from core.errors import InputError, RangeError
from core.surrogate import clock, history
from core.surrogate.followed import Followed, Scales

KEPT = json.loads(Path(__file__).with_name("histories.json").read_text())
TIMES = np.array(KEPT["time_h"])
TIP, CRITICAL = KEPT["nodes"]
BLADE = rotor_blade.load()
NAMES = [i.name for i in BLADE.inputs]
RNG = np.random.default_rng(0)
X = BLADE.low + RNG.random((6, 4)) * (BLADE.high - BLADE.low)
ROWS = [("elongation", None), ("deformation", [TIP]), ("ceeq", [TIP, CRITICAL])]
ROWS += [("creep_damage", [CRITICAL])]


def follow(
    edges: Any, inputs: Any, quantity: str, nodes: list[int] | None = None, *, late: bool = False
) -> Any:
    rows = Followed.of(BLADE, quantity, nodes)
    return history.follow(BLADE, edges, inputs, edges[1:], inputs, [rows], late=late)[0][:2]


@pytest.mark.parametrize(("quantity", "nodes"), ROWS)
@pytest.mark.parametrize("doubt", [True, False])
def test_inputs_that_never_change_are_asked_about_once(
    quantity: str, nodes: list[int] | None, doubt: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And answer to the last bit as `follow` does, which asks at every mark."""
    rows, marks = [Followed.of(BLADE, quantity, nodes)], np.array([1e3, 2e4, 7e4])
    at = np.repeat(X[:, None], len(marks), axis=1)
    whole = history.follow(BLADE, np.zeros(1), at[:, :0], marks, at, rows, 0.0, doubt=doubt)
    asked, known = [], history.Walk.known

    def counted(self: Any, x: np.ndarray) -> Any:
        asked.append(len(x))
        return known(self, x)

    monkeypatch.setattr(history.Walk, "known", counted)
    got = history.constant(BLADE, X, marks, rows, doubt=doubt)
    assert asked == [len(X)]
    assert all(np.array_equal(a, b) for a, b in zip(got[0], whole[0], strict=True))


@pytest.mark.parametrize("doubt", [True, False])
@pytest.mark.parametrize("late", [True, False])
def test_quantities_followed_together_answer_to_the_last_bit_as_one_by_one(
    doubt: bool, late: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And the process is asked once for all of them."""
    edges, marks = np.array([0.0, 1e4, 2e4]), np.array([5e3, 1e4, 4e4])
    inputs, at = (np.repeat(X[:, None], count, axis=1) for count in (2, 3))
    inputs[:, 1, 1] = at[:, 2, 1] = 0.9
    rows = [Followed.of(BLADE, quantity, nodes) for quantity, nodes in ROWS]
    rows.append(Followed.mixed(BLADE, np.eye(3, BLADE.deformation_modes([TIP]).shape[2])))
    asked, known = [], history.Walk.known

    def counted(self: Any, x: np.ndarray) -> Any:
        asked.append(len(x))
        return known(self, x)

    def found(some: list[Followed]) -> list[history.Answer]:
        given = (BLADE, edges, inputs, marks, at, some)
        return history.follow(*given, doubt=doubt, late=late)

    alone = [found([one])[0] for one in rows]
    monkeypatch.setattr(history.Walk, "known", counted)
    together = found(rows)
    assert len(asked) == len(marks) + 2, "marks, and the edges on the way"
    for one, several in zip(alone, together, strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(one, several, strict=True))
    assert len({mean.tobytes() for mean, _, _ in together}) == len(rows)


def test_scales_of_all_rows_at_once_are_those_of_one_row_to_the_last_bit() -> None:
    """By numpy's own interpolation; at instants, between, before and after them."""
    clock, k = np.sort(RNG.normal(size=9)), RNG.normal(size=(9, 5))
    own = RNG.normal(size=(40, 5)) * 2.0
    for at in (own, own[:, :1], clock[:, None]):
        each = np.broadcast_to(at, (len(at), 5))
        rows = [np.interp(each[:, r], clock, k[:, r]) for r in range(5)]
        assert np.array_equal(Scales(clock, k)(at), np.stack(rows, axis=1))


def followed(run: dict[str, Any], quantity: str, nodes: list[int] | None, parts: int = 8) -> Any:
    """Mean and sd (T, R) at the instants after 0 by the rule."""
    courses = {name: Course.of(given) for name, given in run["inputs"].items()}
    ends = {end for piece in pieces(courses, TIMES[-1], parts) for end in piece}
    edges = np.array(sorted(ends | set(TIMES.tolist())))
    held = [[courses[n].mean(a, b) for n in NAMES] for a, b in pairwise(edges)]
    mean, sd = follow(edges, np.array([held]), quantity, nodes)
    at = np.searchsorted(edges, TIMES[1:]) - 1
    return mean[0, at], sd[0, at]


def errors(quantity: str, nodes: list[int] | None, column: int | None) -> Any:
    """Relative errors (histories, T) from 8,000 h on, and what the rule says of them."""
    off, said = [], []
    for run in KEPT["runs"]:
        mean, sd = followed(run, quantity, nodes)
        true = np.array(run[quantity])[1:]
        true = true if column is None else true[:, column]
        off.append(mean[1:, 0] / true[1:] - 1)
        said.append(sd[1:, 0] / true[1:])
    return np.array(off), np.array(said)


@pytest.mark.parametrize(("quantity", "nodes"), ROWS)
def test_inputs_that_do_not_change_give_the_surrogate_itself(
    quantity: str, nodes: list[int] | None
) -> None:
    edges = np.array([0.0, 700.0, 8e3, 9e3, 5e4])
    mean, sd = follow(edges, np.repeat(X[:, None], 4, axis=1), quantity, nodes)
    whole, spread = BLADE.predict(X, quantity, edges[1:], nodes)
    assert mean == pytest.approx(whole.reshape(mean.shape), rel=1e-6)
    own = np.hypot(spread.reshape(mean.shape), history.FOLLOWED * np.abs(mean))
    assert np.all(sd < 1.6 * own)
    assert np.all(sd > 0.6 * own)


def test_a_piece_in_two_is_the_same_piece() -> None:
    inputs = np.repeat(X[:, None], 2, axis=1)
    inputs[:, 1, 1] = 0.9
    once, _ = follow(np.array([0.0, 1e4, 3e4]), inputs, "elongation")
    twice, _ = follow(np.array([0.0, 1e4, 2e4, 3e4]), inputs[:, [0, 1, 1]], "elongation")
    assert twice[:, [0, 2]] == pytest.approx(once, rel=1e-9)


def test_what_is_found_at_one_hour_depends_on_no_other() -> None:
    edges, marks = np.array([0.0, 1e4, 2e4]), np.array([5e3, 1e4, 1.5e4, 3e4])
    inputs, rows = np.repeat(X[:, None], 2, axis=1), [Followed.of(BLADE, "elongation", None)]
    inputs[:, 1, 1] = 0.9
    last = np.repeat(X[:, None], 4, axis=1)
    last[:, 2:, 1] = 0.9
    together = history.follow(BLADE, edges, inputs, marks, last, rows)[0][0]
    for m in range(4):
        alone = history.follow(BLADE, edges, inputs, marks[[m]], last[:, [m]], rows)[0][0]
        assert np.array_equal(alone[:, 0], together[:, m])


def test_elongation_follows_the_finite_elements() -> None:
    """Surrogate and rule together, of what has grown; a constant blade would be up to half off."""
    off, said = errors("elongation", None, None)
    assert np.median(np.abs(off)) < 0.006
    assert np.abs(off).max() < 0.03
    assert np.mean(np.abs(off) < 2 * said) > 0.8


@pytest.mark.parametrize(
    ("quantity", "nodes", "column"), [("ceeq", [CRITICAL], 1), ("creep_damage", [CRITICAL], 1)]
)
def test_strain_and_damage_at_a_node_follow(quantity: str, nodes: list[int], column: int) -> None:
    off, _ = errors(quantity, nodes, column)
    assert np.median(np.abs(off)) < 0.015
    assert np.abs(off).max() < 0.08


def test_a_field_follows_within_hundredths_of_a_millimetre() -> None:
    for run in KEPT["runs"]:
        mean, _ = followed(run, "deformation", [TIP])
        true = np.array(run["deformation"])[1:, 0]
        assert np.abs(mean - true).max() < 0.02 * np.abs(true).max() + 0.005


def test_hardening_by_time_is_far_worse(monkeypatch: pytest.MonkeyPatch) -> None:
    """The negative control: t* = the hour itself, whatever has crept."""
    right = np.abs(errors("elongation", None, None)[0][:, -1])
    hours = iter(())

    def by_the_clock(curve: Any, weights: Any, strain: Any, *more: Any) -> Any:
        return np.full(strain.shape, np.log(max(next(hours), clock.EARLIEST_H)))

    wrong = []
    monkeypatch.setattr(history, "clock", by_the_clock)
    for run in KEPT["runs"]:
        courses = {name: Course.of(given) for name, given in run["inputs"].items()}
        ends = {end for piece in pieces(courses, TIMES[-1], 8) for end in piece}
        # asked once on the way to a mark, once on the way to the next edge
        hours = iter(np.repeat(sorted(ends | set(TIMES.tolist())), 2))
        mean, _ = followed(run, "elongation", None)
        wrong.append(abs(mean[-1, 0] / run["elongation"][-1] - 1))
    assert np.median(wrong) > 5 * np.median(right)


def test_a_node_remembers_itself_and_not_the_mean(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mutant: the mean CEEQ as the memory of a node's. Largest and rms error of CEEQ grow."""
    right = errors("ceeq", [CRITICAL], 1)[0]
    whole = Followed.of

    def by_the_mean(*asked: Any) -> Followed:
        return replace(whole(*asked), own_clock=False)

    monkeypatch.setattr(Followed, "of", staticmethod(by_the_mean))
    wrong = errors("ceeq", [CRITICAL], 1)[0]
    assert np.abs(wrong).max() > 1.4 * np.abs(right).max()
    assert np.sqrt(np.mean(wrong**2)) > 1.2 * np.sqrt(np.mean(right**2))


def test_what_cannot_be_followed_is_refused() -> None:
    outside = np.repeat(X[:1, None], 2, axis=1)
    outside[:, 1, 1] = 1.3
    with pytest.raises(RangeError, match="t1t_rate"):
        follow(np.array([0.0, 1e3, 2e3]), outside, "elongation")
    with pytest.raises(InputError, match="edges"):
        follow(np.array([0.0, 1e3]), np.repeat(X[:, None], 2, axis=1), "elongation")
    with pytest.raises(InputError, match="mises"):
        follow(np.array([0.0, 1e3]), X[:, None], "mises", [TIP])
    cooled = np.repeat(X[:1, None], 2, axis=1)
    cooled[0] = [[0.7, 1.0, 0.0, 3.0], [1.3, 0.8, 0.0, -3.0]]
    with pytest.raises(RangeError, match="longer runs"):
        follow(np.array([0.0, 4e4, 5e4]), cooled, "elongation")


@pytest.mark.parametrize(("quantity", "nodes"), ROWS)
def test_a_memory_that_is_reached_late_goes_on_slowly_and_is_kept(
    quantity: str, nodes: list[int] | None
) -> None:
    """Hot, then so cold that the strain would take longer than three times the runs, then hot as
    before: hardly anything grows while it is cold, and all goes on as if that had not been."""
    hot, cold = [0.7, 1.0, 0.0, 3.0], [1.3, 0.8, 0.0, -3.0]
    edges = np.array([0.0, 4e4, 5e4, 6e4])
    mean, _ = follow(edges, np.array([[hot, cold, hot]]), quantity, nodes, late=True)
    never, _ = follow(np.array([0.0, 4e4, 5e4]), np.array([[hot, hot]]), quantity, nodes)
    before, cooled, again = mean[0]
    assert before == pytest.approx(never[0, 0], rel=1e-9)
    grown = never[0, 1] - never[0, 0]
    little = 0.04 * np.abs(grown).max()
    assert np.abs(cooled - before).max() < little
    assert again - cooled == pytest.approx(grown, abs=little)
    reached, _ = follow(edges, np.array([[hot, hot, hot]]), quantity, nodes, late=True)
    plain, _ = follow(edges, np.array([[hot, hot, hot]]), quantity, nodes)
    assert np.array_equal(reached, plain), "nothing changes where it is reached"


@pytest.mark.parametrize("form", ["raw", "log"])
def test_a_quantity_that_does_not_grow_with_creep_is_refused_with_its_name(form: Any) -> None:
    parts = {**BLADE.parts, "elongation": replace(BLADE.parts["elongation"], form=form)}
    other = replace(BLADE, parts=parts)
    with pytest.raises(InputError, match=f"elongation.*learnt as '{form}'"):
        Followed.of(other, "elongation", None)
    Followed.of(other, "ceeq", [CRITICAL])


def test_beyond_the_runs_the_doubt_grows_with_what_grows_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Up to the last instant nothing of it; beyond, its share of what grew there."""
    horizon = float(TIMES[-1])
    edges, held = np.array([0.0, horizon, 1.5 * horizon]), np.repeat(X[:, None], 2, axis=1)
    mean, sd = follow(edges, held, "elongation")
    monkeypatch.setattr(history, "EXTRAPOLATED", 0.0)
    plain, before = follow(edges, held, "elongation")
    np.testing.assert_array_equal(mean, plain)
    np.testing.assert_allclose(sd[:, 0], before[:, 0], rtol=1e-9)
    grown = mean[:, 1] - mean[:, 0]
    rest = np.sqrt(sd[:, 1] ** 2 - before[:, 1] ** 2)
    assert np.all(rest > 0.012 * grown)
    assert np.all(sd[:, 1] < before[:, 1] + 1.01 * 0.012 * grown)
