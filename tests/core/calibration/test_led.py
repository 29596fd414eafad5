"""Glances and draws whose surveys lead one another: as good as those by blocks on their own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from core.builtin import inspection_plan
from core.calibration import kernel, message, survey, volumes
from core.calibration.message import BladeMessage
from core.calibration.space import shared_space
from core.calibration.target import assemble
from core.calibration.vector import LANES
from core.model import rotor_blade
from core.smc.placement import sobol
from core.validation.paper import readings_of

Array = NDArray[np.float64]
NEAR = 25.0  # nats below a blade's best node that count


@pytest.fixture(scope="module")
def messages() -> list[BladeMessage]:
    """Some blades of the paper's plan: read once to four times, and the one that was scanned."""
    model, names = rotor_blade(), tuple(inspection_plan.blades())
    readings = readings_of(inspection_plan.load(), names)
    own = [[r for r in readings if r.blade == b] for b in names]
    rows = [made for some in own if (made := assemble(model, some))]
    space = shared_space(model, rows)
    rows.sort(key=lambda one: -len(one.y))
    return [BladeMessage(model, one, space, {}) for one in [*rows[:2], *rows[5::12]]]


def nodes(one: BladeMessage, low: float, high: float) -> Array:
    unit = low + (high - low) * sobol(256, one.space.dim, 5)
    return np.asarray(unit[np.argsort(unit[:, 0], kind="stable")])


def alone(one: BladeMessage, unit: Array) -> Array:
    """Rough column of each block on its own: nothing is led."""
    blocks = [unit[k : k + LANES] for k in range(0, len(unit), LANES)]
    return np.concatenate([one.column(block, rough=True) for block in blocks])


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (0.3, 0.8), (0.5, 0.6)])
def test_a_led_glance_is_one_by_itself(
    messages: list[BladeMessage], low: float, high: float
) -> None:
    """Over the whole box, where neighbours differ most, and near a posterior."""
    off = list[Array]()
    for one in messages:
        unit = nodes(one, low, high)
        led, own = one.column(unit, rough=True), alone(one, unit)
        off.append((led - own)[own > own.max() - NEAR])
    every = np.abs(np.concatenate(off))
    assert every.max() > 0.0, "negative control: something was led"
    assert np.mean(every > 0.05) < 0.01
    assert np.sqrt(np.mean(every**2)) < 0.1


def test_led_draws_weigh_as_much_as_the_message(messages: list[BladeMessage]) -> None:
    """A range taken over and never looked beyond would lose what lies outside of it."""
    sums = list[Array]()
    for one in messages:
        unit = nodes(one, 0.4, 0.7)
        exact = one.column(unit)
        _, log_w = one.draws(unit, 120, np.random.default_rng(0), exact)
        sums.append(np.exp(log_w).sum(axis=1)[exact > exact.max() - NEAR])
    every = np.concatenate(sums)
    assert np.mean(every) == pytest.approx(1.0, abs=4 * np.std(every) / np.sqrt(len(every)))
    assert np.std(every) < 0.1


def narrowed(ends: Callable[[Array], Array], messages: list[BladeMessage]) -> Array:
    """Glances at the scanned blade's nodes, led by a survey whose ranges `ends` has changed."""
    one = messages[0]
    blocks, p = one.blocks(nodes(one, 0.5, 0.6)), one.packed
    size = 216 * len(p.ka2) * LANES
    ca, cb, cv = np.empty(size), np.empty(size), np.empty(size)
    seen, plan = np.empty((survey.FIELDS, survey.STATIONS, LANES)), np.empty((3, LANES))
    out = np.empty((2, LANES))
    kernel.collapsed(*p.rows, blocks.factors[0], p.ka2, p.marked, ca, cb, cv)
    given = (ca, cb, cv, blocks.y[0].ravel(), blocks.s2[0].ravel(), p.ka2, p.marked, seen, plan)
    volumes.volume_glances(*given, False, out[0])
    assert np.all(plan[survey.HIGH] - plan[survey.LOW] < 2.0), "its range is a part of the box"
    plan[: survey.BEST] = ends(plan[: survey.BEST].copy())
    volumes.volume_glances(*given, True, out[1])
    return np.asarray(out[1] - out[0])


def test_where_a_range_that_was_taken_over_is_too_small_the_survey_begins_anew(
    messages: list[BladeMessage],
) -> None:
    def aside(ends: Array) -> Array:
        width = ends[1] - ends[0]
        return np.asarray(np.clip(ends + 0.9 * width, -1.0, 1.0))

    assert np.abs(narrowed(lambda ends: ends, messages)).max() < 0.2
    assert np.abs(narrowed(aside, messages)).max() < 0.2


@pytest.mark.parametrize("parts", [1, 2, 3, 5])
def test_what_comes_out_does_not_depend_on_who_works_beside_whom(
    messages: list[BladeMessage], parts: int
) -> None:
    one = messages[-1]
    unit = nodes(one, 0.3, 0.8)
    exact = one.column(unit)
    rng = np.random.default_rng
    here = [one.column(unit, rough=True, parts=parts), *one.draws(unit, 20, rng(1), exact, parts)]
    there = [one.column(unit, rough=True, parts=1), *one.draws(unit, 20, rng(1), exact, 1)]
    for a, b in zip(here, there, strict=True):
        assert np.array_equal(a, b)
    assert message.split(7, parts, 2)[-1].stop == 7
