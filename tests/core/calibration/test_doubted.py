"""A wrong reading for which a wider noise of all makes up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.calibration import bounded
from core.calibration.doubted import gain
from core.calibration.online import update
from core.calibration.state import RotorSpec, RotorState
from core.observation import Inspection
from tests.core.calibration.test_bad_data import MODEL, reading

BLADES = 10
SPEC = RotorSpec("r", tuple(f"b{i}" for i in range(BLADES)), particles=1200, seed=4)
NOISE = 0.02


def rotor(seed: int, off: float = 0.0, hours: int = 4) -> list[Inspection]:
    """y = s + l + noise that nobody states, of ten blades; the last reading is `off` noises off."""
    rng = np.random.default_rng([20_261_129, seed])
    found = []
    for b in range(BLADES):
        level = (-0.4, 0.4)[b % 2]
        for k in range(hours):
            wrong = off * (b == BLADES - 1 and k == hours - 1)
            value = 1.2 + level + NOISE * (rng.normal() + wrong)
            found.append(reading(b, value, None, 8e3 * (k + 1)))
    return found


def noise_of(state: RotorState) -> float:
    w = np.exp(state.arrays["shared/log_w"])
    place = state.meta["shared"].index("sigma_obs.y")
    return float(w @ state.arrays["shared/x"][:, place])


def told(state: RotorState) -> list[tuple[str, bool, list[str]]]:
    return [
        (one["blade"], one["bounded"], [s["reading"] for s in one["suspects"]])
        for one in state.meta["health"]["contradicted"]
    ]


def test_the_rest_keep_their_noise_and_the_reading_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    given = rotor(1, 25.0)
    without = [r for r in given if r.blade != "b9"]
    state, others = update(MODEL, SPEC, given), update(MODEL, SPEC, without)
    assert told(state) == [("b9", True, ["b9t32000"])]
    assert noise_of(state) == pytest.approx(noise_of(others), rel=0.02)
    assert update(MODEL, SPEC, given[::-1]).digest == state.digest
    monkeypatch.setattr(bounded, "TRIED", 0)
    control = update(MODEL, SPEC, given)
    assert control.meta["health"]["status"] == "ok", "the control: nobody is accused"
    assert noise_of(control) > 3 * noise_of(others)


def test_sound_rotors_place_their_nodes_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """None of twelve has a blade that is doubted, so that their states keep their bits."""
    tried: list[int] = []
    of = bounded.floor_of
    monkeypatch.setattr(bounded, "floor_of", lambda message: tried.append(1) or of(message))
    for seed in range(12):
        assert update(MODEL, SPEC, rotor(seed)).meta["health"]["status"] == "ok"
    assert tried == []


def test_what_the_evidence_does_not_ask_for_is_left_as_it_is() -> None:
    """Each reading of a blade is off by another amount: it is noise as far as anybody can tell."""
    given = [
        replace(r, values=r.values + (0.1, -0.1, 0.1, -0.1)[i % 4]) for i, r in enumerate(rotor(2))
    ]
    state = update(MODEL, SPEC, given)
    assert state.meta["health"]["status"] == "ok"
    assert noise_of(state) == pytest.approx(0.1, rel=0.4)


def test_more_readings_leave_less_to_gain() -> None:
    assert gain(30.0, 60, 32.0) > 0 > gain(30.0, 10_000, 32.0)
    assert gain(200.0, 100, 32.0) == np.inf
