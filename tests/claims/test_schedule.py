"""The paper's schedule is overconfident: a short version here, the study's result beside it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from core.model import rotor_blade
from core.validation.schedule_study import ARMS, JOINT, run

RESULT = Path(__file__).with_name("results") / "schedule.json"
TIMES_H = (8_000.0, 16_000.0, 24_000.0, 32_000.0)
T1T, SIGMA = "t1t_rate", "sigma_obs.elongation"


def test_the_schedule_is_sharper_than_the_joint_posterior_allows() -> None:
    """Three rotors of five blades; the joint calibration, measured the same way, is the control."""
    study = run(
        rotor_blade(),
        rotors=3,
        blades=5,
        times=TIMES_H,
        seed=20,
        particles=300,
        arms={"offline": ARMS["offline"]},
    )
    joint, offline = study[JOINT], study["offline"]
    assert joint.sd_ratio(T1T) == 1
    assert max(joint.off[T1T]) == 0
    assert offline.sd_ratio(T1T) < 0.5
    assert len(offline.pit[T1T]) == len(joint.pit[T1T]) == 3
    extreme = [min(u, 1 - u) for u in offline.pit[T1T]]
    assert np.median(extreme) < min(0.1, np.median([min(u, 1 - u) for u in joint.pit[T1T]]))


def test_the_kept_study_shows_intervals_that_do_not_cover() -> None:
    """No rotor dropped; T1T is too sharp under every reading, and not in the joint posterior."""
    kept = json.loads(RESULT.read_text())
    arms = {name: arm["parameters"] for name, arm in kept["simulated"].items()}
    assert set(arms) == {JOINT, *ARMS}
    for parameters in arms.values():
        assert parameters[T1T]["truths"] == kept["rotors"] >= 10
        assert parameters["held-out reading"]["truths"] == kept["rotors"] * kept["blades"]
    spread = (0.95 * 0.05 / kept["rotors"]) ** 0.5
    assert abs(arms[JOINT][T1T]["inside_95"] - 0.95) < 3 * spread
    for name in ARMS:
        assert arms[name][T1T]["sd_ratio"] < 0.5, name
        assert arms[name][T1T]["inside_95"] < 0.95 - 3 * spread, name
    for name in ("offline", "online"):
        assert arms[name][T1T]["sd_ratio"] < 0.2
        assert arms[name]["tbc_thickness"]["inside_95"] < 0.9
