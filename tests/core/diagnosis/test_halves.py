"""How amplitudes in halves take along that slopes go with the residuals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.calibration.online import RotorSpec, update
from core.calibration.state import blade_posterior
from core.diagnosis.adopt import amplitude, with_effects
from core.diagnosis.conclude import Rival
from core.diagnosis.halves import between
from core.diagnosis.parted import BLADES
from core.diagnosis.scoring import scores
from core.diagnosis.verdict import WIDE
from tests.core.calibration.bar import bar, creep, measured
from tests.core.diagnosis.test_parted import CELL, FEW, MODEL, rotor_of


def test_slopes_go_with_residuals_as_over_the_particles_of_the_formula() -> None:
    """Cov[df/d rate, (y − f) / V], which is most where the exponential is steep."""
    model, data = bar(), measured(4, (0.4e4, 1.2e4, 2.0e4), seed=3)
    spec = RotorSpec("r", tuple(f"b{b}" for b in range(4)), 2000, 1)
    state = update(model, spec, data)
    seen = scores(model, state, data)
    names = [n for n in state.meta["shared"] if not n.startswith("sigma_obs.")]
    assert seen.pull is not None
    most = 0.0
    for b, blade in enumerate(seen.blades):
        own = blade_posterior(state.meta, state.arrays.__getitem__, blade)
        w, x = own.particles.w, np.stack([own.column(i.name) for i in model.surrogate.inputs], 1)
        moved = [x + step * np.array([0.0, 1.0, 0.0, 0.0]) for step in (1e-5, -1e-5)]
        for i in np.flatnonzero(seen.real[b]):
            reading = seen.reading(b, i)
            f = creep(x, reading.time_h)
            slope = (creep(moved[0], reading.time_h) - creep(moved[1], reading.time_h)) / 2e-5
            r = (reading.values[0] - f) / own.column("sigma_obs.y") ** 2
            exact = w @ ((slope - w @ slope) * r)
            told = seen.pull[b, i, names.index("rate")]
            scale = np.sqrt(w @ (slope - w @ slope) ** 2 * (w @ r**2))
            assert abs(told - exact) < 0.1 * scale  # polynomials are up to half a noise off
            most = max(most, abs(exact) / scale)
    assert most > 0.2, "there is something to be told"


def test_a_pull_between_halves_is_a_difference_of_amplitudes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    case, sound, work = rotor_of(0.3, 0.3)
    bent = with_effects(MODEL, [CELL], case.facts, case.noise(MODEL, sound))
    state = update(bent, FEW, case.readings, workspace=work)
    seen = case.seen(bent, state)
    assert seen.pull is not None
    name, _ = amplitude(CELL, MODEL.network)
    k = [n for n in state.meta["shared"] if not n.startswith("sigma_obs.")].index(name)
    slopes = np.abs(seen.slope[:, :, k])
    assert np.max(np.abs(seen.pull[:, :, k])) < 1e-6 * np.max(slopes), "the law is linear"
    sign = np.where(np.arange(len(seen.blades)) % 2, -1.0, 1.0)[:, None] * seen.real
    pulled = seen.pull.copy()
    pulled[:, :, k] = sign
    size = 0.3

    def told(pull: np.ndarray) -> tuple[float, float]:
        # other tests look at the same case: what is put in here goes again
        key = (bent.digest, state.digest, frozenset[str]())
        monkeypatch.setitem(case._seen, key, replace(seen, pull=pull))
        held = case.halves(MODEL, sound, Rival((CELL,), bent, lambda: state, 0.0))
        return next(one.amplitudes for one in held if one.by == BLADES)

    plain, other = told(seen.pull), told(pulled)
    d = np.where(sign > 0, 1.0, -1.0)[:, :, None] * seen.slope[:, :, k, None] * size
    variance = 1.0 / (seen.cross(d)[0, 0] + 1.0 / WIDE**2)
    shift = variance * size * np.sum(np.abs(sign))
    assert np.subtract(other, plain) == pytest.approx([shift, -shift], rel=1e-6)


def test_a_half_tells_nothing_of_the_other() -> None:
    """Without pulls or residuals both have the mean."""
    case, sound, work = rotor_of(0.3, 0.3)
    bent = with_effects(MODEL, [CELL], case.facts, case.noise(MODEL, sound))
    seen = case.seen(bent, update(bent, FEW, case.readings, workspace=work))
    quiet = replace(seen, q=0.0 * seen.q)
    g = np.where(seen.real, 1.0, 0.0)
    half = np.broadcast_to(np.arange(len(g))[:, None] % 2 == 1, g.shape)
    found = between(quiet, g, 0.0 * g, half, CELL, BLADES, 0.7)
    assert found.amplitudes == (0.7, 0.7)
