"""Known inputs of blades over HTTP, on a model that has two: e = (s + l) x + shift."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from core.model import Model
from core.network import Network, Parameter, Quantity
from core.prior import Prior
from core.surrogate.formula import FormulaInput, FormulaModel
from service.bootstrap import make_worker
from service.client import Client
from service.science import CoreScience
from service.settings import Settings
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker
from tests.service.test_api import refuse

Json = dict[str, Any]
S, L = Prior.gaussian(2.0, 0.2), Prior.gaussian(0.0, 0.1)


def loaded() -> CoreScience:
    """s shared, l local; the load x has to be given, the shift is 0 unless it is."""
    network = Network(
        "loaded",
        (
            Parameter("s", "shared", S),
            Parameter("l", "local", L),
            Parameter("load", "known", Prior("uniform", 1.0, 3.0), "kN"),
            Parameter("shift", "known", Prior("uniform", -1.0, 1.0), "mm", nominal=0.0),
        ),
        (Quantity("elongation", "mm", "scalar", Prior("log_uniform", 1e-3, 0.2), -50.0, 50.0),),
    )
    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in network.parameters)
    formula = FormulaModel(
        inputs, {"elongation": lambda x, t: (x[:, 0] + x[:, 1]) * x[:, 2] + x[:, 3]}, "loaded", 10.0
    )
    return CoreScience(model=Model(network, formula))


@pytest.fixture(scope="module")
def science() -> CoreScience:
    return loaded()


def test_each_blade_is_updated_and_predicted_with_its_own_known_inputs(
    api: httpx.Client, store: SqlStore, settings: Settings
) -> None:
    twin = Client(http=api)
    given = [{"load": 1.0}, {"load": 3.0, "shift": 0.5}]
    blades = [{"id": f"B{i + 1}", "known": known} for i, known in enumerate(given)]
    twin.create_rotor("r1", blades=blades, particles=2048)
    y, sigma = 5.6, 0.3
    reading = {"id": "i", "blade": "B2", "quantity": "elongation", "time_h": 5.0, "value": y}
    twin.post_inspections("r1", [reading | {"sigma": sigma}])
    twin.add_blade("r1", {"id": "B3", "known": {"load": 2.0, "shift": -0.5}})
    make_worker(store, loaded(), settings).drain()
    # y - 0.5 = 3 (s + l) + e: the gain of s is 3 * 0.2^2 / (9 (0.2^2 + 0.1^2) + sigma^2).
    variance = 9 * (0.2**2 + 0.1**2) + sigma**2
    s = 2.0 + 3 * 0.2**2 / variance * (y - 0.5 - 3 * 2.0)
    expected = {"B1": s, "B2": 0.0, "B3": 2 * s - 0.5}
    expected["B2"] = 3 * (2.0 + 3 * (0.2**2 + 0.1**2) / variance * (y - 6.5)) + 0.5
    for blade, mean in expected.items():
        assert twin.prediction("r1", blade, times=[5.0])["mean"][0] == pytest.approx(mean, abs=0.02)
    known = {blade["id"]: blade["known"] for blade in twin.rotor("r1")["blades"]}
    assert known == {"B1": given[0], "B2": given[1], "B3": {"load": 2.0, "shift": -0.5}}


def test_a_plan_for_a_blade_that_has_left_knows_its_inputs(
    api: httpx.Client, store: SqlStore, settings: Settings
) -> None:
    twin = Client(http=api)
    blades = [{"id": "B1", "known": {"load": 1.0}}, {"id": "B2", "known": {"load": 3.0}}]
    twin.create_rotor("r1", blades=blades, particles=2048)
    reading = {"id": "i", "blade": "B2", "quantity": "elongation", "time_h": 5.0, "value": 5.6}
    twin.post_inspections("r1", [reading | {"sigma": 0.3}])
    twin.retire_blade("r1", "B2")
    make_worker(store, loaded(), settings).drain()
    told = twin.plan("r1", blade="B2", time_h=5.0)
    band = twin.prediction("r1", "B2", times=[5.0])
    assert told["target"]["mean"] == pytest.approx(band["mean"][0], abs=0.05)
    assert {one["blade"] for one in told["single"]} == {"B1"}


BAD: list[tuple[Json | None, str]] = [
    (None, "known.load"),
    ({}, "known.load"),
    ({"shift": 0.1}, "known.load"),
    ({"load": 3.5}, "known.load"),
    ({"load": 2.0, "shift": -2.0}, "known.shift"),
    ({"load": 2.0, "s": 2.0}, "known.s"),
    ({"load": 2.0, "colour": 2.0}, "known.colour"),
    ({"load": "2"}, "known.load"),
]


def test_known_inputs_that_are_missing_or_not_the_models_are_refused_by_name(
    api: httpx.Client,
) -> None:
    good = {"id": "B1", "known": {"load": 2.0}}
    body = {"id": "r1", "model": "rotor-blade", "blades": [good]}
    assert api.post("/v1/rotors", json=body).status_code == 201
    for known, field in BAD:
        blade = {"id": "B2", "known": known}
        refuse(api.post("/v1/rotors/r1/blades", json=blade), 422, field)
        wrong = body | {"id": "r2", "blades": [good, blade]}
        refuse(api.post("/v1/rotors", json=wrong), 422, f"blades[1].{field}")
    refuse(api.get("/v1/rotors/r2"), 404)
    assert len(api.get("/v1/rotors/r1").json()["blades"]) == 1


def test_the_same_blade_again_gets_the_same_answer_and_other_known_inputs_conflict(
    api: httpx.Client, worker: Worker
) -> None:
    body = {"id": "r1", "model": "rotor-blade", "blades": [{"id": "B1", "known": {"load": 2.0}}]}
    assert api.post("/v1/rotors", json=body).status_code == 201
    assert api.post("/v1/rotors", json=body).headers["idempotent-replayed"] == "true"
    other = body | {"blades": [{"id": "B1", "known": {"load": 2.5}}]}
    refuse(api.post("/v1/rotors", json=other), 409, "rotor.id")
    joining = {"id": "B2", "known": {"shift": 0.1, "load": 2.0}}
    first = api.post("/v1/rotors/r1/blades", json=joining)
    again = {"id": "B2", "known": {"load": 2.0, "shift": 0.1}}
    assert api.post("/v1/rotors/r1/blades", json=again).json() == first.json()
    refuse(api.post("/v1/rotors/r1/blades", json=joining | {"known": {"load": 1.0}}), 409)
