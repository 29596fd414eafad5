"""Effects held against conditions of which no reading is known.

y = s · load + bend · load² + l, `load` known of each blade, `bend` dormant at 0.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from core.calibration.online import RotorSpec
from core.diagnosis import report, transfer
from core.diagnosis.transfer import Condition, conditions, transferred
from core.model import Model
from core.network import Network, Parameter, Quantity
from core.observation import Inspection
from core.prior import Prior
from core.surrogate.formula import FormulaInput, FormulaModel

LOADS, EACH, SIGMA = (1.0, 2.0, 3.0), 4, 0.05
BLADES = tuple(f"b{k}" for k in range(len(LOADS) * EACH))
KNOWN = {b: {"load": LOADS[k % len(LOADS)]} for k, b in enumerate(BLADES)}
SPEC = RotorSpec("r", BLADES, 1000, 2, KNOWN)


def models() -> tuple[Model, Model]:
    """Without the bend and with it."""
    parameters = (
        Parameter("s", "shared", Prior.gaussian(1.0, 0.5)),
        Parameter("l", "local", Prior.gaussian(0.0, 0.1)),
        Parameter("bend", "dormant", Prior("uniform", -1.0, 1.0), nominal=0.0),
        Parameter("load", "known", Prior("uniform", 0.5, 4.0)),
    )
    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in parameters)

    def formula(x: np.ndarray, t: float) -> np.ndarray:
        return np.asarray(x[:, 0] * x[:, 3] + x[:, 1] + x[:, 2] * x[:, 3] ** 2)

    made = FormulaModel(inputs, {"y": formula}, "loaded")
    quantity = Quantity("y", "1", "scalar", Prior("log_uniform", 0.01, 1.0), -50.0, 50.0)
    asleep = Network("loaded", parameters, (quantity,))
    awake = replace(
        asleep,
        parameters=tuple(replace(p, level="shared") if p.name == "bend" else p for p in parameters),
    )
    return Model(asleep, made), Model(awake, made)


def readings(bend: float) -> list[Inspection]:
    rng = np.random.default_rng(8)
    found = []
    for b in BLADES:
        load, own = KNOWN[b]["load"], 0.1 * rng.normal()
        for i in range(3):
            y = 1.2 * load + bend * load**2 + own + SIGMA * rng.normal()
            found.append(Inspection(f"{b}-{i}", b, "y", 1.0 + i, np.array([y]), sigma=SIGMA))
    return found


def held(bend: float) -> dict[float, Condition]:
    found = transferred(models(), SPEC, readings(bend), "y")
    assert [(c.input, c.value) for c in found] == [("load", v) for v in LOADS]
    return {c.value: c for c in found}


def test_an_effect_that_is_there_forecasts_conditions_that_were_never_read() -> None:
    found = held(0.4)
    for one in found.values():
        assert one.before.count == 3 * EACH
        assert len(one.blades) == EACH
    assert found[3.0].after.rmse < 0.4 * found[3.0].before.rmse
    assert found[3.0].holds
    told = found[3.0].to_json()
    assert told["after"]["rmse"] == found[3.0].after.rmse
    assert "z" not in told["after"]


def test_an_effect_that_is_not_there_does_not_forecast_better() -> None:
    """The control: a bend that is free though there is none only loosens the forecast."""
    found = held(0.0)
    assert found[3.0].after.rmse > 0.8 * found[3.0].before.rmse
    assert found[3.0].after.width > found[3.0].before.width


def test_a_condition_that_is_forecast_worse_does_not_hold() -> None:
    one = held(0.0)[3.0]
    worse = replace(one.before, rmse=1.1 * one.before.rmse)
    assert not replace(one, after=worse).holds
    assert replace(one, after=one.before).holds


def test_bands_that_shrink_more_than_the_error_do_not_hold() -> None:
    """A forecast that came nearer, and is too sure of it; bands that held as little before do."""
    found = held(0.4)[3.0]
    one = replace(found, before=replace(found.before, within_95=1.0))
    assert one.after.within_95 > 0.8
    assert one.fault is None
    sure = replace(one.after, within_95=0.69)
    assert replace(one, after=sure).fault == "100 % of the readings in 95 % bands become 69 %"
    assert replace(one, after=sure).to_json()["holds"] is False
    assert replace(one, before=replace(one.before, within_95=0.6), after=sure).holds


def test_errors_are_of_medians_for_means_hang_on_tails(monkeypatch: pytest.MonkeyPatch) -> None:
    """A forecast whose mean a few particles carry off, and whose middle is right."""
    real = report.predict

    def tailed(*given: Any, **more: Any) -> Any:
        got = real(*given, **more)
        return replace(got, mean=got.mean + 690.0)

    monkeypatch.setattr(report, "predict", tailed)
    assert held(0.4)[3.0].after.rmse < 1.0
    monkeypatch.setattr(transfer, "score", lambda *a, median, **m: report.score(*a, **m))
    assert held(0.4)[3.0].after.rmse > 600, "the control"


def test_two_values_or_too_many_are_no_conditions() -> None:
    two = {b: {"load": float(k % 2)} for k, b in enumerate(BLADES)}
    assert conditions(two, BLADES) == []
    many = {b: {"load": float(k)} for k, b in enumerate(BLADES)}
    assert len(many) > 8
    assert conditions(many, BLADES) == []
    assert conditions(None, BLADES) == []
    assert transferred(models(), RotorSpec("r", BLADES, 500, 1, two), readings(0.0), "y") == ()


@pytest.mark.parametrize("value", LOADS)
def test_every_blade_belongs_to_the_condition_of_its_value(value: float) -> None:
    found = {v: blades for _, v, blades in conditions(KNOWN, BLADES)}
    assert found[value] == tuple(sorted(b for b in BLADES if KNOWN[b]["load"] == value))


def test_readings_of_another_quantity_are_not_what_the_models_are_held_against() -> None:
    """Twice y, which a second gauge reads, of blades that are held out too."""
    both, more = [], []
    for model in models():
        made = model.surrogate
        assert isinstance(made, FormulaModel)
        y, (own,) = made.formulas["y"], model.network.quantities
        twice = replace(own, name="z")
        network = replace(model.network, quantities=(own, twice))
        formulas = {"y": y, "z": lambda x, t, y=y: 2.0 * y(x, t)}
        both.append(Model(network, FormulaModel(made.inputs, formulas, "twice")))
    for r in readings(0.4):
        more += [r, replace(r, id=f"{r.id}z", quantity="z", values=2.0 * r.values)]
    for one in transferred((both[0], both[1]), SPEC, more, "y"):
        assert one.before.count == one.after.count == 3 * EACH
