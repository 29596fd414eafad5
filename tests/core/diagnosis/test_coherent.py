"""What the simulation does wrong at many readings alike is no effect."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from core.calibration.online import update
from core.calibration.scans import Mixing
from core.calibration.state import RotorSpec
from core.diagnosis.coherent import discount, joined, loadings
from core.diagnosis.dealing import dealt_sets
from core.diagnosis.scan import Scan
from core.diagnosis.scores import Scores
from core.diagnosis.scoring import scores
from core.diagnosis.signature import Signatures
from core.model import rotor_blade
from core.observation import Inspection
from core.surrogate.alike import alike
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
    got = discount(one, g, np.array([True, False]), np.ones(2))
    assert got[0] == pytest.approx(score.var() / information, rel=0.02)
    assert got[0] > 1.2
    assert got[1] == 1.0, "nothing is alike in all blades here"


def test_of_scans_it_is_at_most_that_of_modes_that_always_err_alike() -> None:
    one = seen(0.8, scanned=True)
    g = signatures(one)
    a = one.information[B] @ g[B, :, 0]
    own = g[B, :, 0] @ a
    alike = 2.0 * np.sum((0.8 * SIGMA * a) ** 2)  # three scans of a row each
    assert discount(one, g, np.array([True, False]), np.ones(2))[0] == pytest.approx(
        1.0 + alike / own
    )


def test_where_the_simulation_is_sure_there_is_none() -> None:
    one, _ = rotor(4)
    g = signatures(one)
    alone, own = np.ones(2, bool), np.ones(2)
    assert np.array_equal(discount(one, g, alone, own), np.ones(2))
    sure = replace(one, unsure=np.zeros(one.q.shape), alike=np.zeros((*one.q.shape, 3)))
    assert np.array_equal(discount(sure, g, alone, own), np.ones(2))
    assert np.array_equal(discount(sure, g, ~alone, own), np.ones(2))


def test_a_scan_of_the_grammar_counts_it_for_single_blades_alone() -> None:
    plain = scan(*rotor(4))
    unsure = np.tile([0.9 * SIGMA, 0.0, 0.9 * SIGMA], (len(plain.seen.q), 1))
    doubted = replace(plain.seen, unsure=unsure)
    doubting = Scan.of(plain.cells, doubted, Signatures(plain.g, plain.h))
    alone, n = np.array([c.whom == "blade" for c in plain.cells]), len(plain.cells)
    factor = discount(doubted, plain.g[:, :, :n], alone, np.diag(plain.information)[:n])
    assert np.allclose(doubting.phi[:n], plain.phi[:n] * factor)
    assert np.any(factor[alone] > 1.05)
    assert np.all(factor[~alone] == 1.0)


def doubtful(one: Scores, size: float) -> Scores:
    """The simulation errs by `size` noises, alike in all blades: of early rows, and of late."""
    alike = np.zeros((*one.q.shape, 2))
    alike[:, :1, 0] = alike[:, 1:, 1] = size * SIGMA
    return replace(one, alike=alike * one.real[:, :, None])


def test_of_several_blades_the_discount_is_the_variance_of_an_error_that_all_have() -> None:
    """By dealt sets, on which the shared parameters are fitted and such errors are drawn; those
    without them are the control."""
    one, _ = rotor(4)
    doubted = doubtful(one, 0.5)
    g, none = signatures(one)[:, :, 1:], np.zeros(1, bool)
    g[:, 0] = 0.0  # the later it is the more it concerns all
    own = np.diag(one.cross(g))
    told = float(discount(doubted, g, none, own)[0])
    assert told > 1.5
    with_it, without = (
        float(np.einsum("kbi,bic->k", dealt_sets(seen_, 4000, 3), g).var() / own[0])
        for seen_ in (doubted, one)
    )
    assert with_it - without == pytest.approx(told - 1.0, rel=0.15)
    assert without < 1.4, "the control: what is dealt has no such error"


def test_effects_of_single_blades_keep_their_own_discount() -> None:
    one = replace(seen(0.8), alike=doubtful(seen(0.8), 0.5).alike)
    g = signatures(one)
    plain = discount(replace(one, alike=None), g, np.array([True, False]), np.ones(2))
    found = discount(one, g, np.array([True, False]), np.diag(one.cross(g)))
    assert found[0] == plain[0]
    assert found[1] > 1.0


def test_what_shared_parameters_make_up_for_is_no_error_of_an_effect() -> None:
    """An error in all blades that goes as a shared parameter moves them hardly counts; one that
    goes as no parameter does, does."""
    one, _ = rotor(4)
    one = replace(one, prior=1e6 * one.prior)
    moved = one.slope[:, :, :1] * SIGMA / np.abs(one.slope[:, :, :1]).max()
    turning = np.sign(np.arange(one.q.shape[1]) - 0.5)[None, :, None] * one.real[:, :, None]
    g, none = turning + 3.0 * moved / SIGMA, np.zeros(1, bool)
    own = np.diag(one.cross(g))
    hidden, seen_ = (
        float(discount(replace(one, alike=alike), g, none, own)[0])
        for alike in (moved, SIGMA * turning)
    )
    assert seen_ > 1.5
    assert hidden - 1.0 < 1e-4 * (seen_ - 1.0)


def test_loadings_of_a_scan_have_the_shape_of_its_modes_errors_and_the_size_of_its_rows() -> None:
    rng = np.random.default_rng(2)
    half = rng.normal(size=(5, 5))
    c, modes, turn = half @ half.T, rng.normal(size=(4, 5)), rng.normal(size=(4, 4))
    covariance = turn @ modes @ c @ modes.T @ turn.T
    unsure = 3.0 * np.sqrt(np.diag(covariance))
    one, _ = rotor(4)
    scanned = replace(one.rows[0].readings[0], quantity="deformation", values=np.zeros(4))
    single = replace(one.rows[0].readings[1], quantity="elongation")
    rows = replace(
        one.rows[0],
        readings=(single, scanned),
        of=(0, 1, 1, 1, 1, -1),
        mixings={1: Mixing(turn, modes)},
    )
    part = SimpleNamespace(mode_covariance=lambda time_h: c)
    model: Any = SimpleNamespace(part=lambda quantity: part)
    found = loadings(model, rows, np.array([0.7, *unsure]))
    assert found.keys() == {"elongation", "scans of deformation"}
    assert found["elongation"].ravel().tolist() == [0.7, 0, 0, 0, 0]
    scan_ = found["scans of deformation"]
    assert not scan_[0].any()
    np.testing.assert_allclose(scan_[1:] @ scan_[1:].T, 9.0 * covariance, rtol=1e-9)
    beside = joined([found, {"elongation": np.ones((2, 1))}], 6)
    assert beside.shape == (2, 6, 6)
    assert beside[1, :, 0].tolist() == [1, 1, 0, 0, 0, 0]
    np.testing.assert_array_equal(beside[0, :5, 1:], scan_)


def test_scores_of_a_rotor_have_what_its_blades_share_of_each_reading_s_error() -> None:
    """Elongations, and a scan of every other blade: as long as the row's sd, by how much errors go
    together between the blades."""
    model, rng = rotor_blade(), np.random.default_rng(6)
    blades, hours, nodes = [f"b{k}" for k in range(6)], (8_000.0, 16_000.0), np.arange(0, 5600, 400)
    x = np.column_stack([rng.uniform(0.8, 1.2, 6), np.full(6, 0.92), rng.normal(size=(6, 2))])
    tips = model.surrogate.predict(x, "elongation", np.array(hours))[0]
    fields = model.surrogate.predict(x, "deformation", np.array(hours[1:]), nodes.tolist())[0]
    given = [
        Inspection(f"{b}-{h:.0f}", b, "elongation", h, tips[k, [j]] + rng.normal(0, 0.02, 1))
        for k, b in enumerate(blades)
        for j, h in enumerate(hours)
    ]
    given += [
        Inspection(f"{b}-scan", b, "deformation", hours[1], y, nodes=nodes, sigma=0.02)
        for b, y in zip(blades[::2], fields[::2, 0] + rng.normal(0, 0.02, (3, 14, 3)), strict=True)
    ]
    found = scores(model, update(model, RotorSpec("r", tuple(blades), 300, 5), given), given)
    assert found.alike is not None
    assert found.unsure is not None
    middle = np.array([[p[n].mean() for n in model.input_names] for p in found.points])
    rho = alike(model.surrogate, middle, hours[1])
    assert 0.01 < rho < 0.95
    long = np.linalg.norm(found.alike, axis=2)
    np.testing.assert_allclose(long[found.real], np.sqrt(rho) * found.unsure[found.real], rtol=1e-9)
    assert not long[~found.real].any()
    single = [found.alike[b, i] for b in range(6) for i in range(2)]
    assert all(np.count_nonzero(one) == 1 for one in single)
    assert np.count_nonzero(np.any(found.alike != 0, axis=(0, 1))) > 10
