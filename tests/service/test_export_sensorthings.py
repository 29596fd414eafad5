"""Readings and predictions as SensorThings entities, and readings by them."""

from __future__ import annotations

import copy
import json
from random import Random
from typing import Any

import httpx
import pytest

from service.api.problems import RequestError
from service.api.reading_bodies import read_inspections
from service.api.sensorthings import ARRAY_EXAMPLE, EXAMPLE, sensorthings_rows
from service.client import Client, ProblemError
from service.export.sensorthings import MEDIA
from service.handlers.rotors import create_rotor
from service.ports import BladeRecord
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker
from tests.service.test_export_readings import READINGS, URL

Json = dict[str, Any]
SENT = {"content-type": MEDIA}


@pytest.fixture
def posted(api: httpx.Client, rotor: str, worker: Worker) -> httpx.Client:
    """Six readings, of which `a` was replaced and `d` retracted."""
    assert api.post(URL, json={"inspections": READINGS}).status_code == 202
    assert api.post(f"{URL}/d/retraction").status_code == 202
    worker.drain()
    return api


def exported(client: httpx.Client, more: str = "") -> Json:
    answer = client.get(f"{URL}?format=sensorthings{more}")
    assert answer.status_code == 200, answer.text
    told: Json = answer.json()
    return told


def send(client: httpx.Client, body: Any, rotor: str = "r1") -> httpx.Response:
    content = json.dumps(body).encode()
    return client.post(f"/v1/rotors/{rotor}/inspections", content=content, headers=SENT)


def test_what_is_exported_and_posted_again_is_the_same(
    posted: httpx.Client, store: SqlStore, worker: Worker
) -> None:
    text = posted.get(f"{URL}?format=sensorthings").content
    again = posted.post(URL, content=text, headers=SENT)
    assert (again.status_code, again.headers["idempotent-replayed"]) == (202, "true")
    assert posted.get("/v1/rotors/r1").json()["head_seq"] == 7
    create_rotor(store, "r2", "rotor-blade", [BladeRecord(b) for b in ("B1", "B2", "B3")], 64, 7)
    sent = posted.post("/v1/rotors/r2/inspections", content=text, headers=SENT)
    assert (sent.status_code, len(sent.json()["items"])) == (202, 4)
    worker.drain()
    ends = [posted.get(f"/v1/rotors/{r}").json()["posterior"] for r in ("r1", "r2")]
    assert ends[0]["events_digest"] == ends[1]["events_digest"]
    assert ends[0]["state_digest"] == ends[1]["state_digest"]
    body = json.loads(text)
    body["value"][0]["Observations"][0]["parameters"]["time_h"] += 1e-9
    refused = send(posted, body)
    assert (refused.status_code, refused.json()["title"]) == (409, "conflict"), "negative control"


def test_entities_are_those_of_the_standard(posted: httpx.Client) -> None:
    answer = posted.get(f"{URL}?format=sensorthings")
    assert answer.headers["content-type"] == MEDIA
    assert answer.headers["content-disposition"] == 'attachment; filename="r1-readings-7.json"'
    streams = {one["@iot.id"]: one for one in answer.json()["value"]}
    assert list(streams) == ["B1/elongation/=1+1", "B2/ceeq", "B2/deformation", "B3/ceeq"]
    for one in streams.values():  # what 18-088 calls mandatory of each entity
        assert {"name", "description", "observationType", "unitOfMeasurement"} <= one.keys()
        assert one["unitOfMeasurement"].keys() == {"name", "symbol", "definition"}
        assert {"name", "description"} <= one["Thing"].keys()
        assert {"name", "description", "encodingType", "metadata"} <= one["Sensor"].keys()
        assert {"name", "definition", "description"} <= one["ObservedProperty"].keys()
        for observed in one["Observations"]:
            assert {"phenomenonTime", "resultTime", "result"} <= observed.keys()
    corrected = streams["B1/elongation/=1+1"]
    assert corrected["observationType"].endswith("/OM_Measurement")
    assert corrected["unitOfMeasurement"]["symbol"] == "mm"
    assert corrected["Observations"] == [
        {
            "@iot.id": "c",
            "phenomenonTime": "2031-05-04T10:00:00+02:00",
            "resultTime": None,
            "result": 0.12,
            "parameters": {"time_h": 8000.0, "replaces": "a", "unit": None},
        }
    ]
    scan = streams["B2/deformation"]
    assert scan["observationType"].endswith("/OM_Observation")
    told = scan["Observations"][0]
    assert told["result"] == READINGS[2]["values"]
    assert told["parameters"]["nodes"] == [12, 7]
    assert told["phenomenonTime"] == posted.get(f"{URL}/scan").json()["received_at"]
    assert told["parameters"]["observed_at"] is None
    only = exported(posted, "&blade=B3")["value"]
    assert [one["@iot.id"] for one in only] == ["B3/ceeq"]


