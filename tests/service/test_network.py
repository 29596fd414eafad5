"""A rotor's own network over HTTP: checked at once, stored, shown, and used by all that follows."""

from __future__ import annotations

from typing import Any

import httpx
import numpy as np
import pytest

from core.calibration import online
from core.observation import Inspection
from service.bootstrap import make_worker
from service.client import Client
from service.fake import FakeScience
from service.science import CoreScience
from service.settings import Settings
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker
from tests.service.smooth import TRUE, elongation, formula_science
from tests.service.test_api import refuse

Json = dict[str, Any]
URL = "/v1/rotors/r1/blades/B1"
UNIFORM = {"kind": "uniform", "low": 0.7, "high": 1.3}
SPREAD = {"kind": "log_uniform", "low": 0.01, "high": 0.3}


@pytest.fixture(scope="module")
def science() -> CoreScience:
    """The calibration itself, in place of the twin."""
    return formula_science()


def readings(**given: Any) -> list[Json]:
    """Three of blade B1 and one of B2."""
    told = [("B1", 4000.0), ("B1", 9000.0), ("B1", 16_000.0), ("B2", 9000.0)]
    return [
        {
            "id": f"i{n}",
            "blade": blade,
            "quantity": "elongation",
            "time_h": t,
            "value": round(float(elongation(TRUE, t)[0]) + e, 4),
        }
        | given
        for n, ((blade, t), e) in enumerate(zip(told, (0.002, -0.003, 0.001, 0.002), strict=True))
    ]


def create(api: httpx.Client, network: Json | None = None, rotor: str = "r1") -> Client:
    twin = Client(http=api)
    twin.create_rotor(rotor, blades=["B1", "B2"], particles=512, seed=5, network=network)
    return twin


def of_elongation(**told: Any) -> Json:
    return {"quantities": {"elongation": told}}


KINDS: list[tuple[Json, list[str]]] = [
    ({"kind": "constant", "sd": 0.02}, ["theta.elongation"]),
    ({"kind": "paper"}, ["theta1.elongation", "theta2.elongation"]),
    (
        {"kind": "gp", "length_h": 60_000.0, "sd": 0.02},
        ["theta.elongation.1", "theta.elongation.2", "theta.elongation.3"],
    ),
]


@pytest.mark.parametrize(("asked", "theta"), KINDS)
def test_a_discrepancy_adds_its_shared_parameters_and_its_part_of_the_band(
    api: httpx.Client, store: SqlStore, settings: Settings, asked: Json, theta: list[str]
) -> None:
    twin = create(api, of_elongation(discrepancy=asked))
    create(api, rotor="plain")
    for rotor in ("r1", "plain"):
        twin.post_inspections(rotor, readings(sigma=0.003))
    make_worker(store, formula_science(), settings).drain()
    assert twin.posterior("r1")["names"] == ["t1t_rate", *theta]
    assert twin.posterior("plain")["names"] == ["t1t_rate"]
    own, plain = (twin.prediction(rotor, "B1", times=[30_000.0]) for rotor in ("r1", "plain"))
    assert plain["sd"]["discrepancy"] == [0.0]
    assert own["sd"]["discrepancy"][0] > 1e-3
    parts = sum(v[0] ** 2 for name, v in own["sd"].items() if name != "total")
    assert parts == pytest.approx(own["sd"]["total"][0] ** 2)
    model = twin.model("rotor-blade")
    assert plain["rests_on"]["model_digest"] == model["digest"]
    assert own["rests_on"]["model_digest"] != model["digest"]
    assert own["rests_on"]["model_version"] == model["version"]
    assert twin.rotor("r1")["network"] == of_elongation(discrepancy=asked)
    assert twin.rotor("plain")["network"] is None


def test_a_noise_by_instrument_is_inferred_and_predicted_by_instrument(
    api: httpx.Client, worker: Worker
) -> None:
    twin = create(api, of_elongation(by_instrument=True))
    told = readings(instrument="gauge 1")
    told[1]["instrument"] = "gauge@2"
    twin.post_inspections("r1", told)
    worker.drain()
    names = ["sigma_obs.elongation@gauge 1", "sigma_obs.elongation@gauge@2"]
    assert twin.posterior("r1")["names"] == ["t1t_rate", *names]
    for name in names:
        asked = name.split("@", 1)[1]
        bands = twin.prediction("r1", "B1", times=[30_000.0], instrument=asked)
        assert (bands["instrument"], bands["noise_from"]) == (asked, "readings")
        sigma = twin.posterior("r1", "B1")["parameters"][name]
        expected = (sigma["mean"] ** 2 + sigma["sd"] ** 2) ** 0.5
        assert bands["sd"]["noise"][0] == pytest.approx(expected, rel=1e-6)
    assert twin.prediction("r1", "B1", times=[1.0])["instrument"] == "gauge 1"
    unread = twin.prediction("r1", "B1", times=[30_000.0], instrument="gauge 3")
    assert (unread["instrument"], unread["noise_from"]) == ("gauge 3", "prior")
    low, high = 1e-3, 0.2  # E sigma² of a log-uniform prior
    expected = ((high**2 - low**2) / (2 * np.log(high / low))) ** 0.5
    assert unread["sd"]["noise"][0] == pytest.approx(expected, rel=0.02)
    params = {"quantity": "ceeq", "instrument": "gauge 1", "times": "1"}
    refuse(api.get(f"{URL}/prediction", params=params), 422, "instrument")


