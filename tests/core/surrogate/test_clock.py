"""When a memory is reached: exact for a power law, and whatever way a surrogate's curve bends."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from core.errors import RangeError
from core.model import rotor_blade_wide
from core.surrogate import clock as clocks
from core.surrogate.clock import BEYOND, EARLIEST_H, STEPS, clock, unreached
from core.surrogate.driven import Driven
from core.surrogate.followed import Curves, Followed

LOG_T = np.log(np.geomspace(1.0, 5e4, 12))
POWER = Curves(
    CubicSpline(LOG_T, np.stack([np.ones(12), LOG_T], axis=1)),
    float(LOG_T[0]),
    float(LOG_T[-1]),
    np.zeros((1, 2, 1)),
    slice(0, 1),
)
MANY = 1500
RNG = np.random.default_rng(2)


def left(curve: Curves, w: np.ndarray, strain: np.ndarray, log_t: np.ndarray) -> np.ndarray:
    """log of the strain that is reached at these times over what is wanted."""
    return np.asarray(log_t + curve(w, log_t) - np.log(strain))


def test_a_power_law_is_solved_exactly() -> None:
    """E = A t^m, so that t* = (e / A)^(1/m), within the runs and beyond them."""
    m, log_a = RNG.uniform(0.3, 3.0, 50), RNG.uniform(-20.0, -8.0, 50)
    wanted = RNG.uniform(np.log(2.0), np.log(BEYOND * 5e4) - 0.01, 50)
    w = np.stack([log_a, m - 1.0], axis=1)[:, :, None]
    found = clock(POWER, w, np.exp(log_a + m * wanted)[:, None])
    assert found[:, 0] == pytest.approx(wanted, abs=1e-10)
    for near in (np.full((50, 1), -20.0), wanted[:, None] + 1.0):
        again = clock(POWER, w, np.exp(log_a + m * wanted)[:, None], False, near)
        assert again == pytest.approx(found, abs=1e-10)


def test_what_has_not_grown_is_at_the_beginning_and_what_is_never_reached_is_told() -> None:
    w = np.array([[-10.0, 0.0], [-10.0, 0.0]])[:, :, None]
    nothing = clock(POWER, w, np.array([[0.0], [np.exp(-10.0) * 100.0]]))
    assert nothing[:, 0] == pytest.approx([np.log(EARLIEST_H), np.log(100.0)])
    assert np.array_equal(clock(POWER, w, np.zeros((2, 1))), np.full((2, 1), np.log(EARLIEST_H)))
    far = np.full((2, 1), np.exp(-10.0) * 1e9)
    with pytest.raises(RangeError, match="3 times the horizon"):
        clock(POWER, w, far)
    with pytest.raises(RangeError, match="3 times the horizon"):
        clock(POWER, w, far, False, np.full((2, 1), 5.0))
    for near in (None, np.full((2, 1), 5.0)):
        assert clock(POWER, w, far, True, near)[:, 0] == pytest.approx(np.log(BEYOND * 5e4))


def test_a_strain_that_is_less_in_the_end_was_reached_in_between() -> None:
    """log E = -8 + 0.1 s - 0.01 s^2 with s = log t: at s = 5 it has its most, and in the end it has
    less than what is asked for, which was reached at s = 3."""
    bent = Curves(
        CubicSpline(LOG_T, np.stack([np.ones(12), LOG_T, LOG_T**2], axis=1)),
        float(LOG_T[0]),
        float(LOG_T[-1]),
        np.zeros((1, 3, 1)),
        slice(0, 1),
    )
    w = np.array([[-8.0, 0.1 - 1.0, -0.01]])[:, :, None]
    strain = np.exp([[-8.0 + 0.3 - 0.09]])
    end = LOG_T[-1] + np.log(BEYOND)
    assert left(bent, w, strain, np.array([[end]]))[0, 0] < -0.2
    for near in (None, np.array([[2.0]]), np.array([[9.0]])):
        for late in (False, True):
            assert clock(bent, w, strain, late, near)[0, 0] == pytest.approx(3.0, abs=1e-8)
    most = np.exp([[-8.0 + 0.25 + 1e-6]])
    with pytest.raises(RangeError, match="3 times the horizon"):
        clock(bent, w, most)
    for near in (None, np.array([[4.0]])):
        found = clock(bent, w, most, True, near)
        assert found[0, 0] == end
        assert unreached(bent, found).all()
    both = np.concatenate([strain, most])
    assert clock(bent, np.repeat(w, 2, axis=0), both, True)[:, 0].tolist() == [
        clock(bent, w, strain, True)[0, 0],
        end,
    ]


def test_every_row_arrives_however_its_curve_bends_and_depends_on_no_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """CEEQ of nodes all over the blade, at inputs all over the wide runs, after other inputs: at
    the ends of the box some curves hardly rise for decades, where Newton's steps alone go round in
    circles."""
    model = rotor_blade_wide().surrogate
    assert isinstance(model, Driven)
    base, nodes = model.base, [7, 400, 1500, 2900]
    z = -np.cos(np.pi * RNG.random((MANY, len(base.inputs))))
    x, other = (base.low + 0.5 * (one + 1.0) * (base.high - base.low) for one in (z, 0.9 * z))
    rows = Followed.of(base, "ceeq", nodes).curves
    w, before = (
        rows.weights(base.process.mean(base.scaled(one), [rows.columns])[0]) for one in (x, other)
    )
    at = np.log(RNG.uniform(500.0, 5e4, (MANY, len(nodes))))
    strain = np.exp(at + rows(before, at))
    end = np.full(at.shape, rows.last + np.log(BEYOND))
    least = np.exp(end + rows(w, end))
    instants = [np.full(at.shape, one) for one in rows.spline.x]
    most = np.maximum.reduce([least, *(np.exp(one + rows(w, one)) for one in instants)])
    assert np.any((strain > least) & (strain <= most)), "some are reached and have less in the end"
    within = np.where(strain <= most, strain, least)
    assert 0 < np.mean(within < strain) < 0.02, "some are not reached"
    asked, both = [0], Curves.with_slope

    def counted(self: Curves, *given: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        asked[0] += 1
        return both(self, *given)

    monkeypatch.setattr(Curves, "with_slope", counted)
    found = clock(rows, w, strain, True)
    assert asked[0] < STEPS
    assert np.abs(left(rows, w, within, found)).max() < 1e-9
    near = found + RNG.normal(size=found.shape)
    again = clock(rows, w, strain, True, near)
    assert np.abs(left(rows, w, within, again)).max() < 1e-9
    some = RNG.permutation(MANY)[:37]
    assert np.array_equal(clock(rows, w[some], strain[some], True), found[some])


def test_a_curve_and_its_slope_are_those_of_the_spline() -> None:
    """Before, at, between and beyond the instants; one time for all rows, or one each."""
    w = RNG.normal(size=(9, 2, 3))
    one = np.array([-4.0, *LOG_T[[0, 3, 11]], 2.2, 7.7, 10.0, 11.9, 12.4])[:, None]
    for at in (one, one + RNG.normal(size=(9, 3))):
        g, slope = POWER.with_slope(w, at)
        assert g == pytest.approx(POWER(w, at), abs=1e-12)
        each = np.broadcast_to(at, g.shape)
        assert slope == pytest.approx(np.where(each >= POWER.first, w[:, 1], 0.0), abs=1e-9)


def test_nodes_of_a_field_rest_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Together they take the steps of the slowest: of 5,600 nodes at inputs all over the runs 45,
    where most need four."""
    model = rotor_blade_wide().surrogate
    assert isinstance(model, Driven)
    base = model.base
    rows = Followed.of(base, "ceeq", range(0, base.node_count, 14)).curves
    z = RNG.uniform(-1.0, 1.0, (2, 3, len(base.inputs)))
    w, before = (
        rows.weights(base.process.mean(base.scaled(x), [rows.columns])[0])
        for x in base.low + 0.5 * (z + 1.0) * (base.high - base.low)
    )
    at = np.full((3, 1), np.log(2e4))
    strain = np.exp(at + rows(before, at))
    asked, both = [0], Curves.with_slope

    def counted(self: Curves, *given: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        asked[0] += given[1].size
        return both(self, *given)

    monkeypatch.setattr(Curves, "with_slope", counted)
    found, count = [], []
    for wide in (strain.shape[1] - 1, strain.shape[1]):
        monkeypatch.setattr(clocks, "WIDE", wide)
        found.append(clock(rows, w, strain, True, np.repeat(at, strain.shape[1], axis=1)))
        count.append(asked[0] / strain.size)
        asked[0] = 0
    assert found[0] == pytest.approx(found[1], abs=1e-7)
    assert count[0] < 8 < count[1], "values asked for, of each"
