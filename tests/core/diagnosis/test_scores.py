"""Score and information of a shift in the readings, against the exact Gaussian answers."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import truncnorm

from core.calibration.online import update
from core.calibration.state import RotorSpec
from core.diagnosis import scoring
from core.diagnosis.grammar import Cell
from core.diagnosis.information import CUT, ENDS, bounded, given, information
from core.diagnosis.scan import Scan
from core.diagnosis.scores import Scores
from core.diagnosis.scoring import scores
from core.diagnosis.signature import Signatures
from core.errors import InputError
from core.family import Family
from core.model import rotor_blade
from core.observation import Inspection
from tests.core.calibration.test_exact import SLOPES, conjugate, readings
from tests.core.calibration.test_population import SPEC as POPULATION
from tests.core.calibration.test_population import hierarchical, off_centre
from tests.core.calibration.test_population import readings as of_a_population

BLADES, TIMES, SIGMA = 5, [0.0, 0.5, 1.0, 1.5], 0.15
ANY = Family(
    "any", "a shift", "reading", "y", "plus", 1.0, 0, ("constant",), ("all",), "blade", "sensor"
)


@cache
def case() -> tuple[Scores, Any, Any]:
    """Scores of a conjugate rotor; its exact covariance and miss, rows in the order of `place`."""
    model, data = conjugate(2), readings(BLADES, TIMES, 3, SIGMA)
    spec = RotorSpec("r", tuple(f"b{b}" for b in range(BLADES)), 20_000, 5)
    seen = scores(model, update(model, spec, data), data)
    ordered = [seen.reading(b, i) for b in range(BLADES) for i in range(len(TIMES))]
    design = np.zeros((len(ordered), 1 + 2 * BLADES))
    for row, reading in enumerate(ordered):
        b = int(reading.blade[1:])
        design[row, 0] = 0.8
        design[row, 1 + 2 * b : 3 + 2 * b] = [SLOPES[j] * reading.time_h**j for j in range(2)]
    prior = np.diag([0.25, *([0.36] * 2 * BLADES)])
    mean = np.array([2.0, *([-1.0, 0.0] * BLADES)])
    y = np.array([r.values[0] for r in ordered])
    return seen, design @ prior @ design.T + SIGMA**2 * np.eye(len(y)), y - design @ mean


def signature(seed: int, columns: int = 1) -> Any:
    return np.random.default_rng(seed).normal(size=(BLADES, len(TIMES), columns))


def test_score_and_information_are_the_exact_derivatives_of_the_log_evidence() -> None:
    seen, spread, miss = case()
    for seed in range(5):
        g = signature(seed)
        flat = g[:, :, 0].ravel()
        u = float(np.einsum("bic,bi->c", g, seen.q)[0])
        information = flat @ np.linalg.solve(spread, flat)
        assert seen.cross(g)[0, 0] == pytest.approx(information, rel=0.02)
        assert abs(u - flat @ np.linalg.solve(spread, miss)) < 0.01 * np.sqrt(information)


def test_what_the_parameters_imitate_has_next_to_noinformation() -> None:
    """A shift like a shared parameter of sd 0.5, 1,000 times as large: I stays below 1 / 0.4²."""
    seen, _, _ = case()
    g = np.full((BLADES, len(TIMES), 1), 0.8)
    assert seen.cross(g)[0, 0] < 1 / 0.4**2
    assert seen.cross(signature(0))[0, 0] > 100


def test_contributions_of_the_blades_add_up_to_the_score_but_for_the_shared_prior() -> None:
    seen, _, _ = case()
    g = signature(7)
    parts = np.einsum("bic,bi->bc", seen.efficient(g), seen.q)
    pull = np.einsum("bik,bi->k", seen.imitated, seen.q)  # of the shared prior on the readings
    own = np.einsum("bik,bic->kc", seen.deviation, g)[:, 0]
    whole = np.einsum("bic,bi->c", g, seen.q)
    assert parts.sum() + own @ pull == pytest.approx(whole[0], rel=1e-9)
    assert abs(own @ pull) < 0.05 * abs(whole[0])


def test_the_gain_of_two_cells_is_their_exact_log_bayes_factor() -> None:
    seen, spread, miss = case()
    g = signature(11, 2)
    scan = Scan.of(
        [Cell(ANY, "constant", "all"), Cell(ANY, "constant", "all")], seen, Signatures(g, 0 * g)
    )
    flat = g.reshape(-1, 2)
    a = np.eye(2) + flat.T @ np.linalg.solve(spread, flat)
    u = flat.T @ np.linalg.solve(spread, miss)
    exact = 0.5 * u @ np.linalg.solve(a, u) - 0.5 * np.linalg.slogdet(a)[1]
    assert scan.gain(0, 1) == pytest.approx(exact, abs=0.25)


def test_with_an_effect_included_the_scores_are_those_of_the_larger_model() -> None:
    seen, spread, miss = case()
    g, h = signature(13), signature(14)
    scan = Scan.of([Cell(ANY, "constant", "all")], seen, Signatures(g, 0 * g))
    left = seen.including(g, scan.amplitudes(0)[0])
    flat, other = g[:, :, 0].ravel(), h[:, :, 0].ravel()
    larger = spread + np.outer(flat, flat)
    information = other @ np.linalg.solve(larger, other)
    assert left.cross(h)[0, 0] == pytest.approx(information, rel=0.02)
    u = float(np.einsum("bic,bi->c", h, left.q)[0])
    assert abs(u - other @ np.linalg.solve(larger, miss)) < 0.06 * np.sqrt(information)


def test_a_change_that_goes_with_the_parameters_leans_as_it_exactly_does() -> None:
    """g = f³ at every row, f ~ N(m, S): Cov[f³, r] = −3 (m² + S) S / sigma²; from `POINTS`
    particles of a blade. A gain's lean is a third of it."""
    seen, spread, miss = case()
    y = np.array([seen.reading(b, i).values[0] for b in range(BLADES) for i in range(len(TIMES))])
    m = y - SIGMA**2 * np.linalg.solve(spread, miss)
    s = SIGMA**2 * (1.0 - SIGMA**2 * np.diag(np.linalg.inv(spread)))
    mean, h = seen.over(seen.answers**3)
    exact = -3.0 * (m**2 + s) * s / SIGMA**2
    assert mean.ravel() == pytest.approx(m**3 + 3.0 * m * s, rel=0.01, abs=0.01)
    assert h.ravel() == pytest.approx(exact, rel=0.1)
    assert h.sum() == pytest.approx(exact.sum(), rel=0.01)
    gains = seen.in_proportion((m**2 + 3.0 * s).reshape(BLADES, -1))[1]
    assert gains.sum() == pytest.approx(-np.sum((m**2 + 3.0 * s) * s) / SIGMA**2, rel=0.003)
    half = seen.in_proportion(np.full(seen.place.shape, 0.5))
    again = seen.over(0.5 * seen.answers)
    assert again[1].sum() == pytest.approx(half[1].sum(), rel=1e-6)