FADED = ("fading", "plain")


def test_a_population_and_a_half_life_are_used(api: httpx.Client, worker: Worker) -> None:
    population = {"tbc_thickness": {"population": {"mean": UNIFORM, "sd": SPREAD}}}
    twin = create(api, {"parameters": population})
    create(api, {"forgetting_h": 5000}, "fading")
    for rotor in ("r1", "fading"):
        twin.post_inspections(rotor, readings(sigma=0.003))
    worker.drain()
    assert twin.posterior("r1")["names"] == ["t1t_rate", "mean.tbc_thickness", "sd.tbc_thickness"]
    create(api, rotor="plain")
    twin.post_inspections("plain", readings(sigma=0.003))
    worker.drain()
    early = [twin.prediction(r, "B1", times=[4000.0])["sd"]["parameters"][0] for r in FADED]
    assert early[0] > 1.2 * early[1], "the reading at 4000 h counts for less"


def discrepancy(**told: Any) -> Json:
    return of_elongation(discrepancy=told)


def population(mean: Json, sd: Json, name: str = "tbc_thickness") -> Json:
    return {"parameters": {name: {"population": {"mean": mean, "sd": sd}}}}


NORMAL = {"kind": "normal", "low": 0.7, "high": 1.3, "mean": 1.0, "sd": 0.1}
ELONGATION, COATING = "network.quantities.elongation", "network.parameters.tbc_thickness"
BAD: list[tuple[Json, str]] = [
    ({"colour": 1}, "network.colour"),
    ({"forgetting_h": -1.0}, "network.forgetting_h"),
    ({"forgetting_h": 0}, "network.forgetting_h"),
    ({"forgetting_h": 499.0}, "network.forgetting_h"),
    ({"forgetting_h": "long"}, "network.forgetting_h"),
    ({"quantities": {"colour": {"by_instrument": True}}}, "network.quantities.colour"),
    (of_elongation(by_instrument="yes"), f"{ELONGATION}.by_instrument"),
    (of_elongation(sigma=0.1), f"{ELONGATION}.sigma"),
    (discrepancy(kind="linear"), f"{ELONGATION}.discrepancy.kind"),
    (discrepancy(sd=0.1), f"{ELONGATION}.discrepancy.kind"),
    (discrepancy(kind="constant"), f"{ELONGATION}.discrepancy.sd"),
    (discrepancy(kind="constant", sd=-0.1), f"{ELONGATION}.discrepancy.sd"),
    (discrepancy(kind="constant", sd=20.0), f"{ELONGATION}.discrepancy.sd"),
    (discrepancy(kind="constant", sd=0.1, sigma=60.0), f"{ELONGATION}.discrepancy.sigma"),
    (discrepancy(kind="constant", sd=0.1, length_h=9e3), f"{ELONGATION}.discrepancy.length_h"),
    (discrepancy(kind="constant", prior=SPREAD), f"{ELONGATION}.discrepancy.prior"),
    (
        discrepancy(kind="constant", prior={"kind": "uniform", "low": -99, "high": 99}),
        f"{ELONGATION}.discrepancy.prior",
    ),
    (
        discrepancy(kind="constant", prior={"kind": "uniform", "low": 1, "high": 0}),
        f"{ELONGATION}.discrepancy.prior",
    ),
    (discrepancy(kind="paper", sd=2.0), f"{ELONGATION}.discrepancy"),
    (discrepancy(kind="paper", psi="creep_steady"), f"{ELONGATION}.discrepancy.psi"),
    (discrepancy(kind="gp"), f"{ELONGATION}.discrepancy.length_h"),
    (discrepancy(kind="gp", length_h=100.0), f"{ELONGATION}.discrepancy.length_h"),
    (discrepancy(kind="gp", length_h=1e-320), f"{ELONGATION}.discrepancy.length_h"),
    (discrepancy(kind="gp", length_h=6e4, sd=2.0), f"{ELONGATION}.discrepancy.sd"),
    (population(UNIFORM, SPREAD, "colour"), "network.parameters.colour"),
    (population(UNIFORM, SPREAD, "t1t_rate"), "network.parameters.t1t_rate.population"),
    (population(UNIFORM | {"high": 2.0}, SPREAD), f"{COATING}.population.mean"),
    (population(UNIFORM | {"high": 0.1}, SPREAD), f"{COATING}.population.mean"),
    (population(UNIFORM | {"mean": 0.8}, SPREAD), f"{COATING}.population.mean"),
    (population(NORMAL | {"mean": 3.0}, SPREAD), f"{COATING}.population.mean"),
    (population(NORMAL | {"sd": 1e-9}, SPREAD), f"{COATING}.population.mean"),
    (population(UNIFORM, SPREAD | {"low": 0.0}), f"{COATING}.population.sd.low"),
    (population(UNIFORM, SPREAD | {"low": 1e-9}), f"{COATING}.population.sd"),
    (population(UNIFORM, SPREAD | {"high": 1e9}), f"{COATING}.population.sd"),
    (population(UNIFORM, SPREAD | {"kind": "cauchy"}), f"{COATING}.population.sd.kind"),
]


