"""A rotor whose first dozen blades lead to a corner of the box is placed all the same."""

from __future__ import annotations

from typing import Any

import pytest

from core.calibration import rotor
from core.calibration.online import RotorSpec, begun
from core.calibration.step import Step
from core.validation.coverage import model_of
from core.validation.simulate import simulate
from core.validation.variants import plan

ROTOR, SEED = 293, 8  # of the study kept in tests/claims/results/rotor-100: the one that was not


def placed() -> Step:
    variant = plan("rotor-100")
    model = model_of(variant)
    made = simulate(model, variant, ROTOR, SEED)
    spec = RotorSpec(f"{variant.name}-{ROTOR}", tuple(made.local), 1000, SEED)
    return begun(model, spec, made.readings)


def test_all_blades_from_the_whole_box_find_what_a_dozen_do_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scouts, descend = list[int](), rotor.descend

    def noted(*given: Any, **named: Any) -> Any:
        scouts.append(len(given[2]))
        return descend(*given, **named)

    monkeypatch.setattr(rotor, "descend", noted)
    found = placed()
    assert found.weighed.ess_ratio > 0.7
    unit = dict(zip(found.space.names, found.weighed.proposal.mean, strict=True))
    assert unit["t1t_rate"] == pytest.approx(0.92, abs=0.02)  # truth: 0.946, sd 0.03
    assert unit["sigma_obs.elongation"] > 0.25
    # the last descent has all nodes for scouts: before it less than a twentieth of the nodes
    # carried the posterior, wherever the dozen led
    assert scouts[-1] == len(found.weighed.unit) > max(scouts[:-1])