def test_means_are_steadied_to_the_exact_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a normal posterior residuals are combinations of Stein's fields, and nothing is left of
    the particles' error; the control is without them, on the same particles."""
    seen, spread, miss = case()
    exact = np.linalg.solve(spread, miss).reshape(BLADES, -1)
    scale = 1.0 / np.sqrt(np.diag(spread)).reshape(BLADES, -1)
    off = np.abs(seen.q - exact) / scale
    assert off.max() < 0.01
    monkeypatch.setattr(scoring, "fields", lambda u, ends, slope, w: np.empty((len(u), 0)))
    plain, _, _ = case.__wrapped__()
    assert np.sqrt(np.mean((plain.q - exact) ** 2 / scale**2)) > 3 * np.sqrt(np.mean(off**2))


@pytest.mark.parametrize("beyond", [-20.0, 0.0, 2.0])  # noises beyond the bound
def test_a_bound_tells_more_than_a_normal_prior_of_the_same_variance(beyond: float) -> None:
    """y = x + noise, x uniform within ±20 noises: −d² log p(y) / dy², exactly, where it shows."""
    sigma, half = 0.5, 10.0
    y = half + beyond * sigma
    low, high = ((end - y) / sigma for end in (-half, half))
    rng = np.random.default_rng(4)
    x = y + sigma * truncnorm.rvs(low, high, size=4000, random_state=rng)
    w = np.full(len(x), 1.0 / len(x))
    spread = np.array([[2.0 * half / np.sqrt(12.0)]])  # sd of the prior
    found = information(np.array([sigma**2]), spread, (x - x.mean())[:, None], w)[0, 0]
    exact = (1.0 - truncnorm.var(low, high)) / sigma**2
    least = 1.0 / (sigma**2 + spread[0, 0] ** 2)
    if beyond < -5:  # deep inside a bound says nothing, and what a normal prior says stands
        assert exact < least
        assert found == pytest.approx(least, rel=1e-9)
    else:
        assert exact > 20 * least
        assert found == pytest.approx(exact, rel=0.1)


