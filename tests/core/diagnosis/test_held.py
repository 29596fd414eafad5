"""From when on an effect would leave the simulation's runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from core.calibration.online import RotorSpec, update
from core.calibration.state import RotorState, blade_posterior
from core.course import Course
from core.diagnosis.held import leaving_runs
from core.drift import Drift
from core.model import Model, rotor_blade_wide
from core.network import Parameter
from core.observation import Inspection
from core.prior import Prior

NAMES = ("B1", "B2")
RAMP = Course.of([(0.0, 0.0), (5e4, -1.0), (6e4, -1.2)])


def worn(size: float, blades: tuple[str, ...] | None = None) -> tuple[Model, RotorState]:
    """Two blades whose coatings are known to lose `size` by 50,000 h, calibrated."""
    wide = rotor_blade_wide()
    drift = Drift("wear", "tbc_thickness", RAMP, "times", blades, held=True)
    amplitude = Parameter("wear", "shared", Prior("normal", 0.0, 1.0, size, 1e-4), nominal=0.0)
    network = replace(
        wide.network, parameters=(*wide.network.parameters, amplitude), drifts=(drift,)
    )
    model = Model.of(network, wide.surrogate)
    data = [
        Inspection(f"{b}-{t}", b, "elongation", t, np.array([0.25 + 5e-6 * t]), sigma=0.02)
        for b in NAMES
        for t in (8e3, 16e3)
    ]
    return model, update(model, RotorSpec("r", NAMES, 200, 1), data)


def coating(model: Model, state: RotorState, blade: str) -> float:
    found = blade_posterior(state.meta, state.arrays.__getitem__, blade)
    return float(found.particles.w @ found.column("tbc_thickness"))


def test_the_first_hour_is_that_of_the_thinnest_coating_and_every_blade_counts() -> None:
    model, state = worn(0.7)
    (said,) = leaving_runs(model, state, NAMES)
    thin = min(coating(model, state, b) for b in NAMES)
    hour = 5e4 * (1.0 - 0.4 / thin) / 0.7
    told = float(said.split(" h on ")[0].removeprefix("from ").replace(",", ""))
    assert hour < told <= hour + 1000.0, "to the next of the hours that are looked at"
    assert "wear would take tbc_thickness of 2 of 2 blades out of the runs, 0.4 … 1.33333" in said
    (one,) = leaving_runs(model, state, NAMES[:1])
    assert "1 of 1 blades" in one


def test_a_blade_that_it_does_not_concern_does_not_count() -> None:
    model, state = worn(0.7, blades=("B2",))
    (said,) = leaving_runs(model, state, NAMES)
    assert "1 of 2 blades" in said
    assert leaving_runs(model, state, ("B1",)) == []


def test_what_stays_inside_is_not_spoken_of_and_a_model_without_drifts_has_none() -> None:
    model, state = worn(0.3)
    assert leaving_runs(model, state, NAMES) == []
    assert leaving_runs(rotor_blade_wide(), state, NAMES) == []
