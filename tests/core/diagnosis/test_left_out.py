"""A reading without itself, against the normal distribution's own answer."""

from __future__ import annotations

import numpy as np
import pytest

from core.calibration.online import update
from core.calibration.state import RotorSpec
from core.diagnosis.left_out import left_out
from core.diagnosis.scoring import scores
from core.observation import Inspection
from tests.core.calibration.test_exact import SLOPES, conjugate
from tests.core.diagnosis.fleet import SIGMA, rotor


def one_by_one(readings: list[Inspection], mean: float = 0.8 * 2.0) -> np.ndarray:
    """(R, 3): each reading's mean and sd given all others, and its z, by conditioning."""
    y = np.array([float(r.values[0]) for r in readings])
    design = np.array([[SLOPES[j] * r.time_h**j for j in range(2)] for r in readings])
    m = mean + design @ np.array([-1.0, 0.0])
    same = np.array([[a.blade == b.blade for b in readings] for a in readings])
    c = 0.36 * (design @ design.T) * same + 0.8**2 * 0.25 + SIGMA**2 * np.eye(len(y))
    found = []
    for i in range(len(y)):
        rest = np.arange(len(y)) != i
        gain = np.linalg.solve(c[np.ix_(rest, rest)], c[rest, i])
        at, sd = m[i] + gain @ (y - m)[rest], np.sqrt(c[i, i] - gain @ c[rest, i])
        found.append((at, sd, (y[i] - at) / sd))
    return np.array(found)


def test_exact_scores_leave_each_reading_out_exactly() -> None:
    seen, _ = rotor(5)
    got = left_out(seen)
    true = one_by_one(list(got.readings))
    np.testing.assert_allclose(got.mean, true[:, 0], atol=1e-9)
    np.testing.assert_allclose(got.sd, true[:, 1], rtol=1e-9)
    np.testing.assert_allclose(got.z, true[:, 2], atol=1e-8)
    assert got.skipped == 0


def test_they_have_the_spread_they_say_and_fitted_residuals_do_not() -> None:
    """The control: y less the fitted answer, over the noise, is too small by half."""
    z, fitted = [], []
    for seed in range(30):
        seen, _ = rotor(seed)
        z.append(left_out(seen).z)
        fitted.append((seen.q * SIGMA)[seen.real])
    assert np.mean(np.square(z)) == pytest.approx(1.0, abs=0.08)
    assert np.mean(np.square(fitted)) < 0.6


def test_a_wild_reading_does_not_hide_itself() -> None:
    """One reading ten noises too long: its prediction is that of the clean rotor."""
    clean, wild = (
        left_out(rotor(3, lambda b, k, off=off: off * (b == 4 and k == 2))[0])
        for off in (0.0, 10 * SIGMA)
    )
    at = [r.id for r in wild.readings].index("4-2")
    assert wild.mean[at] == pytest.approx(clean.mean[at], abs=1e-9)
    assert wild.z[at] - clean.z[at] == pytest.approx(10 * SIGMA / clean.sd[at], rel=1e-9)


def test_calibrated_particles_leave_readings_out_within_a_tenth_of_a_sd() -> None:
    seen, _ = rotor(5)
    data = [r for rows in seen.rows[:4] for r in rows.readings]
    model = conjugate(2)
    spec = RotorSpec("r", tuple(sorted({r.blade for r in data})), particles=6400, seed=3)
    got = left_out(scores(model, update(model, spec, data), data))
    true = one_by_one(list(got.readings))
    np.testing.assert_allclose(got.mean, true[:, 0], atol=0.1 * true[:, 1].max())
    np.testing.assert_allclose(got.sd, true[:, 1], rtol=0.08)