def test_the_examples_of_the_document_are_taken(api: httpx.Client, store: SqlStore) -> None:
    create_rotor(store, "r1", "rotor-blade", [BladeRecord("B01")], 64, 7)
    assert send(api, EXAMPLE).status_code == 202
    assert send(api, ARRAY_EXAMPLE).status_code == 202
    first, second = (api.get(f"{URL}/{name}").json() for name in ("i4", "i5"))
    for told in (first, second):
        assert (told["blade"], told["quantity"], told["instrument"]) == (
            "B01", "elongation", "gauge 3",
        )  # fmt: skip
        assert (told["values"], told["time_h"]) == ([0.11], 8000.0)
        assert told["observed_at"] == "2031-05-04T10:00:00Z"
    assert send(api, EXAMPLE).headers["idempotent-replayed"] == "true"


def test_a_datastream_may_be_told_by_its_entities(api: httpx.Client, rotor: str) -> None:
    """As a gateway would that never read from here; a scan and a node as data array."""
    inline = {
        "name": "gap", "unitOfMeasurement": {"name": "millimetre", "symbol": "mm"},
        "Thing": {"name": "B2"}, "ObservedProperty": {"name": "deformation"},
        "Sensor": {"name": "scanner"},
    }  # fmt: skip
    body = [
        {
            "Datastream": inline,
            "components": ["id", "result", "parameters/time_h", "parameters"],
            "dataArray@iot.count": 1,
            "dataArray": [["s", [[1, 2, 3], [4, 5, 6]], 9e3, {"nodes": [5, 9], "sigma": 0.5}]],
        },
        {
            "Datastream": {"@iot.id": "B1/ceeq"},
            "components": ["id", "result", "parameters", "resultTime"],
            "dataArray": [["n", 0.001, {"nodes": [4], "time_h": 7}, "2031-05-04T10:00:00Z"]],
        },
    ]
    assert send(api, body).status_code == 202
    scan, node = (api.get(f"{URL}/{name}").json() for name in ("s", "n"))
    assert (scan["instrument"], scan["unit"], scan["sigma"]) == ("scanner", "mm", 0.5)
    assert (scan["nodes"], scan["values"]) == ([5, 9], [[1, 2, 3], [4, 5, 6]])
    assert (node["nodes"], node["values"], node["time_h"]) == ([4], [0.001], 7.0)
    assert "observed_at" not in node, "the sender's resultTime is not the moment of the reading"


def changed(**given: Any) -> Json:
    told: Json = copy.deepcopy(EXAMPLE) | {"Datastream": {"@iot.id": "B1/elongation"}}
    for name, value in given.items():
        if value is ...:
            del told[name]
        else:
            told[name] = value
    return told


