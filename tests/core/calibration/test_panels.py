"""Integrals of exp(f) panel by panel against exact ones."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.special import log_ndtr

from core.calibration.panels import GL_X, LANES, LAST, MOST, POINTS, laid_out, next_panels, take

Array = NDArray[np.float64]


def integral(
    f: Callable[[Array], Array], inner: list[float], split: float = 0.05
) -> tuple[Array, int]:
    """log ∫ exp f over [−1, 1] on all lanes, and the panels that were looked at."""
    panels, waiting = np.empty((MOST, 3, LANES)), np.empty(LANES, dtype=np.int64)
    half, mid, out = np.empty(LANES), np.empty(LANES), np.zeros(LANES)
    peak, values, turns = np.full(LANES, -math.inf), np.empty((POINTS, LANES)), 0
    for i in range(LANES):
        breaks = np.array([-1.0, 1.0, *inner, 0.0])
        waiting[i] = laid_out(breaks, 2 + len(inner), 0.01, panels, i)
    while next_panels(panels, waiting, half, mid) > 0:
        for n in range(POINTS):
            values[n] = f(mid + half * GL_X[n])
        take(values, half, mid, split, panels, waiting, out, peak)
        turns += 1
    return peak + np.log(out), turns


def test_a_normal_density_needs_one_panel() -> None:
    sds = np.linspace(0.2, 3.0, LANES)
    found, turns = integral(lambda x: -0.5 * ((x - 0.1) / sds) ** 2, [])
    exact = [
        sd
        * math.sqrt(2 * math.pi)
        * (math.erf(0.9 / sd / 2**0.5) + math.erf(1.1 / sd / 2**0.5))
        / 2
        for sd in sds
    ]
    assert turns == 1
    assert found == pytest.approx(np.log(exact), abs=1e-4)


@pytest.mark.parametrize("width", [0.5, 0.1, 0.02])
def test_a_plateau_that_falls_off_is_split_until_it_is_known(width: float) -> None:
    """log Phi((0.2 − x) / width), the shape where a mode runs into a bound."""
    inner = [0.2 - 4 * width, 0.2 + 4 * width] if width < 0.15 else []
    found, turns = integral(lambda x: log_ndtr((0.2 - x) / width), inner)
    exact = quad(lambda x: math.exp(log_ndtr((0.2 - x) / width)), -1, 1, points=[0.2])[0]
    assert found == pytest.approx(np.full(LANES, math.log(exact)), abs=3e-3)
    assert turns <= 12


def test_a_bend_is_found_only_by_splitting() -> None:
    """Two slopes that meet: without splits the integral would be off."""

    def f(x: Array) -> Array:
        return np.where(x < 0.37, 6.0 * (x - 0.37), -30.0 * (x - 0.37))

    exact = math.log((1 - math.exp(-6 * 1.37)) / 6 + (1 - math.exp(-30 * 0.63)) / 30)
    rough, one = integral(f, [], split=1e9)
    found, turns = integral(f, [])
    assert one == 1
    assert abs(rough[0] - exact) > 0.1
    assert turns > 4
    assert found == pytest.approx(np.full(LANES, exact), abs=0.01)


def test_thin_panels_join_their_neighbours() -> None:
    panels = np.empty((MOST, 3, LANES))
    breaks = np.array([-1.0, 1.0, 0.0, 0.001, 0.5])
    assert laid_out(breaks, 5, 0.01, panels, 3) == 3
    assert sorted(panels[:3, 0, 3].tolist()) == [-1.0, 0.0, 0.5]


def test_a_lane_that_is_done_waits_for_the_others() -> None:
    lanes = np.arange(LANES)

    def f(x: Array) -> Array:
        return np.where(lanes == 5, -40.0 * np.abs(x - 0.3), 0.0 * x)

    found, turns = integral(f, [])
    assert turns > 3
    others = np.delete(found, 5)
    assert others == pytest.approx(np.full(LANES - 1, math.log(2.0)), abs=1e-9)
    assert found[5] == pytest.approx(math.log(2 / 40), abs=0.07), "a cusp, split four times"


def test_a_last_coefficient_that_is_small_by_chance_is_not_believed() -> None:
    """A summit at one end, less its own fourth Legendre coefficient: the last one is zero, and the
    polynomial through the five points integrates to nats too much."""
    p4 = np.polynomial.legendre.Legendre.basis(4)

    def summit(x: Array) -> Array:
        return 38.0 * np.exp(-(((x + 1.0) / 0.35) ** 2))

    def f(x: Array) -> Array:
        return summit(x) - float(LAST @ summit(GL_X)) * p4(x)

    assert LAST @ f(GL_X) == pytest.approx(0.0, abs=1e-9)
    through = np.polynomial.legendre.Legendre.fit(GL_X, f(GL_X), POINTS - 1, domain=[-1, 1])
    exact = math.log(quad(lambda x: math.exp(f(x)), -1, 1, limit=400)[0])
    alone = math.log(quad(lambda x: math.exp(through(x)), -1, 1, limit=400)[0])
    assert abs(alone - exact) > 1.0, "one panel would not do"
    found, turns = integral(f, [])
    assert found == pytest.approx(np.full(LANES, exact), abs=3e-3)
    assert turns > 1