def test_where_particles_show_nothing_the_information_is_the_normal_ones_bit_by_bit() -> None:
    rng = np.random.default_rng(7)
    v, spread = np.array([0.4, 0.1, 0.2]), rng.normal(size=(3, 2))
    exact = np.linalg.inv(np.diag(v) + spread @ spread.T)
    posterior = np.linalg.inv(np.eye(2) + spread.T @ np.diag(1 / v) @ spread)
    x = rng.multivariate_normal(np.zeros(2), posterior, size=1000)
    w = np.full(1000, 1e-3)
    off = (x - x.mean(axis=0)) @ spread.T
    assert information(v, spread, off, w) == pytest.approx(exact, rel=1e-9)
    # without a standard error, chance would be taken for bounds
    noisy = np.diag(1 / v) - np.diag(1 / v) @ (off.T @ off / 1000) @ np.diag(1 / v)
    assert not np.allclose(noisy, exact, rtol=0.05)


def test_given_the_shared_parameters_answers_scatter_as_the_readings_let_them() -> None:
    """One shared and one own parameter on a ridge: what one adds the other takes away."""
    rng = np.random.default_rng(2)
    n, ridge, sigma = 20_000, 5.0, 0.1
    shared = ridge * rng.normal(size=(n, 1))
    f = (shared[:, 0] + (-shared[:, 0] + sigma * rng.normal(size=n)))[:, None]
    w = np.full(n, 1.0 / n)
    off = shared - w @ shared
    left = given(off, f - w @ f, w)
    assert left.std() == pytest.approx(sigma, rel=0.02)
    by_slope = f - w @ f - off  # the control: as if the own parameter stayed where it is
    assert by_slope.std() > 10 * sigma


@pytest.mark.parametrize("left", [1e-4, 0.09])  # of 1 / V, where parameters imitate the rest
def test_where_a_bound_forbids_to_imitate_there_isinformation(left: float) -> None:
    v = 0.4
    seen = np.array([left, 0.9, 1.0]) / v
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    known = turn @ np.diag(seen) @ turn.T
    typical = np.full(3, v)

    def found(*sds: float, box: bool = False) -> np.ndarray:
        q = turn @ (np.array(sds) * np.sqrt(seen))
        return np.linalg.eigvalsh(bounded(known, typical, q, box))

    least = (8.5 / CUT) ** 2 * left / v
    assert found(8.5, 0.9, -1.5) == pytest.approx(sorted([least, *seen[1:]]), rel=1e-9)
    # 2 sds there, and 9 in a direction that is seen well
    assert found(2.0, 9.0, -1.5) == pytest.approx(seen, rel=1e-9)
    # under a prior that is a box, what one sd says
    least = (2.0 / ENDS) ** 2 * left / v
    assert found(2.0, 9.0, -1.5, box=True) == pytest.approx(sorted([least, *seen[1:]]))


