"""Events happen to the blades that are there; slopes are derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.calibration.online import RotorSpec, update
from core.calibration.state import blade_posterior
from core.diagnosis.adopt import with_effects
from core.diagnosis.families import FAMILIES
from core.diagnosis.grammar import Cell, Facts
from core.diagnosis.masks import masks
from core.diagnosis.scoring import scores
from core.errors import InputError
from core.model import Model, rotor_blade
from core.network import Network, Parameter, Quantity
from core.observation import Inspection
from core.prior import Prior
from core.surrogate.formula import FormulaInput, FormulaModel
from tests.core.diagnosis.fleet import READING, rotor

RUB = next(f for f in FAMILIES if f.name == "tip rub")
FACTS = {"a": Facts(), "b": Facts(lot="L", offset_h=5e3), "c": Facts(lot="L", offset_h=15e3)}


def test_a_rub_concerns_the_readings_of_blades_that_were_there() -> None:
    seen, facts = rotor(1)
    rub = next(f for f in READING if f.name == "tip rub")
    cells = [Cell(rub, "step", "all", None, hour) for hour in (0.4, 0.6)]
    early, late = np.moveaxis(masks(cells, seen, facts), 2, 0)
    joined = np.array([facts[b].offset_h for b in seen.blades])
    assert np.all(early[joined == 0.0] == 1.0)
    assert np.all(early[joined == 0.5] == 0.0)
    assert np.all(late == 1.0)


@pytest.mark.parametrize(
    ("whom", "value", "blades"),
    [("all", None, ("a", "b")), ("blade", "b", ("b",)), ("lot", "L", ("b",))],
)
def test_an_adopted_rub_is_of_the_blades_that_were_there(
    whom: str, value: str | None, blades: tuple[str, ...]
) -> None:
    cell = Cell(replace(RUB, whom=(whom,)), "step", whom, value, 1e4)  # type: ignore[arg-type]
    (bias,) = with_effects(rotor_blade(), (cell,), FACTS, {"elongation": 0.02}).network.biases
    assert bias.blades == blades
    assert dict(bias.since) == {"a": 0.0, "b": 5e3, "c": 15e3}


def test_a_step_of_the_machine_is_of_blades_that_come_later_too() -> None:
    family = replace(RUB, clock="rotor")
    cell = Cell(family, "step", "all", None, 1e4)
    (bias,) = with_effects(rotor_blade(), (cell,), FACTS, {"elongation": 0.02}).network.biases
    assert bias.blades is None


def test_what_goes_on_is_no_event() -> None:
    with pytest.raises(InputError, match="no event"):
        replace(RUB, shapes=("step", "constant"))


def test_slopes_by_shared_parameters_are_derivatives_at_the_particles() -> None:
    """y = s l, so that a blade's slope by s is its mean l; regressed over particles it is not."""
    parameters = (
        Parameter("s", "shared", Prior("uniform", 0.5, 3.0)),
        Parameter("l", "local", Prior("uniform", 0.1, 2.0)),
    )
    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in parameters)
    quantity = Quantity("y", "1", "scalar", Prior("log_uniform", 0.01, 1.0), -100.0, 100.0)
    formula = FormulaModel(inputs, {"y": lambda x, t: x[:, 0] * x[:, 1]}, "product")
    model = Model(Network("product", parameters, (quantity,)), formula)
    data = [Inspection(f"r{b}", f"b{b}", "y", 8e3, np.array([0.4 + b / 4])) for b in range(5)]
    spec = RotorSpec("r", tuple(f"b{b}" for b in range(5)), 2000, 1)
    state = update(model, spec, data)
    seen = scores(model, state, data)
    for b, blade in enumerate(seen.blades):
        posterior = blade_posterior(state.meta, state.arrays.__getitem__, blade)
        w, s, level = posterior.particles.w, posterior.column("s"), posterior.column("l")
        assert seen.slope[b, 0, 0] == pytest.approx(w @ level, rel=1e-6)
        off = np.stack([level - w @ level, s - w @ s], axis=1) * np.sqrt(w)[:, None]
        y = (s * level - w @ (s * level)) * np.sqrt(w)
        assert abs(np.linalg.lstsq(off, y, rcond=None)[0][1] / (w @ level) - 1) > 0.01
