"""Inputs that run in time where they would leave the runs: refused, or held at the runs' end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.archive import Input
from core.blade import BOUNDS, simulate, simulate_history
from core.builtin.plans import WIDER
from core.course import Course
from core.drift import Drift
from core.errors import InputError
from core.model import rotor_blade_wide
from core.surrogate import driven, fit
from core.surrogate.compile import fitting
from core.surrogate.driven import Driven
from core.surrogate.reach import check_reach, missed, run

COATING = Input("coating", 0.4, 1.3)
LOSS = Course.of([(0.0, 0.0), (100.0, -1.0)])
WEAR = Drift("wear", "coating", LOSS, "times")
HELD = replace(WEAR, held=True)
SHIPPED = rotor_blade_wide().surrogate
assert isinstance(SHIPPED, Driven)
RAMP = Course.of([(0.0, 0.0), (5e4, -1.0)])
WORN = Drift("wear", "tbc_thickness", RAMP, "times", held=True)
MODEL = Driven(
    SHIPPED.base, (WORN,), {**SHIPPED.ranges, "wear": (0.0, 0.8)}, SHIPPED.fixed, SHIPPED.anchor
)
TIMES = np.array([2.4e4, 5e4, 1e5])
LOW = next(i.low for i in SHIPPED.base.inputs if i.name == "tbc_thickness")


def test_what_leaves_the_runs_is_refused_unless_it_is_held() -> None:
    """A coating of 0.8 has room for a half, and one of 0.5 for a fifth."""
    for start, fits, too_much in ((0.8, 0.5, 0.51), (0.5, 0.2, 0.21)):
        check_reach(COATING, [start], [WEAR], {"wear": (0.0, fits)}, 100.0)
        with pytest.raises(InputError, match="leaves the runs"):
            check_reach(COATING, [start], [WEAR], {"wear": (0.0, too_much)}, 100.0)
        check_reach(COATING, [start], [HELD], {"wear": (0.0, too_much)}, 100.0)
        check_reach(COATING, [start], [WEAR, HELD], {"wear": (0.0, too_much)}, 100.0)


def test_what_starts_outside_is_refused_held_or_not() -> None:
    for one in (WEAR, HELD):
        with pytest.raises(InputError, match="leaves the runs"):
            check_reach(COATING, [0.3, 0.8], [one], {"wear": (0.0, 0.1)}, 100.0)


def test_an_input_runs_to_the_end_and_stays_there() -> None:
    now, a = np.full(3, 0.8), {"wear": np.array([0.0, 0.5, 1.0])}
    assert run(now, COATING, [HELD], a, 40.0, 60.0) == pytest.approx([0.8, 0.6, 0.4])
    assert run(now, COATING, [HELD], a, 80.0, 90.0) == pytest.approx([0.8, 0.46, 0.4])
    assert run(now, COATING, [WEAR], a, 80.0, 90.0) == pytest.approx([0.8, 0.46, 0.12])
    up = replace(HELD, shape=Course.of([(0.0, 0.0), (100.0, 1.0)]))
    assert run(now, COATING, [up], a, 80.0, 90.0) == pytest.approx([0.8, 1.14, 1.3])
    assert run(now, replace(COATING, name="other"), [HELD], a, 80.0, 90.0) is now


def test_drifts_that_are_not_held_have_the_digest_that_they_had() -> None:
    """Rotors that adopted an effect before are calibrated by that model."""
    assert "held" not in repr(WEAR)
    narrow = {**SHIPPED.ranges, "wear": (0.0, 0.3)}
    free = Driven(SHIPPED.base, (replace(WORN, held=False),), narrow, SHIPPED.fixed, SHIPPED.anchor)
    assert replace(free, drifts=(WORN,)).digest != free.digest
    assert WORN.to_json()["held"] is True
    assert "held" not in replace(WORN, held=False).to_json()
    assert Drift.from_json(WORN.to_json()) == WORN


def test_a_held_coating_is_one_whose_wear_stops() -> None:
    """At an hour where a piece begins, by a shape that is not held."""
    hour = 25_000.0
    a = (1.0 - LOW / 0.7) * 5e4 / hour
    stops = Drift("wear", "tbc_thickness", Course.of([(0.0, 0.0), (hour, -1.0)]), "times")
    short = replace(
        MODEL,
        drifts=(stops,),
        ranges={**SHIPPED.ranges, "tbc_thickness": (0.69, 1.3), "wear": (0.0, 0.42)},
    )
    x = np.array([[0.7, 0.92, 0.5, -0.5, a], [0.7, 0.85, 0.0, 0.0, a]])
    held, _ = MODEL.predict(x, "elongation", TIMES)
    x[:, 4] *= hour / 5e4
    stopped, _ = short.predict(x, "elongation", TIMES)
    assert held == pytest.approx(stopped, rel=3e-3), "its ramp has other pieces"


def test_a_held_coating_is_finite_elements_that_stop_there() -> None:
    """Worn to the runs' end by 33,333 h, elongation over that without wear.

    At their end the runs say little of their neighbourhood: a coating as thin as that from the
    start on is 2 to 5 % too long by the surrogate, and so is one that wore.
    """
    box = {**BOUNDS, **WIDER}
    coating, gas, a = 0.7, 0.9, 0.643
    at = (1.0 - LOW / coating) / a * 5e4
    assert 3.3e4 < at < 3.4e4
    own = {"tbc_thickness": coating, "t1t_rate": gas, "creep_transient": 0.0, "creep_steady": 0.0}
    hours = np.array([0.0, *TIMES[:2]])
    whole = simulate(own, "coarse", time_h=hours).elongation[1:]
    course = own | {"tbc_thickness": [(0.0, coating), (at, LOW), (1.5e5, LOW)]}
    worn = simulate_history(course, "coarse", time_h=hours, bounds=box).elongation[1:]
    x = np.array([[own[i.name] for i in MODEL.inputs[:4]] + [v] for v in (0.0, a)])
    mean, _ = MODEL.predict(x, "elongation", TIMES[:2])
    off = mean[1] / mean[0] / (worn / whole) - 1.0
    assert np.all(np.abs(off) < [0.005, 0.03])
    assert np.all(worn / whole > [1.25, 1.75]), "the wear tells"


def test_polynomials_of_a_held_input_say_how_far_they_miss() -> None:
    """At hours when nobody's coating is at the end they hardly miss; later they do, and say it."""
    rng = np.random.default_rng(5)
    low, high = np.array([(i.low, i.high) for i in MODEL.inputs]).T
    x = low + rng.random((150, len(low))) * (high - low)
    exact, own = MODEL.predict(x, "elongation", TIMES)
    made = MODEL.response("elongation", TIMES)
    mean, sd = made.evaluate(x)
    off = np.sqrt(np.mean((mean / exact - 1.0) ** 2, axis=0))
    said = np.sqrt(np.mean((sd / exact) ** 2 - (own / exact) ** 2, axis=0))
    assert off[0] < 0.004
    assert off[2] > 0.015
    assert said == pytest.approx(off, rel=0.5)


