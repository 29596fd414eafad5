"""R of weighted particles: what it is for independent ones, and that it sees what it should."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import qmc

from core.smc.parts import PARTS, r_hat


def test_independent_nodes_have_the_r_that_their_effective_number_implies() -> None:
    """E[R² − 1] = PARTS / ESS for normal draws; importance weights lower the ESS."""
    rng, found, sizes = np.random.default_rng(5), [], []
    for _ in range(400):
        x = rng.normal(size=(1200, 1))
        log_w = 0.3 * x[:, 0]
        w = np.exp(log_w)
        found.append(r_hat(x, log_w, np.arange(1200))[0] ** 2 - 1.0)
        # the variance of a weighted mean, not of a plain one: Σ w² (x − mu)² / (Σ w)² / sd²
        mean = w @ x[:, 0] / w.sum()
        variance = w @ (x[:, 0] - mean) ** 2 / w.sum()
        sizes.append(variance * w.sum() ** 2 / (w**2 @ (x[:, 0] - mean) ** 2))
    expected = PARTS / np.mean(sizes)
    assert np.mean(found) == pytest.approx(expected, rel=0.15)


def test_particles_of_one_node_are_no_replicates() -> None:
    """Ten copies of each of 80 nodes: R is that of 80, and would be that of 800 by rows."""
    rng = np.random.default_rng(6)
    r = {"nodes": [], "rows": []}
    for _ in range(200):
        x = np.repeat(rng.normal(size=(80, 1)), 10, axis=0)
        r["nodes"].append(r_hat(x, np.zeros(800), np.arange(800) // 10)[0])
        shuffled = rng.permutation(800)
        r["rows"].append(r_hat(x[shuffled], np.zeros(800), np.arange(800))[0])
    assert np.mean(r["nodes"]) - 1 > 5 * (np.mean(r["rows"]) - 1)


def test_a_part_without_weight_and_a_value_that_never_moves() -> None:
    x = np.repeat([[0.0, 3.0], [1.0, 3.0], [2.0, 3.0], [3.0, 3.0]], 2, axis=0)
    assert r_hat(x, np.zeros(8), np.arange(8))[1] == 1.0
    assert np.isinf(r_hat(x, np.zeros(8), np.arange(8))[0]), "each part sits still, elsewhere"
    alone = np.where(np.arange(8) == 0, 0.0, -1e4)
    assert np.all(np.isinf(r_hat(x, alone, np.arange(8))))


def test_every_fourth_point_of_a_sobol_sequence_is_no_part() -> None:
    """The control: runs of the sequence agree; every fourth point covers a quarter of the space."""
    x = qmc.Sobol(1, rng=7).random(256)
    runs = r_hat(x, np.zeros(256), np.arange(256))[0]
    dealt = r_hat(x, np.zeros(256), np.argsort(np.arange(256) % PARTS, kind="stable").argsort())[0]
    assert runs < 1.001
    assert dealt > 2.0
