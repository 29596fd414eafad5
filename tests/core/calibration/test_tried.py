"""Placements judged together: a belief about places without nodes is given up once one looked."""

from __future__ import annotations

import numpy as np
import pytest

from core.calibration.tried import Tried, judged, of_all, pool
from core.smc.particles import ess
from core.smc.placement import improved, moments, sobol
from core.smc.proposal import Proposal

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


# of rotor 278 of `study coverage mixed --seed 12`: the posterior is nearly normal, with these sds
MODE, SDS = np.array([0.258, 0.608, 0.505, 0.556]), np.array([0.023, 0.0103, 0.0017, 0.092])
PLACES = (  # spreads halved from turn to turn, and correlations that a few nodes had made up
    ([0.2656, 0.6094, 0.5044, 0.5625], [0.03125, 0.01105, 0.00098, 0.17678]),
    ([0.2578, 0.6074, 0.5051, 0.5625], [0.01562, 0.00552, 0.00049, 0.08839]),
    ([0.2578, 0.6064, 0.5049, 0.5469], [0.00781, 0.00276, 0.00024, 0.04419]),
    ([0.2500, 0.6094, 0.5056, 0.5625], [0.01562, 0.00552, 0.00049, 0.08839]),
)


def normal(unit: Array) -> Array:
    return np.asarray(-0.5 * np.sum(((unit - MODE) / SDS) ** 2, axis=1))


def astray(mean: list[float], sd: list[float]) -> Tried:
    chol = np.diag(sd)
    chol[2, :2] = 0.5 * sd[2], 0.75 * sd[2]
    chol[3, 1:3] = -0.5 * sd[3], 0.5 * sd[3]
    place = Proposal(np.array(mean), chol, (3,))
    unit, log_q = place.nodes(sobol(256, 4, 1))
    return Tried(place, unit, normal(unit), log_q)


def test_all_that_was_tried_tells_what_no_placement_alone_does() -> None:
    every = [astray(*one) for one in PLACES]

    def share(place: Proposal) -> float:
        unit, log_q = place.nodes(sobol(256, 4, 1))
        return ess(normal(unit) - log_q) / 256

    shares = [one.share for one in every]
    assert max(shares) < 0.15, "each of them would be called degenerate"
    alone = [improved(one.proposal, one.unit, one.log_p, one.log_q, 0.3) for one in every]
    followed = [share(place) for place in alone]
    assert share(of_all(every, 24.0)) > 0.4 > max(followed[1:])


def test_far_from_the_posterior_spreads_do_not_collapse_to_the_nearest_nodes() -> None:
    place = Proposal(MODE + np.array([10 * SDS[0], 0, 0, 0]), np.diag(0.7 * SDS), (3,))
    unit, log_q = place.nodes(sobol(256, 4, 1))
    far = Tried(place, unit, normal(unit), log_q)
    assert ess(far.log_p - far.log_q) < 3
    found = of_all([far], 24.0)
    assert found.chol is not None
    assert np.all(np.diag(found.chol) > 0.5 * SDS)
    assert found.mean[0] < place.mean[0], "and it moves towards it"
