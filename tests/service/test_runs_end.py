"""A prediction says from which hour on an adopted effect is held at the end of the model's runs."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import httpx
import numpy as np
import pytest

from core.calibration.online import RotorSpec, update
from core.calibration.state import RotorState, blade_posterior
from core.course import Course
from core.diagnosis import Facts
from core.diagnosis.adopt import with_effects
from core.diagnosis.families import FAMILIES
from core.diagnosis.grammar import Cell
from core.diagnosis.held import ending, leaving_runs
from core.drift import Bias
from core.model import Model, rotor_blade_wide
from core.observation import Inspection
from core.prior import Prior
from core.runs_end import courses_end, held_from
from service import fields
from service.handlers.reads import basis
from service.ports import ModelCard, Which
from service.science import CoreScience
from service.store.unit_of_work import SqlStore
from service.umbridge.models import served
from service.variant import effects_between, with_more
from service.worker.loop import Worker

NAMES, SIZE = ("B1", "B2"), 0.7
FACTS = {"B1": Facts(coating_lot="C1"), "B2": Facts(coating_lot="C2")}
WEAR = Cell(next(f for f in FAMILIES if f.name == "coating wear"), "linear", "coating_lot", "C2")
BLADE = "/v1/rotors/r1/blades/B1"


@pytest.fixture(scope="module")
def worn() -> tuple[Model, RotorState]:
    """B2's coating is known to lose 70 % by 50,000 h, of which it was read for 16,000."""
    data = [
        Inspection(f"{b}-{t}", b, "elongation", t, np.array([0.25 + 5e-6 * t]), sigma=0.02)
        for b in NAMES
        for t in (8e3, 16e3)
    ]
    read_h = dict.fromkeys(NAMES, 16e3)
    grown = with_effects(rotor_blade_wide(), [WEAR], FACTS, {"elongation": 0.02}, read_h)
    (*others, amplitude) = grown.network.parameters
    sure = replace(amplitude, prior=Prior("normal", 0.0, amplitude.prior.high, SIZE, 1e-4))
    model = Model.of(replace(grown.network, parameters=(*others, sure)), grown.surrogate)
    return model, update(model, RotorSpec("r", NAMES, 200, 1), data)


@pytest.fixture(scope="module")
def science() -> CoreScience:
    return CoreScience(model=rotor_blade_wide())


@pytest.fixture
def card(science: CoreScience, worn: tuple[Model, RotorState]) -> ModelCard:
    told = with_more(None, effects_between(rotor_blade_wide().network, worn[0].network))
    return science.vary(science.builtin("rotor-blade"), json.loads(json.dumps(told)))


def test_the_first_hour_at_which_its_coating_would_be_thinner_than_any_run_s(
    science: CoreScience, card: ModelCard, worn: tuple[Model, RotorState]
) -> None:
    _, state = worn
    get = state.arrays.__getitem__
    told = science.held_from(card, state.meta, get, "B2", None)
    found = blade_posterior(state.meta, get, "B2")
    coating = float(found.particles.w @ found.column("tbc_thickness"))
    hour = 5e4 * (1.0 - 0.4 / coating) / SIZE
    assert told is not None
    assert hour < told <= hour + 1000.0, "to the next of the hours that are looked at"
    thicker = science.held_from(card, state.meta, get, "B2", {"tbc_thickness": 1.3})
    assert thicker == pytest.approx(5e4 * (1.0 - 0.4 / 1.3) / SIZE, abs=1000.0)
    assert science.held_from(card, state.meta, get, "B1", None) is None, "of another coating"


def test_a_model_without_effects_is_held_nowhere(
    science: CoreScience, worn: tuple[Model, RotorState]
) -> None:
    plain = science.builtin("rotor-blade")
    _, state = worn
    assert science.held_from(plain, state.meta, state.arrays.__getitem__, "B2", None) is None
    assert leaving_runs(rotor_blade_wide(), state, NAMES) == []


def test_a_verdict_says_it_of_all_blades_together(worn: tuple[Model, RotorState]) -> None:
    (said,) = leaving_runs(*worn, NAMES)
    assert f"{WEAR.name} would take tbc_thickness of 1 of 2 blades out of the runs, 0.4 … " in said
    assert "later hours have too little of the effect" in said
    assert leaving_runs(*worn, ("B1",)) == []


def test_a_verdict_knows_the_inputs_that_are_given(worn: tuple[Model, RotorState]) -> None:
    """They are in no posterior: of one without a nominal value the hour was that of an input 0."""
    hour = lambda thick: held_from(  # noqa: E731
        worn[0], blade_posterior(worn[1].meta, worn[1].arrays.__getitem__, "B2"), "B2", thick
    )["tbc_thickness"]
    given = {"tbc_thickness": 1.3}
    (said,) = leaving_runs(*worn, NAMES, {"B2": given})
    assert hour(given) > hour(None)
    assert said.startswith(f"from {hour(given):,.0f} h on ")


