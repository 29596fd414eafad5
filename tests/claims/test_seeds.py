"""Monte-Carlo error between seeds: a short version here, the study's result beside it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from core.errors import InputError
from core.validation.seeds import LIMIT, spread
from core.validation.variants import model_of, plan

RESULT = Path(__file__).with_name("results") / "seeds" / "result.json"
VARIANT = plan("rotor-20", blades=5)


def test_means_of_four_seeds_agree_and_those_of_few_particles_do_not() -> None:
    """The negative control: with 768 particles per blade, means of local parameters scatter."""
    model = model_of(VARIANT)
    many = spread(model, VARIANT, rotors=1, seed=9, seeds=4, particles=10_000)
    assert many["table"]["t1t_rate"]["means"] == 1
    assert many["table"]["creep_steady"]["means"] == VARIANT.blades
    assert all(row["rms"] > 0 for row in many["table"].values())
    assert many["passed"]
    few = spread(model, VARIANT, rotors=1, seed=9, seeds=4, particles=100)
    assert few["table"]["tbc_thickness"]["largest"] > LIMIT
    assert not few["passed"]


def test_one_seed_shows_nothing() -> None:
    with pytest.raises(InputError, match="8 and 1 or more"):
        spread(model_of(VARIANT), VARIANT, rotors=1, seed=7, seeds=1)


def test_the_kept_study_is_steady() -> None:
    kept = json.loads(RESULT.read_text())
    assert kept["seeds"] >= 8
    assert kept["particles"] >= 10_000
    assert kept["passed"]
