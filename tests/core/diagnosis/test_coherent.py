"""What the simulation does wrong at all readings of a blade alike is no effect of that blade."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.diagnosis.coherent import discount
from core.diagnosis.scan import Scan
from core.diagnosis.scores import Scores
from core.diagnosis.signature import Signatures
from tests.core.diagnosis.fleet import SIGMA, rotor, scan

B = 3


def seen(size: float, scanned: bool = False) -> Scores:
    """A rotor without parameters of the blades' own, of which the simulation does not know `size`
    noises of each row."""
    one, _ = rotor(4)
    one = replace(one, information=np.tile(np.eye(one.q.shape[1]) / SIGMA**2, (len(one.q), 1, 1)))
    if scanned:
        rows = tuple(
            replace(rows, readings=tuple(replace(r, values=np.zeros(6)) for r in rows.readings))
            for rows in one.rows
        )
        one = replace(one, rows=rows)
    return replace(one, unsure=np.full(one.q.shape, size * SIGMA))


def signatures(one: Scores) -> np.ndarray:
    g = np.zeros((*one.q.shape, 2))
    g[B, :, 0], g[:, :, 1] = [0.4, 1.0, 1.7], 1.0
    return g


def test_of_values_the_discount_is_the_variance_of_an_error_that_is_always_the_same() -> None:
    """By drawing: independent errors are in the information, the same one at all is not."""
    one = seen(0.8)
    g = signatures(one)
    rng = np.random.default_rng(1)
    inside = np.linalg.inv(one.information[B])
    own, same = 0.8 * SIGMA, rng.normal(size=200_000)
    apart = inside - own**2 * np.eye(len(inside))
    y = rng.multivariate_normal(np.zeros(len(inside)), apart, size=len(same), method="cholesky")
    score = (y + own * same[:, None]) @ one.information[B] @ g[B, :, 0]
    information = g[B, :, 0] @ one.information[B] @ g[B, :, 0]
    got = discount(one, g, np.array([True, False]))
    assert got[0] == pytest.approx(score.var() / information, rel=0.02)
    assert got[0] > 1.2
    assert got[1] == 1.0, "what concerns all blades is told by their scatter"


def test_of_scans_it_is_at_most_that_of_modes_that_always_err_alike() -> None:
    one = seen(0.8, scanned=True)
    g = signatures(one)
    a = one.information[B] @ g[B, :, 0]
    own = g[B, :, 0] @ a
    alike = 2.0 * np.sum((0.8 * SIGMA * a) ** 2)  # three scans of a row each
    assert discount(one, g, np.array([True, False]))[0] == pytest.approx(1.0 + alike / own)


def test_where_the_simulation_is_sure_there_is_none() -> None:
    one, _ = rotor(4)
    g = signatures(one)
    assert np.array_equal(discount(one, g, np.ones(2, bool)), np.ones(2))
    assert discount(replace(one, unsure=np.zeros(one.q.shape)), g, np.ones(2, bool))[0] == 1.0


def test_a_scan_of_the_grammar_counts_it_for_single_blades_alone() -> None:
    plain = scan(*rotor(4))
    unsure = np.tile([0.9 * SIGMA, 0.0, 0.9 * SIGMA], (len(plain.seen.q), 1))
    doubted = replace(plain.seen, unsure=unsure)
    doubting = Scan.of(plain.cells, doubted, Signatures(plain.g, plain.h))
    alone, n = np.array([c.whom == "blade" for c in plain.cells]), len(plain.cells)
    factor = discount(doubted, plain.g[:, :, :n], alone)
    assert np.allclose(doubting.phi[:n], plain.phi[:n] * factor)
    assert np.any(factor[alone] > 1.05)
    assert np.all(factor[~alone] == 1.0)
