"""Models as functions of their parameters, by the science behind the port."""

from __future__ import annotations

import numpy as np
import pytest

from core.builtin import creep_specimens
from core.errors import InputError, RangeError
from core.model import rotor_blade_wide
from service.science import CoreScience


def test_known_inputs_are_those_of_the_blade_and_no_parameters() -> None:
    science = CoreScience()
    card = science.builtin("creep-specimens")
    forward = science.forward(card, "creep_strain", "S1", {"stress": 170.0})
    assert "stress" not in forward.names
    formula = creep_specimens.formula()
    middle = dict(zip(forward.names, np.add(forward.low, forward.high) / 2, strict=True))
    asleep = {p.name: p.nominal for p in card.network.of_level("dormant")}
    for stress in (170.0, 171.0):
        given = middle | asleep | {"stress": stress}
        x = np.array([[given[i.name] for i in formula.inputs]])
        truth, _ = formula.predict(x, "creep_strain", np.array([100.5, 900.0]))
        at = science.forward(card, "creep_strain", "S1", {"stress": stress})
        mean, sd = at([middle[name] for name in at.names], [100.5, 900.0], None)
        assert mean.tolist() == truth[0].tolist()
        assert sd.shape == (2,)
    assert mean[0] != forward([*middle.values()], [100.5], None)[0][0], "negative control"
    with pytest.raises(InputError, match="stress"):
        science.forward(card, "creep_strain", None, None)


def test_dormant_inputs_sleep_and_bounds_are_kept() -> None:
    science = CoreScience()
    forward = science.forward(science.builtin("rotor-blade-wide"), "deformation", None, None)
    model = rotor_blade_wide()
    assert set(forward.names) == {i.name for i in model.surrogate.inputs}
    inside = {"tbc_thickness": 1.1, "t1t_rate": 0.87, "creep_transient": 0.4, "creep_steady": -0.5}
    psi = [inside[name] for name in forward.names]
    mean, sd = forward(psi, [24_000.5], 17)
    x = np.array([[inside[i.name] for i in model.surrogate.inputs]])
    truth = model.part("deformation").predict(x, "deformation", np.array([24_000.5]), [17])
    assert mean.tolist() == truth[0][0, :, 0].tolist()
    assert sd.tolist() == truth[1][0, :, 0].tolist()
    low, high = forward.low[0], forward.high[0]
    with pytest.raises(RangeError, match=f"{low:g} … {high:g}"):
        forward([low - 1e-6, *psi[1:]], [24_000.5], 17)
    with pytest.raises(InputError, match="give 4 values"):
        forward(psi[:3], [24_000.5], 17)
