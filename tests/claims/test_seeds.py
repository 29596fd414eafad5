"""Monte-Carlo error between seeds: a short version here, the study's result beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.calibration.online import Workspace
from core.calibration.state import Posterior, blade_posterior
from core.errors import InputError
from core.smc.particles import Particles
from core.validation import seeds
from core.validation.seeds import LIMIT, spread
from core.validation.variants import model_of, plan

RESULTS = Path(__file__).with_name("results")
VARIANT = plan("rotor-20", blades=3)


@pytest.fixture(scope="module")
def work() -> Workspace:
    """Of all tests here: they calibrate the same rotor with the same seeds."""
    return Workspace()


@pytest.fixture(autouse=True)
def _columns_are_kept(work: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(seeds, "Workspace", lambda: work)


def test_means_of_four_seeds_agree() -> None:
    many = spread(model_of(VARIANT), VARIANT, rotors=1, seed=9, seeds=4, particles=4000)
    assert many["table"]["t1t_rate"]["means"] == 1
    assert many["table"]["creep_steady"]["means"] == VARIANT.blades
    assert all(row["rms"] > 0 for row in many["table"].values())
    assert many["passed"]


def test_means_of_sixty_four_independent_draws_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """The negative control: what is published rests on few particles of each blade."""
    rng = np.random.default_rng(5)

    def of_few(*args: Any) -> Posterior:
        whole = blade_posterior(*args)
        few = rng.choice(len(whole.particles.w), 64, p=whole.particles.w)
        return Posterior(whole.names, Particles(whole.particles.psi[few], np.zeros(64)))

    monkeypatch.setattr(seeds, "blade_posterior", of_few)
    found = spread(model_of(VARIANT), VARIANT, rotors=1, seed=9, seeds=4, particles=1000)
    assert found["table"]["tbc_thickness"]["largest"] > LIMIT
    assert not found["passed"]


def test_one_seed_shows_nothing() -> None:
    with pytest.raises(InputError, match="8 and 1 or more"):
        spread(model_of(VARIANT), VARIANT, rotors=1, seed=7, seeds=1)


@pytest.mark.parametrize("folder", ["seeds", "seeds-mixed"])
def test_a_kept_study_is_steady(folder: str) -> None:
    kept = json.loads((RESULTS / folder / "result.json").read_text())
    assert kept["seeds"] >= 8
    assert kept["particles"] >= 10_000
    assert kept["passed"]
