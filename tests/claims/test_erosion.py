"""A gradual effect fits well and forecasts badly, until its amplitude is calibrated.

Eight blades whose coatings wear, by finite elements (`make_worn.py`); the network knows no wear, or
has it as one more shared parameter, a drift through the creep (`core.surrogate.driven`). Readings
of 0.003 mm noise to 24,000 h; held out is the elongation at 50,000 h. The same blades without wear
are the control: there the amplitude must not be claimed.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from core.builtin import rotor_blade
from core.builtin.paper_network import rotor_blade_network
from core.calibration.online import RotorSpec, update
from core.calibration.state import blade_posterior, shared_posterior
from core.course import Course
from core.drift import Drift
from core.model import Model
from core.network import Parameter
from core.observation import Inspection
from core.prediction import predict
from core.prior import Prior

KEPT = json.loads((Path(__file__).with_name("results") / "erosion" / "truth.json").read_text())
TIMES, LOST = np.array(KEPT["time_h"]), KEPT["lost_by_50000_h"]
LAST_H, NOISE = 24e3, 0.003
COATING, MOST = Prior("uniform", 1.0, 4 / 3), 1 / 3
WEAR = Drift("wear", "tbc_thickness", Course.of([(0.0, 0.0), (5e4, -1.0)]), "times")


@cache
def model(level: str) -> Model:
    """The network with the wear at a level: ``dormant``, there is none, or ``shared``."""
    own = rotor_blade_network()
    known = [replace(p, prior=COATING) if p.name == "tbc_thickness" else p for p in own.parameters]
    wear = Parameter("wear", level, Prior("uniform", 0.0, MOST), nominal=0.0)  # type: ignore[arg-type]
    network = replace(own, name=f"wear {level}", parameters=(*known, wear), drifts=(WEAR,))
    return Model.of(network, rotor_blade.load())


@dataclass(frozen=True)
class Found:
    """Log evidence, shared (mean, sd) by name, forecasts' errors (B,) relative and in sd."""

    evidence: float
    shared: dict[str, tuple[float, float]]
    error: np.ndarray
    z: np.ndarray


@cache
def calibrated(truth: str, level: str) -> Found:
    rng = np.random.default_rng(0)
    readings = [
        Inspection(
            f"{b} {t:g}", f"b{b}", "elongation", float(t), np.array([y + NOISE * rng.normal()])
        )
        for b, blade in enumerate(KEPT["blades"])
        for t, y in zip(TIMES, blade[truth], strict=True)
        if 0 < t <= LAST_H
    ]
    names = tuple(f"b{b}" for b in range(len(KEPT["blades"])))
    state = update(model(level), RotorSpec("r", names, 4000, 1), readings)
    get = state.arrays.__getitem__
    shared = shared_posterior(state.meta, get)
    sd = np.sqrt(np.diag(shared.particles.covariance))
    moments = dict(zip(shared.names, zip(shared.particles.mean, sd, strict=True), strict=True))
    error, z = [], []
    for name, blade in zip(names, KEPT["blades"], strict=True):
        band = predict(
            model(level), blade_posterior(state.meta, get, name), "elongation", [TIMES[-1]]
        )
        off = band.mean[0] - blade[truth][-1]
        error.append(off / blade[truth][-1])
        z.append(off / band.sd["total"][0])
    return Found(state.meta["log_evidence"], moments, np.array(error), np.array(z))


def test_the_wear_that_is_there_is_found_and_the_gas_is_not_blamed_for_it() -> None:
    found, blamed = calibrated("worn", "shared").shared, calibrated("worn", "dormant").shared
    mean, sd = found["wear"]
    assert abs(mean - LOST) < 2 * sd
    assert mean > 2.5 * sd
    assert abs(found["t1t_rate"][0] - 0.93) < 2 * found["t1t_rate"][1]
    assert blamed["t1t_rate"][0] - 0.93 > 2 * blamed["t1t_rate"][1]


def test_the_forecast_loses_its_bias_and_its_bands_hold() -> None:
    before, after = calibrated("worn", "dormant"), calibrated("worn", "shared")
    assert np.mean(before.error) < -0.05
    assert abs(np.mean(after.error)) < 0.3 * abs(np.mean(before.error))
    assert np.sqrt(np.mean(before.z**2)) > 3
    assert np.sqrt(np.mean(after.z**2)) < 1.5


def test_the_evidence_wants_it_where_it_is_and_not_where_it_is_not() -> None:
    gained = calibrated("worn", "shared").evidence - calibrated("worn", "dormant").evidence
    clean = calibrated("clean", "shared").evidence - calibrated("clean", "dormant").evidence
    assert gained > 3.0
    assert clean < 0.5


def test_without_wear_forecasts_stay_as_good() -> None:
    """The control: the amplitude's band reaches down to nothing, and no forecast is spoilt."""
    mean, sd = calibrated("clean", "shared").shared["wear"]
    assert mean < 2.5 * sd
    for level in ("dormant", "shared"):
        assert np.sqrt(np.mean(calibrated("clean", level).z ** 2)) < 1.5


@pytest.mark.parametrize("truth", ["worn", "clean"])
def test_both_networks_fit_what_they_were_shown(truth: str) -> None:
    """No residual tells them apart at a glance: the noise found is that of the readings, if a
    little more without the effect."""
    for level in ("dormant", "shared"):
        mean, sd = calibrated(truth, level).shared["sigma_obs.elongation"]
        assert NOISE - 3 * sd - 0.001 < mean < NOISE + 3 * sd + 0.001
