"""Control variates by Stein's identity: unbiased at a bound, zero over a blade's own posterior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import truncnorm

from core.calibration.online import Workspace, update
from core.calibration.space import locals_of
from core.calibration.state import RotorSpec, RotorState, blade_posterior
from core.diagnosis import scoring
from core.diagnosis.answering import Answering
from core.diagnosis.case import Case
from core.diagnosis.stein import EACH, fields, steadied
from core.model import Model, rotor_blade, rotor_blade_wide
from core.observation import Inspection
from core.validation.effect_plans import plan
from core.validation.effect_sets import made
from tests.core.calibration.test_population import BLADES, hierarchical
from tests.core.calibration.test_population import SPEC as POPULATION
from tests.core.calibration.test_population import readings as of_a_population


@pytest.mark.parametrize("y", [0.3, 1.5, 2.5])  # noises of 0.5, prior uniform in ±1
def test_at_a_bound_the_mean_residual_is_unbiased_and_far_surer(y: float) -> None:
    """Over 300 sets of 200 draws. The control's field does not vanish at the ends, and is wrong."""
    sigma, ends, rng = 0.5, np.array([[-1.0, 1.0]]), np.random.default_rng(3)
    low, high = (-1.0 - y) / sigma, (1.0 - y) / sigma
    exact = (y - (y + sigma * truncnorm.mean(low, high))) / sigma**2
    w = np.full(200, 1 / 200)
    found = []
    for _ in range(300):
        u = y + sigma * truncnorm.rvs(low, high, size=(200, 1), random_state=rng)
        slope = (y - u) / sigma**2
        r = slope
        c = fields(u, ends, slope, w)
        found.append([one @ r[:, 0] for one in (w, steadied(c, w), steadied(slope, w))])
    plain, ours, wrong = (np.array(one) - exact for one in zip(*found, strict=True))
    assert ours.std() < 0.4 * plain.std()
    assert abs(ours.mean()) < 4 * ours.std() / np.sqrt(300) + 0.01 * plain.std()
    assert abs(wrong.mean()) > 20 * wrong.std() / np.sqrt(300)


def test_fields_are_as_many_as_the_particles_carry() -> None:
    u, ends = np.random.default_rng(0).normal(size=(400, 3)), np.array([[-9.0, 9.0]] * 3)
    sizes = [
        fields(u, ends, -u, np.r_[np.full(n, 1 / n), np.zeros(400 - n)]).shape[1]
        for n in (400, 12 * EACH, 12 * EACH - 1, 3 * EACH, 3 * EACH - 1)
    ]
    assert sizes == [12, 12, 3, 3, 0]
    w = np.full(400, 1 / 400)
    assert steadied(np.empty((400, 0)), w) is w


def test_weights_say_what_a_regression_on_the_fields_says() -> None:
    rng = np.random.default_rng(6)
    c, values, w = rng.normal(0.1, 1.0, (200, 4)), rng.normal(size=(200, 3)), rng.random(200)
    w /= w.sum()
    root, off, mean = np.sqrt(w)[:, None], w @ c, w @ values
    beta = np.linalg.lstsq(root * (c - off), root * (values - mean), rcond=None)[0]
    assert steadied(c, w) @ values == pytest.approx(mean - off @ beta, rel=1e-9)
    assert steadied(c, w) @ c == pytest.approx(np.zeros(4), abs=1e-12)


def _calibrated(model: Model, data: list[Inspection], particles: int) -> RotorState:
    blades = tuple(sorted({r.blade for r in data}))
    return update(model, RotorSpec("r", blades, particles, 3), data)


def _fields_of(
    model: Model, data: list[Inspection], state: RotorState, off: float = 0.0
) -> np.ndarray:
    """Means of the fields over their standard error, by blade; off: of readings that are wrong."""
    found, work = [], Workspace()
    for blade in state.meta["blades"]:
        posterior = blade_posterior(state.meta, state.arrays.__getitem__, blade)
        rows = work.rows_of(model, [r for r in data if r.blade == blade])
        wrong = replace(rows, y=rows.y + off * np.array([o >= 0 for o in rows.of]))
        names = rows.response.names
        x = np.stack([posterior.column(n) for n in names], axis=1)
        own = [p for p in locals_of(model) if p.name in names]
        u, slope = Answering(posterior, wrong, names, x).slopes(own)
        w = posterior.particles.w
        c = fields(u, np.array([p.prior.box for p in own]), slope, w)
        found.append((w @ c) / np.sqrt((w @ w) * (w @ c**2)))
    return np.array(found)


def test_the_fields_of_a_blades_posterior_are_zero_on_average() -> None:
    """Of uniform priors and of a population's, over real particles; the control's readings are off
    by a noise."""
    y = np.random.default_rng(5).normal(0.4, 0.03, (6, 3))
    data = [
        Inspection(f"{b}-{t}", f"B{b}", "elongation", t, np.array([y[b, k]]), sigma=0.02)
        for b in range(6)
        for k, t in enumerate((8e3, 16e3, 24e3))
    ]
    model = rotor_blade()
    state = _calibrated(model, data, 10_000)
    z = _fields_of(model, data, state)
    assert z.shape == (6, 12)
    assert np.sqrt(np.mean(z**2)) < 1.2
    assert np.abs(z).max() < 4.0
    assert np.abs(_fields_of(model, data, state, 0.02)).max() > 8.0
    values = np.random.default_rng(7).normal(2.5, 0.5, (len(BLADES), 3))
    model, data = hierarchical(), of_a_population(values)
    z = _fields_of(model, data, _calibrated(model, data, POPULATION.particles))
    assert z.shape == (len(BLADES), 2)
    assert np.sqrt(np.mean(z**2)) < 1.2


def test_what_effects_weigh_hardly_depends_on_the_particles(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Log Bayes factors of the same readings by particles of two seeds; the control's means are as
    the particles have them."""
    given = made(plan("rotor-20"), "worn lot", 0, 5, 500).case
    model = rotor_blade_wide()
    specs = [replace(given.spec, seed=seed) for seed in (1, 2)]
    states = [update(model, spec, given.readings) for spec in specs]

    def scatter() -> float:
        found = []
        for spec, state in zip(specs, states, strict=True):
            case = Case(spec, given.readings, given.facts)
            found.append(case.scan(model, state).undiscounted)
        physics = [i for i, c in enumerate(found[0].cells) if c.family.target == "input"]
        gains = np.array([[scan.gain(i) for i in physics] for scan in found])
        return float(np.sqrt(np.mean(gains.var(axis=0, ddof=1))))

    ours = scatter()
    monkeypatch.setattr(scoring, "fields", lambda u, ends, slope, w: np.empty((len(u), 0)))
    plain = scatter()
    assert ours < 0.5 * plain