FAULTS: list[tuple[Any, str, str]] = [
    (changed(parameters=...), "parameters.time_h", "is missing"),
    (changed(result=...), "result", "is missing"),
    (changed(Datastream=...), "Datastream", "is missing"),
    (changed(Datastream={"@iot.id": 7}), "Datastream.@iot.id", "is no Datastream of a rotor"),
    (changed(Datastream={"@iot.id": "B1"}), "Datastream.@iot.id", "is no Datastream of a rotor"),
    (changed(Datastream={"Thing": {"name": "B1"}}), "Datastream.ObservedProperty", "is missing"),
    (
        changed(Datastream={"@iot.id": "B1/elongation", "Sensor": {"@iot.id": "gauge"}}),
        "Datastream.Sensor", "is not None, as the Datastream's @iot.id says",
    ),
    (changed(Datastream={"@iot.id": "B9/elongation"}), "blade", "is no blade of rotor r1"),
    (changed(FeatureOfInterest={"@iot.id": 1}), "FeatureOfInterest", "has no place in a reading"),
    (changed(resultQuality="good"), "resultQuality", "has no place in a reading"),
    (changed(parameters={"time_h": 1, "colour": 1}), "parameters.colour", "is not known"),
    (changed(parameters={"time_h": 1, "unit": "m"}), "parameters.unit", "is null, for"),
    (changed(phenomenonTime="2031-05-04/2031-05-05"), "phenomenonTime", "is an interval"),
    (changed(phenomenonTime="2031-05-04T10:00:00"), "observed_at", "is no moment"),
    (changed(result="0.11"), "value", "input should be a valid number"),
    (changed(result=77), "values", "lies outside the plausible"),
    (
        changed(Datastream={"@iot.id": "B1/elongation", "unitOfMeasurement": {"symbol": "m"}}),
        "unit", "is not the unit of elongation",
    ),
    ([], "body", "holds no Observation"),
    (7, "body", "is no object"),
    ({"value": 7}, "value", "is no list of Datastreams"),
    ({"value": [{"@iot.id": "B1/elongation"}]}, "value[0].Observations", "is missing"),
    ([{"Datastream": {"@iot.id": "B1/ceeq"}, "components": ["id", "id"], "dataArray": []}],
     "[0].components", "names one twice"),
    ([ARRAY_EXAMPLE[0] | {"dataArray@iot.count": 2}], "[0].dataArray@iot.count", "are not 1 rows"),
    ([ARRAY_EXAMPLE[0] | {"dataArray": [["i5", 0.1]]}], "[0].dataArray[0]",
     "is no list of 4 values"),
]  # fmt: skip


@pytest.mark.parametrize(("body", "field", "problem"), FAULTS)
def test_what_is_no_reading_is_refused_by_its_place(
    api: httpx.Client, rotor: str, body: Any, field: str, problem: str
) -> None:
    answer = send(api, body)
    assert answer.status_code == 422, answer.text
    fault = answer.json()["faults"][0]
    assert (fault["field"], fault["problem"][: len(problem)]) == (field, problem)
    assert fault["remedy"]
    assert api.get("/v1/rotors/r1").json()["head_seq"] == 0, "all or nothing"


def test_every_fault_of_a_document_is_told_at_once(posted: httpx.Client) -> None:
    body = exported(posted)
    body["value"][0]["Observations"][0]["validTime"] = "x"
    body["value"][1]["Observations"][0]["result"] = None
    body["value"][3]["more"] = 1
    found = [one["field"] for one in send(posted, body).json()["faults"]]
    assert found == [
        "value[0].Observations[0].validTime", "value[1].Observations[0].result", "value[3].more",
    ]  # fmt: skip


def test_a_prediction_is_exported_and_never_a_reading(posted: httpx.Client) -> None:
    path = "/v1/rotors/r1/blades/B1/prediction?times=0,8000.5,50000&probability=0.9"
    answer, said = posted.get(f"{path}&format=sensorthings"), posted.get(path).json()
    assert answer.headers["bladetwin-health"] == "ok"
    (stream,) = answer.json()["value"]
    assert stream["unitOfMeasurement"]["symbol"] == "mm"
    assert stream["properties"]["rests_on"] == said["rests_on"]
    observed = stream["Observations"]
    assert [one["result"] for one in observed] == said["mean"]
    assert [one["parameters"]["time_h"] for one in observed] == [0.0, 8000.5, 50_000.0]
    for i, one in enumerate(observed):
        assert one["parameters"]["lower"] == said["lower"][i]
        assert one["parameters"]["sd"] == {k: v[i] for k, v in said["sd"].items()}
        assert one["parameters"]["probability"] == 0.9
    versions = posted.get("/v1/rotors/r1/versions").json()["items"]
    assert observed[0]["phenomenonTime"] == versions[0]["created_at"]
    refused = send(posted, answer.json())
    assert refused.status_code == 422
    assert refused.json()["faults"][0]["field"] == "value[0].properties.kind"
    vector = posted.get(
        "/v1/rotors/r1/blades/B1/prediction?quantity=deformation&times=8000&format=sensorthings"
    ).json()["value"][0]
    assert len(vector["Observations"][0]["result"]) == 3
    assert vector["Observations"][0]["parameters"]["node"] == 6447


def test_other_types_and_broken_bodies_are_told_apart(api: httpx.Client, rotor: str) -> None:
    broken = api.post(URL, content=b'{"value": [', headers=SENT)
    assert (broken.status_code, broken.json()["title"]) == (400, "invalid json")
    other = api.post(URL, content=b"{}", headers={"content-type": "application/sensorthings"})
    assert other.status_code == 415
    assert MEDIA in other.json()["detail"]
    plain = api.post(URL, json=EXAMPLE)
    assert plain.status_code == 422, "a type of its own: application/json is a reading"


