"""Messages of blades that were read once and alike, from one table."""

from __future__ import annotations

import random
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from numpy.typing import NDArray

from core.calibration.alike import (
    DOUBT,
    MANY_ALIKE,
    AlikeMessage,
    Family,
    family_key,
    gathered,
)
from core.calibration.columns import KeptColumns, columns
from core.calibration.layout import monomials_of
from core.calibration.message import BladeMessage
from core.calibration.online import RotorSpec, RotorState, Workspace, begun, update
from core.calibration.tetrahedra import CORNERS, histogram
from core.model import Model, rotor_blade
from core.observation import Inspection

Array = NDArray[np.float64]
HOUR = 8_000.0


@lru_cache
def blade_model() -> Model:
    return rotor_blade()


def readings(count: int, hour: float = HOUR) -> list[Inspection]:
    """Elongations [mm] of so many blades, within what the model can say at 8,000 h and beyond."""
    values = np.linspace(0.07, 0.5, count)
    return [
        Inspection(f"e{hour:.0f}-{k}", f"b{k:02d}", "elongation", hour, np.array([value]))
        for k, value in enumerate(values)
    ]


def rotor(count: int, seed: int = 0) -> RotorSpec:
    return RotorSpec("r", tuple(f"b{k:02d}" for k in range(count)), 500, seed)


@lru_cache
def blades(count: int) -> dict[str, BladeMessage]:
    made = begun(blade_model(), rotor(count), readings(count)).messages
    return {b: m for b, m in made.items() if isinstance(m, BladeMessage)}


def nodes(places: list[tuple[float, float]]) -> Array:
    """Of the unit box: share of T1T's prior, noise [mm]."""
    (low, high) = next(iter(blades(2).values())).space.priors[1].box
    return np.array([[t, (np.log(noise) - low) / (high - low)] for t, noise in places])


def read_as(message: BladeMessage, value: float) -> BladeMessage:
    rows = replace(message.rows, y=np.array([value]), digest=f"read as {value!r}")
    return BladeMessage(message.model, rows, message.space, message.fixed)


def shares(y: Array, bins: int, step: int = 1) -> tuple[Array, Array]:
    """Of answers on a grid: shares by bins, and the bins' edges."""
    out, variance = np.empty((3, bins)), np.empty((3, bins))
    low, width = float(y.min()), float(np.ptp(y)) / bins or 1.0
    histogram(y, np.full(y.shape, 0.5), step, CORNERS, low, width, out, variance)
    np.testing.assert_allclose(variance[out > 0], 0.5, rtol=1e-9)
    return out.sum(axis=0), low + width * np.arange(bins + 1)


def grid(*cells: int) -> list[Array]:
    return np.meshgrid(*(np.linspace(-1, 1, n + 1) for n in cells), indexing="ij")


@pytest.mark.parametrize("slopes", [(1.0, 0.3, -0.2), (0.0, 0.5, 0.0), (0.2, 0.2, 0.2)])
def test_shares_of_a_linear_answer_are_exact(slopes: tuple[float, ...]) -> None:
    """Against the distribution of a sum of uniform variables, by its signed corners."""
    y = sum(c * x for c, x in zip(slopes, grid(4, 2, 6), strict=True))
    found, edges = shares(np.asarray(y), 37)
    moving = [abs(c) for c in slopes if c != 0.0]
    corners = np.array(np.meshgrid(*([[-1, 1]] * len(moving)))).reshape(len(moving), -1)
    at, sign = np.array(moving) @ corners, np.prod(corners, axis=0)
    power = len(moving)
    below = np.maximum(edges[:, None] - at, 0.0) ** power @ sign
    below *= (-1.0) ** power / (np.prod([2 * c for c in moving]) * np.prod(range(1, power + 1)))
    np.testing.assert_allclose(np.cumsum(found), below[1:], atol=1e-9)


def test_a_constant_answer_is_in_one_bin() -> None:
    found, _ = shares(np.full((3, 3, 3), 2.5), 8)
    assert found.tolist() == [pytest.approx(1.0), *[0.0] * 7]


def test_the_error_is_of_second_order() -> None:
    def below(cells: int, step: int = 1) -> Array:
        a, b, c = grid(cells, cells, cells)
        return np.cumsum(shares(np.exp(0.8 * a + 0.4 * b) * (1 + 0.3 * c), 64, step)[0])

    dense = (4 * below(64) - below(32)) / 3
    errors = [np.sqrt(np.mean((below(n) - dense) ** 2)) for n in (8, 16)]
    assert 3.3 < errors[0] / errors[1] < 4.8
    assert below(16, 2).tolist() == below(8).tolist()


