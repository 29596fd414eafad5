"""Our posteriors against stored reference posteriors (numpyro's NUTS; `core.validation.nuts`).

The files were made by ``bladetwin study reference``; nothing here needs numpyro but the test of the
target itself, which is skipped without it.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from core.calibration.online import update
from core.calibration.state import RotorSpec, RotorState
from core.calibration.target import assemble
from core.model import Model, rotor_blade
from core.validation.compare import Comparison, Stored, of_state
from core.validation.nuts import Target
from service.study_reference import readings_of

FOLDER = Path(__file__).with_name("results") / "reference"
ROTORS = sorted(path.stem for path in FOLDER.glob("*.json"))


@lru_cache
def model() -> Model:
    return rotor_blade()


@lru_cache
def kept(name: str) -> Stored:
    return Stored.load(FOLDER / f"{name}.json")


@lru_cache
def calibrated(name: str) -> RotorState:
    return update(model(), kept(name).rotor, kept(name).readings)


def compared(name: str, state: RotorState) -> Comparison:
    return Comparison.of(of_state(model(), kept(name).rotor, state), kept(name).moments)


@pytest.mark.parametrize("name", ROTORS)
def test_the_references_have_converged(name: str) -> None:
    """R-hat, effective draws of every parameter, and the thinned draws against all of them."""
    head, m = kept(name).head, kept(name).moments
    assert head["worst_r_hat"] < 1.05
    assert head["least_ess_of_blades"] > 200
    assert head["nuts"]["divergences"] < 0.01 * head["nuts"]["draws"] * head["nuts"]["chains"]
    shared = kept(name).shared
    first = len(m.names) - 1 - shared.shape[1]
    for j in range(shared.shape[1]):
        far = 5 * np.hypot(1 / np.sqrt(len(shared)), m.error_mean[0, first + j])
        assert abs(shared[:, j].mean() - m.mean[0, first + j]) < far * m.sd[0, first + j]


@pytest.mark.parametrize("name", ROTORS)
def test_means_spreads_and_correlations_are_those_of_the_reference(name: str) -> None:
    """Within 0.1 sd, 5 % and 0.05, beyond which only Monte-Carlo errors of the reference are let.

    Every parameter of every blade, the shared ones and predictions; none is left out.
    """
    found = compared(name, calibrated(name)).beyond(errors=3.0)
    assert not any(found.values()), found


@pytest.mark.parametrize("name", ROTORS[:1])
def test_a_posterior_of_other_readings_is_told_apart(name: str) -> None:
    """Negative control: one blade's readings higher by half the noise."""
    blade = kept(name).rotor.blades[0]
    sigma = kept(name).head["truth"]["sigma_obs.elongation"]
    moved = [
        replace(i, values=i.values + 0.5 * sigma) if i.blade == blade else i
        for i in kept(name).readings
    ]
    state = update(model(), kept(name).rotor, moved)
    assert any(compared(name, state).beyond(errors=3.0).values())


def test_the_sampled_target_is_the_product_of_the_readings_densities() -> None:
    """Against the rows themselves, at a point off every centre."""
    _, readings, _ = readings_of(model(), "small")
    blades = ("B000", "B001")
    target = Target.of(model(), RotorSpec("small", blades), readings)
    rng = np.random.default_rng(3)
    shared, local, total = rng.random(2), rng.random((2, 3)), 0.0
    for b, blade in enumerate(blades):
        rows = assemble(model(), [i for i in readings if i.blade == blade])
        assert rows is not None
        u = target.low + np.concatenate([shared, local[b]]) * (target.high - target.low)
        x = dict(zip(target.shared + target.local, u, strict=True))
        mean, sd = rows.response.evaluate(np.array([[x[n] for n in model().input_names]]))
        var = np.exp(2 * u[1]) + rows.extra + sd[0] ** 2
        total += float(np.sum(-0.5 * (rows.y - mean[0]) ** 2 / var - 0.5 * np.log(2 * np.pi * var)))
    assert abs(target.log_joint(np, shared, local) - total) < 1e-9 * abs(total)
