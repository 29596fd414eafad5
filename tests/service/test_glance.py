"""What pages show, over HTTP: blades at one hour, draws, fields, versions, operations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import numpy as np
import pytest

from core.observation import Inspection
from service.handlers.inspections import _event, retract
from service.store.unit_of_work import SqlStore
from service.worker.claiming import claim_rotor
from service.worker.loop import Worker

Json = dict[str, Any]
Post = Callable[..., int]
Reading = Callable[..., Inspection]
ROTOR = "/v1/rotors/r1"


@pytest.fixture
def told(rotor: str, post: Post, reading: Reading, worker: Worker) -> str:
    """B1 has a replaced and a correcting reading, B2 a retracted one, B3 none."""
    post(rotor, reading("i1"), reading("i2", blade="B2", time_h=9000.0))
    post(rotor, reading("i3", time_h=7000.0, value=0.12, replaces="i1"))
    retract(worker.store, rotor, "i2")
    worker.drain()
    return rotor


def test_a_blade_at_a_glance_says_what_its_own_prediction_says(
    api: httpx.Client, told: str
) -> None:
    body = api.get(f"{ROTOR}/blades?time_h=20000").json()
    assert [blade["id"] for blade in body["items"]] == ["B1", "B2", "B3"]
    assert (body["quantity"], body["unit"], body["time_h"]) == ("elongation", "mm", 20000)
    for blade in body["items"]:
        alone = api.get(f"{ROTOR}/blades/{blade['id']}/prediction?times=20000").json()
        assert blade["prediction"]["mean"] == alone["mean"][0]
        sd = {name: part[0] for name, part in alone["sd"].items()}
        own = blade["prediction"]["sd"].pop("blade")
        assert blade["prediction"]["sd"] == sd
        assert own == pytest.approx(np.sqrt(sd["total"] ** 2 - sd["noise"] ** 2), rel=1e-9)
    assert body["items"][0]["prediction"] != body["items"][2]["prediction"], "negative control"


def test_readings_of_each_blade_are_counted_by_what_counts(api: httpx.Client, told: str) -> None:
    found = {b["id"]: b["readings"] for b in api.get(f"{ROTOR}/blades").json()["items"]}
    assert (found["B1"]["counting"], found["B1"]["overruled"]) == (1, 1)
    assert (found["B1"]["last"]["id"], found["B1"]["last"]["time_h"]) == ("i3", 7000)
    assert found["B2"] == {"counting": 0, "overruled": 1, "last": None}
    assert found["B3"] == {"counting": 0, "overruled": 0, "last": None}
    api.post(f"{ROTOR}/inspections/i3/retraction")
    again = {b["id"]: b["readings"] for b in api.get(f"{ROTOR}/blades").json()["items"]}
    assert again["B1"]["last"]["id"] == "i1", "a retracted correction corrects nothing"
    assert (again["B1"]["counting"], again["B1"]["overruled"]) == (1, 1)


def test_status_and_count_follow_a_chain_through_a_retracted_correction(
    api: httpx.Client, rotor: str, post: Post, reading: Reading, worker: Worker
) -> None:
    post(rotor, reading("a"), reading("b", replaces="a"), reading("c", replaces="b"))
    circle = [_event(reading("x", replaces="y")), _event(reading("y", replaces="x"))]
    with worker.store.write() as tx:  # as a release wrote it that did not refuse one
        tx.log.append(rotor, circle)
    for retracted, counting in (("b", "c"), ("c", "a"), ("y", "ax")):
        api.post(f"{ROTOR}/inspections/{retracted}/retraction")
        worker.drain()
        items = api.get(f"{ROTOR}/inspections").json()["items"]
        assert "".join(i["id"] for i in items if i["status"] == "counts") == counting
        alone = [api.get(f"{ROTOR}/inspections/{i['id']}").json()["status"] for i in items]
        assert alone == [i["status"] for i in items]
        found = api.get(f"{ROTOR}/blades").json()["items"][0]["readings"]
        assert (found["counting"], found["last"]["id"]) == (len(counting), counting[-1])


def test_blades_come_in_pages(api: httpx.Client, told: str) -> None:
    first = api.get(f"{ROTOR}/blades?limit=2").json()
    second = api.get(f"{ROTOR}/blades?limit=2&cursor={first['next']}").json()
    assert [b["id"] for b in first["items"] + second["items"]] == ["B1", "B2", "B3"]
    assert (first["next"], second["next"]) == ("B2", None)
    assert api.get(f"{ROTOR}/blades?time_h=60000").json()["faults"][0]["field"] == "times"


def test_blades_before_the_first_posterior_are_not_yet(api: httpx.Client, rotor: str) -> None:
    answer = api.get(f"{ROTOR}/blades")
    assert (answer.status_code, answer.json()["title"]) == (409, "not yet")


def test_a_new_reading_changes_the_tag_before_it_is_applied(
    api: httpx.Client, told: str, post: Post, reading: Reading
) -> None:
    tag = api.get(f"{ROTOR}/blades").headers["etag"]
    assert api.get(f"{ROTOR}/blades", headers={"If-None-Match": tag}).status_code == 304
    post(told, reading("i9", blade="B3"))
    fresh = api.get(f"{ROTOR}/blades", headers={"If-None-Match": tag})
    assert fresh.status_code == 200
    assert fresh.json()["items"][2]["readings"]["counting"] == 1


def test_draws_have_the_moments_of_the_posterior(api: httpx.Client, told: str) -> None:
    body = api.get(f"{ROTOR}/blades/B1/draws?count=4000").json()
    posterior = api.get(f"{ROTOR}/blades/B1/posterior").json()
    values = np.array(body["values"])
    assert body["names"] == posterior["names"]
    assert values.shape == (4000, 2)
    for i, name in enumerate(body["names"]):
        own = posterior["parameters"][name]
        # 64 particles, each drawn 62 or 63 times
        assert values[:, i].mean() == pytest.approx(own["mean"], abs=0.01 * own["sd"])
        assert values[:, i].std() == pytest.approx(own["sd"], rel=0.01)
    assert api.get(f"{ROTOR}/blades/B1/draws?count=4001").status_code == 422
    other = np.array(api.get(f"{ROTOR}/blades/B2/draws?count=4000").json()["values"])
    assert abs(other[:, 1].mean() - values[:, 1].mean()) > 0.02, "negative control"


@pytest.mark.parametrize("quantity", ["deformation", "ceeq"])
def test_a_field_says_at_each_node_what_the_prediction_there_says(
    api: httpx.Client, told: str, quantity: str
) -> None:
    field = api.get(f"{ROTOR}/blades/B1/field?quantity={quantity}&time_h=30000").json()
    mean, sd = np.array(field["mean"]), np.array(field["sd"])
    assert len(mean) == 6448
    for node in (0, 3, 6447):
        path = f"{ROTOR}/blades/B1/prediction?quantity={quantity}&node={node}&times=30000"
        there = api.get(path).json()
        assert mean[node] == pytest.approx(there["mean"][0], abs=2e-6 * np.abs(mean).max())
        by_parameters = there["sd"]["parameters"][0]
        assert sd[node] == pytest.approx(by_parameters, abs=2e-6 * sd.max())


def test_a_field_that_is_none_is_refused_by_name(api: httpx.Client, told: str) -> None:
    answer = api.get(f"{ROTOR}/blades/B1/field?quantity=elongation&time_h=-1")
    assert answer.status_code == 422
    assert [fault["field"] for fault in answer.json()["faults"]] == ["quantity", "time_h"]


def test_versions_come_newest_first_in_pages(
    api: httpx.Client, told: str, post: Post, reading: Reading, worker: Worker
) -> None:
    for i in range(3):
        post(told, reading(f"v{i}", time_h=10_000.0 + i))
        worker.drain()
    first = api.get(f"{ROTOR}/versions?limit=2").json()
    second = api.get(f"{ROTOR}/versions?limit=200&cursor={first['next']}").json()
    numbers = [one["version"] for one in first["items"] + second["items"]]
    newest = api.get(ROTOR).json()
    assert numbers == list(range(newest["version"], 0, -1))
    assert first["items"][0]["state_digest"] == newest["posterior"]["state_digest"]
    assert first["items"][0]["health"] == newest["health"]
    assert api.get(f"{ROTOR}/versions?cursor=x").status_code == 422


def test_readings_are_filtered_by_blade_and_come_newest_first(api: httpx.Client, told: str) -> None:
    def ids(query: str) -> list[str]:
        return [one["id"] for one in api.get(f"{ROTOR}/inspections?{query}").json()["items"]]

    assert ids("") == ["i1", "i2", "i3"]
    assert ids("newest=true") == ["i3", "i2", "i1"]
    assert ids("blade=B1&newest=true") == ["i3", "i1"]
    assert ids("blade=B3") == []
    first = api.get(f"{ROTOR}/inspections?newest=true&limit=2").json()
    assert ids(f"newest=true&limit=2&cursor={first['next']}") == ["i1"]


def test_operations_name_the_backlog_the_worker_and_what_is_stuck(
    api: httpx.Client, told: str, store: SqlStore, post: Post, reading: Reading
) -> None:
    idle = api.get("/v1/operations").json()
    assert (idle["gauges"]["backlog"], idle["work"], idle["jobs"], idle["blocked"]) == (
        0,
        [],
        [],
        [],
    )
    post(told, reading("i8"), reading("i9", blade="B2"))
    api.post("/v1/rotors/r1/diagnoses")
    held = claim_rotor(store.engine, "r1", "worker-7", 30.0)
    assert held is not None
    busy = api.get("/v1/operations").json()
    assert (busy["gauges"]["backlog"], busy["gauges"]["outdated"]) == (2, 0)
    assert [(w["owner"], w["does"], w["rotor_id"], w["behind"]) for w in busy["work"]] == [
        ("worker-7", "applies", "r1", 2)
    ]
    assert 0 < busy["work"][0]["lease_s"] <= 30.0
    assert [(j["kind"], j["rotor"], j["status"]) for j in busy["jobs"]] == [
        ("diagnose", "r1", "queued")
    ]


def test_a_model_without_a_mesh_has_no_surface(api: httpx.Client) -> None:
    body = api.get("/v1/models/rotor-blade/surface").json()
    assert max(max(t) for t in body["triangles"]) < len(body["points"]) == 6448
    assert api.get("/v1/models/none/surface").status_code == 404