@pytest.mark.parametrize("far", [0.02, 0.1, 0.5])
def test_in_the_corner_of_three_boxes_the_score_tells_the_information(far: float) -> None:
    """y the sum of three parameters that are uniform on 0 … 1, `far` below their corner at 3.

    p(y) = (3 − y)² / 2, so that the score is −2 / (3 − y) and −d² log p / dy² = 2 / (3 − y)².
    """
    noise = 1e-3
    typical, q = np.array([noise**2]), np.array([-2.0 / far])
    normal = np.array([[1.0 / (noise**2 + 3.0 / 12.0)]])
    exact = 2.0 / far**2
    found = bounded(normal, typical, q, box=True)[0, 0]
    assert exact <= found <= 2.01 * exact
    assert bounded(normal, typical, q)[0, 0] < 0.55 * exact, "the control: as of a normal prior"


def test_directions_that_are_imitated_are_told_by_each_rows_own_variance() -> None:
    """Two rows of noises 10 times apart, neither imitated: nothing is bounded."""
    typical = np.array([1.0, 100.0])
    known = np.diag(1.0 / typical)
    q = np.array([0.0, 0.9])  # 9 sds of the second row, whose information is the lesser by far
    assert np.allclose(bounded(known, typical, q), known, rtol=1e-12)


def test_scores_know_the_ends_of_the_priors_and_what_the_simulation_does_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A blade longer than any of the priors' corners: nothing of it is an effect's."""
    model = rotor_blade()
    lengths = {"b0": (0.5, 0.9, 1.2), "b1": (0.1, 0.2, 0.3), "b2": (0.12, 0.2, 0.31)}
    data = [
        Inspection(f"{b}-{k}", b, "elongation", 8000.0 * (k + 1), np.array([y]), sigma=0.02)
        for b, own in lengths.items()
        for k, y in enumerate(own)
    ]
    state = update(model, RotorSpec("r", tuple(lengths), 400, 5), data)

    def far() -> float:
        seen = scores(model, state, data)
        assert seen.unsure is not None
        assert np.all((seen.unsure > 1e-5) & (seen.unsure < 0.02))
        value, vector = np.linalg.eigh(seen.information[0] * 0.02**2)
        return float(abs(vector[:, 0] @ seen.q[0]) * 0.02 / np.sqrt(value[0]))

    assert far() <= 1.01
    monkeypatch.setattr("core.diagnosis.scoring.made_by_ends", lambda prior: False)
    assert far() > 1.5, "the control: as of normal priors"


def test_a_state_of_other_readings_is_refused() -> None:
    model, data = conjugate(1), readings(2, [0.0, 1.0], 3, SIGMA)
    state = update(model, RotorSpec("r", ("b0", "b1"), 400, 5), data)
    with pytest.raises(InputError, match="rests on other readings"):
        scores(model, state, data[:-1])
    with pytest.raises(InputError, match="cannot be diagnosed"):
        scores(model, state, [])


def test_a_populations_mean_imitates_what_all_blades_have_in_common() -> None:
    """y = s + l, l ~ N(mean, sd²): an offset of all is the mean's (sd 0.5) and s's (sd 0.3)."""
    data = of_a_population(off_centre())
    state = update(hierarchical(), replace(POPULATION, particles=2000), data)
    seen = scores(hierarchical(), state, data)
    names = [n for n in state.meta["shared"] if not n.startswith("sigma_obs.")]
    slope = dict(zip(names, np.moveaxis(seen.slope, 2, 0), strict=True))
    assert slope["mean.l"] == pytest.approx(np.ones_like(slope["mean.l"]))
    assert slope["s"] == pytest.approx(np.ones_like(slope["s"]))
    assert seen.cross(np.ones((*seen.place.shape, 1)))[0, 0] < 1 / (0.3**2 + 0.5**2)
