"""The model as one blade has it, where effects concern some blades or run by the rotor's hours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.builtin import rotor_blade
from core.builtin.paper_network import rotor_blade_network
from core.course import Course
from core.drift import Bias, Drift
from core.model import Model
from core.network import Network, Parameter, Quantity
from core.prior import Prior
from core.surrogate.driven import Driven
from core.surrogate.formula import FormulaInput, FormulaModel

BLADE = rotor_blade.load()
TIMES = np.array([1e4, 3e4])
HOT = Drift("hot", "t1t_rate", Course.of([(0.0, 0.0), (5e4, 1.0)]))
X = {"tbc_thickness": 1.1, "t1t_rate": 0.85, "creep_transient": 0.4, "creep_steady": -0.3}


def network(*drifts: Drift, biases: tuple[Bias, ...] = ()) -> Network:
    """Firing temperatures up to 0.9, that a drift of at most 0.1 stays inside the runs."""
    plain = rotor_blade_network()
    cool = tuple(
        replace(p, prior=Prior("uniform", 0.8, 0.9)) if p.name == "t1t_rate" else p
        for p in plain.parameters
    )
    own = tuple(
        Parameter(one.name, "shared", Prior("normal", 0.0, 0.1, 0.0, 0.05))
        for one in (*drifts, *biases)
    )
    return replace(plain, parameters=(*cool, *own), drifts=drifts, biases=biases)


def elongation(model: Model, amplitude: float = 0.06) -> np.ndarray:
    given = X | {"hot": amplitude}
    x = np.array([[given[name] for name in model.input_names]])
    return model.surrogate.predict(x, "elongation", TIMES)[0][0]  # type: ignore[union-attr]


def test_a_model_whose_effects_are_all_blades_is_every_blades() -> None:
    for own in (network(), network(HOT), network(biases=(Bias("z", "ceeq", Course.of(1.0)),))):
        model = Model.of(own, BLADE)
        assert model.for_blade("B1") is model


def test_an_effect_of_one_blade_is_in_its_answers_and_in_no_others() -> None:
    plain, all_blades = Model.of(network(), BLADE), Model.of(network(HOT), BLADE)
    model = Model.of(network(replace(HOT, blades=("B2",))), BLADE)
    assert elongation(model.for_blade("B1")) == pytest.approx(elongation(plain), rel=1e-12)
    assert "hot" not in model.for_blade("B1").input_names
    assert elongation(model.for_blade("B2")) == pytest.approx(elongation(all_blades), rel=1e-12)
    assert np.all(elongation(all_blades) > 1.02 * elongation(plain)), "the effect is seen"


def test_a_blade_that_joined_late_has_the_effect_from_where_the_rotor_is() -> None:
    """Where B2 counts zero, B1 has half of the way behind it."""
    model = Model.of(network(replace(HOT, since=(("B2", 25_000.0),))), BLADE)
    shape = Course.of([(-25_000.0, 0.0), (25_000.0, 1.0)])
    begun = Drift("hot", "t1t_rate", shape, since=(("", 0.0),))
    told = elongation(Model.of(network(begun), BLADE))
    assert elongation(model.for_blade("B2")) == pytest.approx(told, rel=1e-12)
    first = elongation(model.for_blade("B1"))
    assert first == pytest.approx(elongation(Model.of(network(HOT), BLADE)), rel=1e-12)
    assert np.all(told > 1.005 * first)


def test_blades_with_the_same_effects_share_one_model() -> None:
    """Its compiled rows are made once: of all blades that have an effect, and of all others."""
    model = Model.of(network(replace(HOT, blades=("B2", "B4"))), BLADE)
    assert model.for_blade("B1") is model.for_blade("B3")
    assert model.for_blade("B2") is model.for_blade("B4")
    assert model.for_blade("B1") is not model.for_blade("B2")
    assert isinstance(model.for_blade("B2").surrogate, Driven)
    assert model.for_blade("B1").surrogate is BLADE


def test_a_bias_of_one_blade_leaves_any_surrogate_as_it_is() -> None:
    """Also one of formulas, that no input can run in."""
    formula = FormulaModel((FormulaInput("l", -1.0, 1.0),), {"y": lambda x, t: x[:, 0] * t}, "f")
    own = Network(
        "f",
        (
            Parameter("l", "local", Prior("uniform", -1.0, 1.0)),
            Parameter("rub", "shared", Prior("normal", 0.0, 1.0, 0.0, 0.2)),
        ),
        (Quantity("y", "mm", "scalar", Prior("log_uniform", 1e-3, 0.1), -9.0, 9.0),),
        biases=(Bias("rub", "y", Course.of(1.0), blades=("B2",), lasting=True),),
    )
    model = Model(own, formula)
    assert [one.name for one in model.for_blade("B2").network.biases] == ["rub"]
    assert model.for_blade("B1").network.biases == ()
    assert all(model.for_blade(blade).surrogate is formula for blade in ("B1", "B2"))