def test_what_cannot_be_asked_of_the_model_is_refused_by_name_and_no_rotor_is_made(
    api: httpx.Client,
) -> None:
    for network, field in BAD:
        body = {"id": "r1", "model": "rotor-blade", "blades": [{"id": "B1"}], "network": network}
        refuse(api.post("/v1/rotors", json=body), 422, field)
    refuse(api.get("/v1/rotors/r1"), 404)


def test_every_fault_of_a_network_is_listed(api: httpx.Client) -> None:
    network = discrepancy(kind="constant", sd=20.0) | {"forgetting_h": 1.0}
    network["parameters"] = {"colour": {}}
    body = {"id": "r1", "model": "rotor-blade", "blades": [], "network": network}
    told = refuse(api.post("/v1/rotors", json=body), 422)
    assert [fault["field"] for fault in told["faults"]] == [
        f"{ELONGATION}.discrepancy.sd",
        "network.parameters.colour",
        "network.forgetting_h",
    ]
    refuse(api.post("/v1/rotors", json=body | {"model": "none"}), 422, "model")


def test_a_rotor_with_a_network_is_created_once(api: httpx.Client) -> None:
    body = {"id": "r1", "model": "rotor-blade", "blades": [{"id": "B1"}]}
    own = body | {"network": discrepancy(kind="paper")}
    assert api.post("/v1/rotors", json=own).json()["network"] == own["network"]
    assert api.post("/v1/rotors", json=own).headers["idempotent-replayed"] == "true"
    refuse(api.post("/v1/rotors", json=body), 409, "rotor.id")
    other = body | {"network": discrepancy(kind="paper", sd=0.01)}
    refuse(api.post("/v1/rotors", json=other), 409, "rotor.id")
    assert api.post("/v1/rotors", json=body | {"id": "plain", "network": {}}).status_code == 201
    again = api.post("/v1/rotors", json=body | {"id": "plain"})
    assert again.headers["idempotent-replayed"] == "true"


def test_a_network_that_changes_nothing_gives_the_bit_identical_state(
    api: httpx.Client, store: SqlStore, worker: Worker, science: CoreScience
) -> None:
    twin = create(api, of_elongation(by_instrument=False, discrepancy={"kind": "none"}))
    twin.post_inspections("r1", readings(instrument="gauge 1"))
    worker.drain()
    told = readings(instrument="gauge 1")
    inspections = [Inspection(values=np.array([one.pop("value")]), **one) for one in told]
    spec = online.RotorSpec("r1", ("B1", "B2"), 512, 5)
    alone = online.update(science.models.of(science.builtin("rotor-blade")), spec, inspections)
    state = twin.rotor("r1")["posterior"]
    assert state["state_digest"] == alone.digest
    assert twin.posterior("r1")["rests_on"]["model_digest"] == twin.model("rotor-blade")["digest"]


def test_the_examples_of_the_openapi_document_are_accepted_as_they_stand(api: httpx.Client) -> None:
    document = api.get("/openapi.json").json()
    for example in document["components"]["schemas"]["RotorIn"]["examples"]:
        answer = api.post("/v1/rotors", json=example)
        assert answer.status_code == 201, answer.text
        assert answer.json()["network"] == example["network"]
    prediction = document["paths"]["/v1/rotors/{r}/blades/{b}/prediction"]["get"]
    assert "instrument" in [one["name"] for one in prediction["parameters"]]


def test_a_science_that_varies_nothing_says_so() -> None:
    twin = FakeScience()
    with pytest.raises(Exception, match="BLADETWIN_SCIENCE=core"):
        twin.vary(twin.builtin("rotor-blade"), {"forgetting_h": 2e4})


def test_a_blade_that_contradicts_the_rotor_is_named_wherever_its_state_is_read(
    api: httpx.Client, worker: Worker
) -> None:
    twin = create(api)
    told = readings(sigma=0.003)
    told[3] |= {"value": 2.0, "sigma": 0.05}
    twin.post_inspections("r1", told)
    worker.drain()
    for path in ("/v1/rotors/r1", "/v1/rotors/r1/posterior", f"{URL}/prediction?times=1"):
        answer = api.get(path)
        health = answer.json()["health"]
        assert (health["status"], health["trusted"]) == ("contradicted", False)
        (one,) = health["contradicted"]
        assert (one["blade"], one["bounded"]) == ("B2", False), "of three blades none is"
        assert one["suspects"] == [], "it has no other reading that would fit without it"
        assert "B2" in health["reasons"][0]
        assert answer.headers["bladetwin-health"] == "contradicted"