def test_a_field_that_is_given_twice_is_refused(api: httpx.Client, rotor: str) -> None:
    body = '{"@iot.id":"a","result":0.1,"parameters":{"time_h":1,"time_h":2},"Datastream":{}}'
    sent = api.post(
        f"/v1/rotors/{rotor}/inspections", content=body, headers={"content-type": MEDIA}
    )
    assert sent.status_code == 422
    (told,) = sent.json()["faults"]
    assert (told["field"], told["value"]) == ("time_h", "[1, 2]")


def test_the_client_moves_readings_between_rotors(posted: httpx.Client, store: SqlStore) -> None:
    create_rotor(store, "r2", "rotor-blade", [BladeRecord(b) for b in ("B1", "B2", "B3")], 64, 7)
    twin = Client(http=posted)
    body = twin.readings_sensorthings("r1")
    assert twin.post_sensorthings("r2", body) == 4
    one = EXAMPLE | {"Datastream": {"@iot.id": "B1/ceeq"}, "result": 0.002}
    assert twin.post_sensorthings("r2", json.dumps(one)) == 5
    with pytest.raises(ProblemError, match="422"):
        twin.post_sensorthings("r2", json.dumps(one | {"validTime": "x"}))
    assert b"prediction" in twin.prediction_sensorthings("r1", "B1", times=[8000.0])
    assert [one["id"] for one in twin.inspections("r2")] == ["c", "b", "scan", "e", "i4"]


def test_rows_keep_the_order_of_the_body() -> None:
    body = {"value": [
        {"@iot.id": "B2/ceeq", "Observations": [
            {"@iot.id": name, "result": 0.1, "parameters": {"time_h": 1}} for name in "ba"]},
        {"@iot.id": "B1/ceeq", "Observations": [
            {"@iot.id": "c", "result": 0.1, "parameters": {"time_h": 1}}]},
    ]}  # fmt: skip
    rows = sensorthings_rows(json.dumps(body).encode())
    assert [(where, row["id"]) for where, row in rows] == [
        ("value[0].Observations[0].", "b"), ("value[0].Observations[1].", "a"),
        ("value[1].Observations[0].", "c"),
    ]  # fmt: skip


ODD: list[Any] = [
    None, True, -1, 1e308, "", "a/b", "a//b", "\ud83d\ude00", [], {}, [[]], {"@iot.id": 1},
    ["id", "result"], [{"@iot.id": "B1/ceeq"}], {"kind": "prediction"},
]  # fmt: skip


def spoiled(told: Any, rng: Random) -> Any:
    """The same with something odd put in, taken out, or under another name."""
    if isinstance(told, dict) and told and rng.random() < 0.8:
        name = rng.choice(list(told))
        way = rng.random()
        if way < 0.15:
            return {k: v for k, v in told.items() if k != name}
        if way < 0.3:
            return told | {rng.choice(["x", "value", "@iot.id", "result"]): rng.choice(ODD)}
        return told | {name: spoiled(told[name], rng)}
    if isinstance(told, list) and told and rng.random() < 0.8:
        at = rng.randrange(len(told))
        return [*told[:at], spoiled(told[at], rng), *told[at + 1 :]]
    return rng.choice(ODD)


def test_whatever_is_sent_is_read_or_refused_by_place() -> None:
    stream = {
        "@iot.id": "B1/ceeq", "Thing": {"name": "B1"}, "unitOfMeasurement": {"symbol": "1"},
        "properties": {}, "Observations": [{k: v for k, v in EXAMPLE.items() if k != "Datastream"}],
    }  # fmt: skip
    document = {"value": [stream]}
    rng, read, told = Random(20310504), 0, list[RequestError]()
    for _ in range(3000):
        body: Any = rng.choice([document, EXAMPLE, ARRAY_EXAMPLE])
        for _ in range(rng.randrange(1, 4)):
            body = spoiled(body, rng)
        try:
            read += len(read_inspections(json.dumps(body).encode(), MEDIA))
        except RequestError as error:
            told.append(error)
    assert {(error.status, error.kind) for error in told} == {(422, "invalid-input")}
    assert all(one["field"] and one["remedy"] for error in told for one in error.faults)
    assert read > 50
    assert len(told) > 1000