def dense(message: BladeMessage, unit: Array, points: tuple[int, int, int]) -> float:
    """log m at one node (1, d) by a product of Gauss rules of so many points."""
    y, s2, rest = message.readings(unit)
    p, family = message.packed, Family(message)
    (factors,) = factors_of(family, unit)
    x, w = zip(*(np.polynomial.legendre.leggauss(n) for n in points), strict=True)

    def polynomial(c: Array) -> Array:
        table = np.zeros((6, 6, 6))
        for q, (i, j, k) in enumerate(p.exponents):
            table[i, j, k] += c[q] * factors[q]
        return np.polynomial.polynomial.polygrid3d(*x, table)

    a, b, v = (polynomial(c[0]) for c in (p.a, p.b, p.v))
    variance = s2[0, 0] + np.exp(2 * b + v) * (p.ka2[0] + a**2 * p.kb2[0])
    likely = np.exp(-0.5 * (y[0, 0] - a * np.exp(b)) ** 2 / variance) / np.sqrt(variance)
    total = np.einsum("ijk,i,j,k->", likely, *w) / 8
    return float(np.log(total) - 0.5 * np.log(2 * np.pi) + rest[0] + message.offset)


def factors_of(family: Family, unit: Array) -> Array:
    m = family.of
    return monomials_of(m.model, m.rows, m.space, m.space.to_x(unit), m.fixed)


@pytest.mark.parametrize("noise", [0.002, 0.006])
def test_a_thin_sheet_is_seen_as_by_a_dense_rule(noise: float) -> None:
    unit = nodes([(0.55, noise)])
    message = next(iter(blades(2).values()))
    values = [0.085, 0.13, 0.21, 0.33, 0.5]
    alike = [read_as(message, value) for value in values]
    found = np.array(Family(message).columns(alike, unit))[:, 0]
    right = np.array([dense(m, unit, (60, 400, 200)) for m in alike])
    assert np.abs(found - right).max() < 0.003
    assert np.sqrt(np.mean((found - right) ** 2)) < 0.0015


def test_columns_by_table_are_those_by_quadrature() -> None:
    unit = nodes([(t, noise) for t in (0.45, 0.55, 0.65) for noise in (0.01, 0.03, 0.1)])
    messages = blades(MANY_ALIKE)
    table = gathered(messages, {})
    assert all(isinstance(m, AlikeMessage) for m in table.values())
    off = np.array(columns([*table.values()], unit, rough=False))
    off -= np.array(columns([*messages.values()], unit, rough=False))
    assert np.any(off != 0.0)
    assert np.sqrt(np.mean(off**2)) < 0.001
    assert np.abs(off).max() < 0.02


def test_a_rough_look_takes_the_coarse_histogram_alone() -> None:
    """Off by what Richardson's correction is worth, and made at an eighth of the price."""
    unit = nodes([(t, noise) for t in (0.45, 0.55, 0.65) for noise in (0.02, 0.06)])
    messages = [*blades(MANY_ALIKE).values()]
    family = Family(messages[0])
    rough, exact = (np.array(family.columns(messages, unit, how)) for how in (True, False))
    inside = slice(4, 24)  # readings far from what the model can say are rough indeed
    off = (rough - exact)[inside]
    assert 0.0 < np.sqrt(np.mean(off**2)) < 0.03
    assert np.array_equal(rough, np.array(family.columns(messages, unit, True)))
    made = family.tables.values()
    assert sum(table.fine is None for table in made) == len(unit) == len(made) / 2
    alone = AlikeMessage(messages[5], family).column(unit, rough=True)
    assert alone.tolist() == rough[5].tolist()


def test_a_reading_that_the_table_does_not_resolve_is_left_to_the_quadrature() -> None:
    """Far outside of what the model can say, where a bin's width decides, and nowhere else."""
    unit = nodes([(0.55, 0.0012)])
    message = next(iter(blades(2).values()))
    family = Family(message)
    inside, outside = read_as(message, 0.2), read_as(message, 0.03)
    by_table = AlikeMessage(outside, family)
    assert by_table.column(unit).tolist() == outside.column(unit).tolist()
    assert AlikeMessage(inside, family).column(unit).tolist() != inside.column(unit).tolist()
    (table,) = family.tables.values()
    y, s2, rest = outside.readings(unit)
    value, correction = table.messages(y[:, 0], s2[:, 0])
    assert abs(correction[0]) > DOUBT
    assert abs(value[0] + rest[0] - outside.column(unit)[0]) > DOUBT


def test_a_table_that_is_too_coarse_is_doubted(monkeypatch: pytest.MonkeyPatch) -> None:
    unit, message = nodes([(0.55, 0.005)]), next(iter(blades(2).values()))
    for name, value in (("CELLS", (4, 2, 2)), ("BINS", 32)):
        monkeypatch.setattr(f"core.calibration.alike.{name}", value)
    alike = [read_as(message, value) for value in (0.09, 0.12, 0.2, 0.4)]
    found = Family(message).columns(alike, unit)
    assert [c.tolist() for c in found] == [m.column(unit).tolist() for m in alike]