def test_what_grows_is_told_until_its_course_ends(
    science: CoreScience,
    card: ModelCard,
    worn: tuple[Model, RotorState],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Runs of 150,000 h go on for longer: lives were too long, and nothing said so."""
    model, state = worn
    horizon = model.surrogate.horizon_h
    assert courses_end(model.network, "B2", horizon) == {WEAR.name: 6e4}
    assert courses_end(model.network, "B1", horizon) == {}, "of another coating"
    assert courses_end(model.network, "B2", 5e4) == {}, "a model that ends before"
    monkeypatch.setattr("service.beliefs.held_from", lambda *_: {})
    get = state.arrays.__getitem__
    told = [science.held_from(card, state.meta, get, blade, None) for blade in NAMES]
    assert told == [None, 6e4]
    (said,) = ending(model, NAMES)
    assert said.startswith(f"how {WEAR.name} goes on from 60,000 h on is not known: it stays")


def test_a_course_by_the_rotor_s_hours_ends_earlier_in_a_younger_blade(
    worn: tuple[Model, RotorState],
) -> None:
    (drift,) = worn[0].network.drifts
    shared = replace(drift, blades=None, since=(("B1", 0.0), ("B2", 1e4)))
    step = replace(drift, name="spalled", shape=Course.of([(9e3, 0.0), (9e3, -1.0)]))
    rub = Bias("rub", "elongation", Course.of([(0.0, 0.0), (6e4, 1.0)]), lasting=True)
    gauge = replace(rub, name="gauge", lasting=False)
    (*inputs, amplitude) = worn[0].network.parameters
    more = [replace(amplitude, name=one.name) for one in (step, rub, gauge)]
    network = replace(
        worn[0].network,
        parameters=(*inputs, amplitude, *more),
        drifts=(shared, step),
        biases=(rub, gauge),
    )
    ends = [courses_end(network, blade, 1.5e5) for blade in NAMES]
    assert ends == [{drift.name: 6e4, "rub": 6e4}, {drift.name: 5e4, "rub": 6e4}]


def test_prediction_and_life_say_it(
    rotor: str, api: httpx.Client, worker: Worker, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert api.post(
        f"/v1/rotors/{rotor}/inspections",
        json={"inspections": [
            {"id": "i1", "blade": "B1", "quantity": "elongation", "time_h": 8e3, "values": [0.2]}
        ]},
    ).status_code == 202  # fmt: skip
    worker.drain()
    asked = (f"{BLADE}/prediction?times=24000", f"{BLADE}/life?limit=0.5")
    assert [api.get(one).json()["held_from_h"] for one in asked] == [None, None]
    monkeypatch.setattr(CoreScience, "held_from", lambda *_: 41_000.0)
    later = (f"{BLADE}/prediction?times=24001", f"{BLADE}/life?limit=0.51")
    assert [api.get(one).json()["held_from_h"] for one in later] == [41_000.0] * 2


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)  # fields are no database's
def test_lists_series_and_files_say_it(
    rotor: str, api: httpx.Client, worker: Worker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of B2 alone, from 41,000 h on; a field's numbers are not looked at."""
    monkeypatch.setattr(fields, "ENOUGH", 8)
    one = {"id": "i1", "blade": "B1", "quantity": "elongation", "time_h": 8e3, "values": [0.2]}
    told = api.post(f"/v1/rotors/{rotor}/inspections", json={"inspections": [one]})
    assert told.status_code == 202
    worker.drain()

    def of_b2(*given: object) -> float | None:
        return 41_000.0 if given[4] == "B2" else None

    monkeypatch.setattr(CoreScience, "held_from", of_b2)
    base, other = f"/v1/rotors/{rotor}", BLADE.replace("B1", "B2")
    blades = api.get(f"{base}/blades?time_h=50000").json()["items"]
    assert {b["id"]: b["prediction"]["held_from_h"] for b in blades} == {
        "B1": None, "B2": 41_000.0, "B3": None
    }  # fmt: skip
    rows = api.get(f"{base}/series?times=40000,41000,50000").json()["items"]
    assert {(r["blade"], r["time"]) for r in rows if r["held"]} == {("B2", 41e3), ("B2", 5e4)}
    assert len(rows) == 9
    csv = api.get(f"{other}/prediction?times=40000,41000&format=csv").text.splitlines()
    assert [line.rpartition(",")[2] for line in csv] == ["held", "false", "true"]
    (stream,) = api.get(f"{other}/prediction?times=40000&format=sensorthings").json()["value"]
    assert stream["properties"]["held_from_h"] == 41_000.0
    assert api.get(f"{other}/field?time_h=50000").json()["held_from_h"] == 41_000.0
    arrays = np.load(io.BytesIO(api.get(f"{other}/field?times=50000&format=npz").content))
    assert json.loads(str(arrays["facts"]))["held_from_h"] == "41000.0"
    assert b"41000.0" in api.get(f"{other}/field?time_h=50000&format=vtu").content


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
def test_um_bridge_says_it(
    rotor: str,
    store: SqlStore,
    science: CoreScience,
    worker: Worker,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its predictions are those of the service, and what they lack was said there alone."""
    worker.drain()
    monkeypatch.setattr(CoreScience, "held_from", lambda *_: 41_000.0)
    models = served(store, science, basis(store, science, rotor, Which(), "B2"))
    assert models["elongation.posterior"].info()["held_from_h"] == 41_000.0