def test_polynomials_of_what_is_not_held_are_as_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    free = replace(
        MODEL, drifts=(replace(WORN, held=False),), ranges={**MODEL.ranges, "wear": (0.0, 1 / 3)}
    )

    def never(*_: object) -> np.ndarray:
        raise AssertionError("asked for how far they miss")

    monkeypatch.setattr(fit, "missed", never)
    free.response("elongation", TIMES[:1])
    with pytest.raises(AssertionError, match="asked for"):
        replace(MODEL).response("elongation", TIMES[:1])


def test_missed_is_the_mean_square_of_what_is_left() -> None:
    z = np.array([[-1.0], [0.0], [1.0]])
    y, scale = np.array([[1.0], [2.0], [4.0]]), np.array([[1.0], [2.0], [4.0]])
    fitted = np.array([[1.0, np.log(2.0)], [0.0, np.log(2.0)]])  # A = 1, log B linear: exact
    assert missed(z, 1, fitted, y, scale) == pytest.approx([0.0], abs=1e-30)
    fitted[0, 0] = 1.1
    assert missed(z, 1, fitted, y, scale) == pytest.approx([0.01])


def test_an_error_at_half_of_the_points_is_that_at_all_of_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(6)
    low, high = np.array([(i.low, i.high) for i in MODEL.inputs]).T
    x = low + rng.random((60, len(low))) * (high - low)
    mean, few = replace(MODEL).response("elongation", TIMES[:2]).evaluate(x)
    monkeypatch.setattr(driven, "FEWER", 1)
    again, every = replace(MODEL).response("elongation", TIMES[:2]).evaluate(x)
    assert np.allclose(mean, again, rtol=1e-9)  # their points are the same
    assert np.sqrt(np.mean(np.log(few / every) ** 2)) < 0.05


def test_rows_fitted_at_half_of_the_points_miss_what_they_miss_at_all(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What polynomials cannot follow is their error, not how many points they are fitted at."""
    rng = np.random.default_rng(7)
    low, high = np.array([(i.low, i.high) for i in MODEL.inputs]).T
    x = low + rng.random((driven.MANY - 1, len(low))) * (high - low)
    followed, sd = MODEL.predict(x, "elongation", TIMES[1:2])  # so few are not compiled

    def missed_by(share: int, fewer: int) -> tuple[float, float]:
        monkeypatch.setattr(fit, "SHARE", share)
        monkeypatch.setattr(driven, "FEWER", fewer)
        mean, told = replace(MODEL).response("elongation", TIMES[1:2]).evaluate(x)
        off = np.std(np.log(told / sd))  # bends add to it: its size is not the question
        return float(np.sqrt(np.mean((mean / followed - 1.0) ** 2))), float(off)

    fewer, every = missed_by(fit.SHARE, driven.FEWER), missed_by(1, 1)
    assert fewer[0] < 1.1 * every[0] < 0.01
    assert fewer[1] < 1.15 * every[1]


@pytest.mark.parametrize("inputs", range(1, 8))
def test_an_error_is_fitted_to_three_points_a_term(inputs: int) -> None:
    points, factor = fitting(inputs, 5, fit.SHARE * driven.FEWER)
    assert len(points) >= 3 * len(factor)
