"""Coverage on simulated rotors: a short version here, the study's result beside it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from core.model import rotor_blade
from core.validation.coverage import run

RESULT = Path(__file__).with_name("results") / "coverage.json"
TIMES_H = (8_000.0, 16_000.0, 24_000.0, 32_000.0)


def test_intervals_hold_the_truth_as_often_as_they_say_and_a_wrong_spread_does_not() -> None:
    """Eight rotors of ten blades, none dropped; every interval 1.6 times too narrow must fail."""
    model = rotor_blade()
    study = run(model, rotors=8, blades=10, times=TIMES_H, seed=20, particles=1000)
    for name, values in study.pit.items():
        far = 4 * study.spread(name, 0.68)
        assert abs(study.share(name, 0.68) - 0.68) < far, (name, len(values))
    assert study.ess_ratio.min() >= 0.3
    narrow = run(model, rotors=8, blades=10, times=TIMES_H, seed=20, particles=1000, exaggerate=0.4)
    locals_ = [p.name for p in model.network.of_level("local")]
    shares = [narrow.share(name, 0.68) for name in locals_]
    assert np.mean(shares) < 0.68 - 4 * narrow.spread(locals_[0], 0.68)


def test_the_kept_study_covers() -> None:
    """The study that is kept: every share within three standard errors, no rotor dropped."""
    kept = json.loads(RESULT.read_text())
    assert kept["rotors"] >= 60
    assert kept["least_ess_ratio"] >= 0.3
    for name, row in kept["coverage"].items():
        assert row["truths"] in (kept["rotors"], kept["rotors"] * kept["blades"]), name
    for name in ("t1t_rate", "sigma_obs.elongation"):
        row = kept["coverage"][name]
        assert abs(row["inside_68"] - 0.68) < 3 * row["standard_error_68"]
        assert abs(row["inside_95"] - 0.95) < 3 * row["standard_error_95"]
