"""Placements judged together: a belief about places without nodes is given up once one looked."""

from __future__ import annotations

import numpy as np
import pytest

from core.calibration.tried import Tried, judged, pool
from core.smc.particles import ess
from core.smc.placement import Proposal, moments, sobol

Array = np.ndarray


def curved(unit: Array) -> Array:
    """A bent ridge: no quadratic, and flat to one side."""
    x, y = (unit - 0.4).T / 0.05
    return np.asarray(-0.5 * x**2 - 0.5 * (y - 0.15 * x**2) ** 2)


def tried(mean: list[float], spread: float, n: int = 64, seed: int = 0) -> Tried:
    place = Proposal(np.array(mean), spread * np.eye(2))
    unit, log_q = place.nodes(sobol(n, 2, seed))
    return Tried(place, unit, curved(unit), log_q)


def test_the_mixture_of_placements_weighs_nodes_as_one_sample() -> None:
    """Moments of all nodes are the exact ones, also where each placement alone is aside."""
    left, right = tried([0.36, 0.4], 0.06, 512), tried([0.46, 0.44], 0.06, 512, 1)
    unit, log_p, log_q = pool([left, right])
    assert unit.shape == (1024, 2)
    assert log_p == pytest.approx(curved(unit))
    grid = (np.arange(500) + 0.5) / 500
    every = np.stack([v.ravel() for v in np.meshgrid(grid, grid)], axis=1)
    exact = np.exp(curved(every))
    middle, spread = moments(every, exact / exact.sum())
    w = np.exp(log_p - log_q)
    mean, cov = moments(unit, w / w.sum())
    assert mean == pytest.approx(middle, abs=0.004)
    assert cov == pytest.approx(spread, abs=4e-4)
    alone = pool([left])
    assert alone[2] == pytest.approx(left.log_q)


def test_a_narrow_placement_is_doubted_by_what_others_have_seen() -> None:
    aside, right = tried([0.4, 0.41], 0.02), tried([0.4, 0.42], 0.09)
    assert aside.share > 0.3, "its own weights are fair"
    share, _ = judged(aside, [aside, right])
    assert share < 0.5 * aside.share
    fair, further = judged(right, [aside, right])
    assert fair == pytest.approx(right.share, rel=0.3)
    assert further is not None
    unit, log_q = further.nodes(sobol(64, 2, 3))
    assert ess(curved(unit) - log_q) > 0.3 * 64


def test_where_no_surface_goes_through_the_nodes_tell() -> None:
    few = tried([0.4, 0.4], 0.05, 4)
    assert judged(few, [few]) == (few.share, None)