def test_a_column_depends_on_no_company() -> None:
    unit = nodes([(t, noise) for t in (0.4, 0.55, 0.7) for noise in (0.0012, 0.004, 0.05)])
    messages = blades(MANY_ALIKE + 3)
    together = gathered(messages, {})
    all_of_them = columns([*together.values()], unit, rough=False)
    names = [*messages]
    random.Random(5).shuffle(names)
    others = gathered({b: messages[b] for b in names[:MANY_ALIKE]}, {})
    found = dict(zip(others, columns([*others.values()], unit, rough=False), strict=True))
    for blade, column in zip(together, all_of_them, strict=True):
        if blade in found:
            assert found[blade].tobytes() == column.tobytes()
    one = others[names[0]]
    apart = [columns([one], unit[k : k + 1], rough=False)[0][0] for k in (4, 0, 8)]
    assert apart == found[names[0]][[4, 0, 8]].tolist()


def test_few_blades_and_other_readings_are_left_as_they_are() -> None:
    messages = blades(MANY_ALIKE - 1)
    assert gathered(messages, {}) == messages
    twice = begun(blade_model(), rotor(2), readings(2) + readings(2, 16_000.0)).messages
    assert [family_key(m) for m in twice.values()] == [None, None]
    later = begun(blade_model(), rotor(2), readings(2, 16_000.0)).messages
    keys = {family_key(m) for m in (*later.values(), *blades(2).values())}
    assert len(keys) == 2
    assert None not in keys


def test_columns_by_table_and_by_quadrature_are_kept_apart() -> None:
    unit = nodes([(0.55, 0.003), (0.5, 0.004), (0.45, 0.02), (0.5, 0.05)])
    messages, known = blades(MANY_ALIKE), KeptColumns()
    table = known.gathered(messages)
    assert known.gathered(messages)["b00"].name == table["b00"].name != messages["b00"].name
    first, second = (known.all(some, unit, "exact") for some in (messages, table))
    assert any(first[b].tolist() != second[b].tolist() for b in messages)
    assert next(iter(known.families.values())).tables.keys() == {
        u.tobytes() + bytes(False) for u in unit
    }


def test_variances_of_the_surrogate_are_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a few places of a bin are far less certain than the others, their mean misleads."""
    unit = nodes([(0.02, 0.004)])
    reading = read_as(next(iter(blades(2).values())), 0.27)
    right = dense(reading, unit, (60, 300, 160))
    (found,) = AlikeMessage(reading, Family(reading)).column(unit)
    assert found == pytest.approx(right, abs=0.003)
    monkeypatch.setattr("core.calibration.alike.CLASSES", 1)
    monkeypatch.setattr("core.calibration.alike.DOUBT", np.inf)
    (misled,) = AlikeMessage(reading, Family(reading)).column(unit)
    assert abs(misled - right) > 0.01


def test_a_histogram_keeps_mean_and_variance_by_class() -> None:
    a, b, c = grid(8, 8, 8)
    s2 = np.exp(2.0 * c)
    y, share, variance = a + 0.1 * b, np.empty((4, 20)), np.empty((4, 20))
    histogram(y, s2, 1, CORNERS, -1.1, 0.11, share, variance)
    assert share.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(share.sum(axis=1), 0.25, atol=0.05)
    middle = np.exp(np.linspace(-1.5, 1.5, 4))
    np.testing.assert_allclose(
        np.sum(share * variance, axis=1) / share.sum(axis=1), middle, rtol=0.2
    )


@lru_cache
def sealed(count: int) -> RotorState:
    return update(blade_model(), rotor(count), readings(count))


def test_sealed_states_are_equal_in_any_order_of_arrival() -> None:
    count = MANY_ALIKE + 1
    shuffled = readings(count)
    random.Random(3).shuffle(shuffled)
    kept = Workspace()
    update(blade_model(), rotor(count), shuffled[:-2], workspace=kept)
    state = update(blade_model(), rotor(count), shuffled, workspace=kept)
    assert state.digest == sealed(count).digest


def test_a_family_that_becomes_too_small_leaves_nothing_behind() -> None:
    """The readings of one blade change the columns of others here, and with them their draws."""
    count = MANY_ALIKE
    model, all_of_them = blade_model(), [*readings(count), readings(1, 16_000.0)[0]]
    before = sealed(count)
    after = update(model, rotor(count), all_of_them, before)
    assert after.digest == update(model, rotor(count), all_of_them).digest
    back = update(model, rotor(count), readings(count), after)
    assert back.digest == before.digest
