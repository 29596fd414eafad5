"""Finite-element blades without any effect, on the model that has room for effects.

The readings are those of the main job's plan on the mesh ``fine``, 0.02 mm of noise drawn anew.
Accelerating creep grows faster than the answer does: as its covariance with the residual was once
taken for a gain's, its score stood at +3.5 sd in such rotors, and three of four were alarmed.
"""

from __future__ import annotations

import numpy as np
import pytest

from core.builtin import inspection_plan
from core.calibration.online import RotorSpec, Workspace, update
from core.calibration.state import RotorState
from core.diagnosis.case import Case
from core.diagnosis.clock import with_offsets
from core.diagnosis.grammar import Facts
from core.diagnosis.scan import Scan
from core.diagnosis.scores import Scores
from core.model import Model, rotor_blade_wide
from core.observation import Inspection
from core.rng import stream

PLAN, NOISE, SEED = inspection_plan.load(), 0.02, 1


def readings(seed: int) -> tuple[Inspection, ...]:
    names, rng = list(inspection_plan.blades()), stream(seed, "clean wide")
    found = []
    for body in PLAN.inspections:
        if body["quantity"] == "elongation":
            curve = PLAN.elongation[names.index(body["blade"])]
            y = np.interp(body["time_h"], PLAN.time_h, curve) + NOISE * rng.normal()
            at = (body["id"], body["blade"], "elongation", body["time_h"], np.array([y]))
            found.append(Inspection(*at, campaign=body["campaign"]))
    return tuple(found)


def calibrated(seed: int) -> tuple[Case, RotorState, Model]:
    data = readings(seed)
    spec = RotorSpec("clean", tuple(sorted(inspection_plan.blades())), 1000, seed)
    case = Case(spec, data, with_offsets({b: Facts() for b in spec.blades}, data, {}))
    model = rotor_blade_wide()
    state = update(model, spec, data, workspace=Workspace())
    assert state.meta["health"]["status"] == "ok"
    return case, state, model


def accelerating(scan: Scan) -> float:
    (place,) = (i for i, c in enumerate(scan.cells) if c.name == "accelerating creep")
    return float(scan.z[place])


def test_nothing_is_found_in_sound_blades_and_accelerating_creep_has_no_lean(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    case, state, model = calibrated(SEED)
    scan = case.scan(model, state)
    assert scan.chance(400, 7) > 0.05
    assert abs(accelerating(scan)) < 2.0

    def like_a_gain(seen: Scores, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        mean = values.mean(axis=1)
        answer = np.where(seen.answer == 0, np.inf, seen.answer)
        return mean, mean / answer * np.einsum("bii->bi", seen.lean)

    monkeypatch.setattr(Scores, "over", like_a_gain)
    assert accelerating(case.scan(model, state)) > accelerating(scan) + 1.5
