"""The routes over a real connection, on both databases."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, ClassVar

import httpx
import pytest
from sqlalchemy.exc import OperationalError

from core.calibration.health import verdict
from service.bootstrap import make_worker
from service.client import BlockedError, Client, ProblemError
from service.errors import FaultsError
from service.fake import FakeScience, FakeState
from service.handlers.rotors import check_network
from service.settings import Settings
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker
from tests.patience import PATIENCE_S

Json = dict[str, Any]
ROTOR: Json = {
    "id": "r1",
    "model": "rotor-blade",
    "blades": [{"id": "B1", "slot": "1"}, {"id": "B2"}],
    "particles": 1000,
}


def one(name: str = "i1", **given: Any) -> Json:
    body = {"id": name, "blade": "B1", "quantity": "elongation", "time_h": 8000.0, "value": 0.11}
    body |= {"unit": "mm"} | given
    return {key: value for key, value in body.items() if value is not None}


@pytest.fixture
def created(api: httpx.Client) -> httpx.Client:
    assert api.post("/v1/rotors", json=ROTOR).status_code == 201
    return api


def head(api: httpx.Client) -> int:
    return int(api.get("/v1/rotors/r1").json()["head_seq"])


def refuse(answer: httpx.Response, status: int, field: str | None = None) -> Json:
    """The answer is a problem of one shape, and the field is named with value and remedy."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    body: Json = answer.json()
    assert set(body) == {"type", "title", "status", "detail", "instance", "faults"}
    assert body["status"] == status
    assert body["type"].startswith("urn:bladetwin:problem:")
    assert body["instance"] == answer.request.url.path
    assert body["detail"]
    for fault in body["faults"]:
        assert set(fault) == {"field", "value", "problem", "remedy"}
        assert fault["remedy"]
    if field is not None:
        assert field in [fault["field"] for fault in body["faults"]]
    return body


def test_a_posted_reading_is_applied_and_named_by_what_is_read(
    created: httpx.Client, worker: Worker
) -> None:
    answer = created.post("/v1/rotors/r1/inspections", json=one())
    assert answer.status_code == 202
    assert answer.json() == {
        "items": [{"id": "i1", "seq": 1, "status": "accepted"}],
        "head_seq": 1,
    }
    worker.drain()
    view = created.get("/v1/rotors/r1").json()
    assert (view["head_seq"], view["applied_seq"], view["version"]) == (1, 1, 1)
    assert view["status"] == "current"
    rests = created.get("/v1/rotors/r1/posterior").json()["rests_on"]
    assert (rests["version"], rests["through_seq"], rests["sealed"]) == (1, 1, True)
    assert rests["model_version"] == view["model_version"]
    assert rests["events_digest"] == view["posterior"]["events_digest"]


def test_a_prediction_is_the_exact_one(created: httpx.Client, worker: Worker) -> None:
    worker.drain()
    url = "/v1/rotors/r1/blades/B1/prediction"
    body = created.get(url, params={"times": "25000,50000", "probability": "0.5"}).json()
    # Prior of the rate: 0.5 with variance 0.1² + 0.2²; noise 0.02.
    assert body["mean"] == pytest.approx([0.25, 0.5])
    assert body["sd"]["parameters"] == pytest.approx([0.05**0.5 / 2, 0.05**0.5])
    assert body["sd"]["total"][1] == pytest.approx((0.05 + 0.02**2) ** 0.5)
    half = 0.6744897501960817 * (0.05 + 0.02**2) ** 0.5
    assert body["upper"][1] == pytest.approx(0.5 + half)
    assert body["lower"][1] == pytest.approx(0.5 - half)
    assert body["quantiles"]["0.5"] == body["mean"]
    vector = created.get(url, params={"quantity": "deformation", "times": "50000"}).json()
    assert vector["node"] == 6447
    assert vector["mean"] == [pytest.approx([0.0, 0.0, 0.5])]
    field = created.get(url, params={"quantity": "ceeq", "node": "critical", "times": "1"})
    assert field.json()["node"] == 3
    assert len(created.get(url).json()["time_h"]) == 6, "the model's own times by default"


QUESTIONS: list[tuple[dict[str, str], str]] = [
    ({"quantity": "colour"}, "quantity"),
    ({"times": "8000,soon"}, "times"),
    ({"times": "24,000"}, "times"),
    ({"times": "nan"}, "times"),
    ({"times": "1e999"}, "times"),
    ({"times": "-1"}, "times"),
    ({"times": "50001"}, "times"),
    ({"times": ""}, "times"),
    ({"node": "5"}, "node"),
    ({"quantity": "deformation", "node": "6448"}, "node"),
    ({"quantity": "deformation", "node": "9" * 5000}, "node"),
    ({"quantity": "deformation", "node": "root"}, "node"),
    ({"probability": "1.0"}, "probability"),
    ({"probability": "nan"}, "probability"),
    ({"probability": "often"}, "probability"),
    ({"version": "0"}, "version"),
    ({"instrument": "gauge 1"}, "instrument"),
    ({"instrument": ""}, "instrument"),
]


def test_a_question_that_has_no_answer_is_refused_by_name(
    created: httpx.Client, worker: Worker
) -> None:
    worker.drain()
    for params, field in QUESTIONS:
        answer = created.get("/v1/rotors/r1/blades/B1/prediction", params=params)
        refuse(answer, 422, field)


def test_the_same_reading_again_gets_the_same_answer(created: httpx.Client) -> None:
    batch = {"inspections": [one("a"), one("b", time_h=9000.0)]}
    first = created.post("/v1/rotors/r1/inspections", json=batch)
    created.post("/v1/rotors/r1/inspections", json=one("c"))
    again = created.post("/v1/rotors/r1/inspections", json=batch)
    assert again.json() == first.json()
    assert "idempotent-replayed" not in first.headers
    assert again.headers["idempotent-replayed"] == "true"
    spelled = one("a", value=None, values=[0.11])
    assert created.post("/v1/rotors/r1/inspections", json=spelled).json()["head_seq"] == 1
    assert head(created) == 3


def test_another_reading_of_the_same_id_is_a_conflict(created: httpx.Client) -> None:
    created.post("/v1/rotors/r1/inspections", json=one("a"))
    batch = {"inspections": [one("new"), one("a", value=0.12)]}
    body = refuse(created.post("/v1/rotors/r1/inspections", json=batch), 409, "inspection.id")
    assert [fault["value"] for fault in body["faults"]] == ["a"]
    twice = {"inspections": [one("z"), one("z", value=0.12)]}
    refuse(created.post("/v1/rotors/r1/inspections", json=twice), 409)
    assert head(created) == 1


BAD: list[tuple[Json, str]] = [
    (one(blade="B9"), "blade"),
    (one(quantity="colour"), "quantity"),
    (one(unit="m"), "unit"),
    (one(colour="red"), "colour"),
    (one(time_h=-1.0), "time_h"),
    (one(time_h=50_001.0), "time_h"),
    (one(time_h="8000"), "time_h"),
    (one(time_h=True), "time_h"),
    (one(time_h=None), "time_h"),
    (one(value="0.1"), "value"),
    (one(value=1234.0), "values"),
    (one(value=None), "value"),
    (one(values=[0.1]), "value"),
    (one(sigma=0.0), "sigma"),
    (one(sigma=-0.1), "sigma"),
    (one(sigma=1e300), "sigma"),
    (one(sigma=55.1), "sigma"),
    (one(nodes=[3]), "nodes"),
    (one(id="a b"), "id"),
    (one(id="a/b"), "id"),
    (one(id="x" * 101), "id"),
    (one(replaces="i1"), "replaces"),
    (one(observed_at="yesterday"), "observed_at"),
    (one(observed_at="2031-05-04T10:00:00"), "observed_at"),
    (one(campaign="a\x00b"), "campaign"),
    (one(campaign="outage 1 "), "campaign"),
    (one(instrument=" gauge 3"), "instrument"),
    (one(quantity="deformation", value=None, values=[[0.1, 0.1, 0.1]]), "nodes"),
    (one(quantity="deformation", value=None, values=[[0.1, 0.1, 0.1]], nodes=[6448]), "nodes"),
    (one(quantity="deformation", value=None, values=[[0.1, 0.1, 0.1]], nodes=[-1]), "nodes[0]"),
    (one(quantity="deformation", value=None, values=[[0.1, 0.1, 0.1]], nodes=[10**30]), "nodes[0]"),
    (one(quantity="deformation", value=None, values=[[0.1, 0.1]], nodes=[1]), "values"),
    (one(quantity="deformation", value=None, values=[[0.1], [0.1, 0.2]], nodes=[1, 2]), "body"),
    (one(quantity="deformation", value=None, values=[[0.1, "x", 0.1]], nodes=[1]), "values[0][1]"),
    (one(quantity="ceeq", unit="1", value=0.01, nodes=[7000]), "nodes"),
]


def test_a_reading_that_cannot_be_used_is_refused_by_name_and_not_stored(
    created: httpx.Client,
) -> None:
    for body, field in BAD:
        refuse(created.post("/v1/rotors/r1/inspections", json=body), 422, field)
        many = {"inspections": [one("good"), body]}
        if field != "body":
            sent = created.post("/v1/rotors/r1/inspections", json=many)
            refuse(sent, 422, f"inspections[1].{field}")
    assert head(created) == 0


RAW: list[tuple[str, int, str | None]] = [
    (
        '{"id":"a","blade":"B1","quantity":"elongation","time_h":1,"value":1,"value":2}',
        422,
        "value",
    ),
    ('{"id":"a","blade":"B1","quantity" : "elongation","time_h":1,"value":1,"id" :"b"}', 422, "id"),
    (
        '{"inspections":[{"id":"a","blade":"B1","quantity":"elongation","time_h":1,"value":0.1,'
        '"campaign":"c","campaign":"c"}]}',
        422,
        "campaign",
    ),
    ('{"inspections":[{"id":"a"}],"inspections":[{"id":"b"}]}', 422, "inspections"),
    ('{"id":"a","blade":"B1","quantity":"elongation","time_h":NaN,"value":0.1}', 422, "time_h"),
    ('{"id":"a","blade":"B1","quantity":"elongation","time_h":1,"value":Infinity}', 422, "value"),
    ('{"id":"a","blade":"B1","quantity":"elongation","time_h":1,"value":-Infinity}', 422, "value"),
    ('{"id":"a","blade":"B1","quantity":"elongation","time_h":1,"value":1e999}', 422, "value"),
    ('{"id":"a","blade":"B1","quantity":"elongation","time_h":1,"values":[NaN]}', 422, "values[0]"),
    ('{"id":"a","blade":"B1"', 400, None),
    ("", 400, None),
    ("[" * 100_000, 400, None),
    ("null", 422, "body"),
    ("[]", 422, "body"),
    ('"text"', 422, "body"),
    ('{"inspections": []}', 422, "inspections"),
    ('{"inspections": {}}', 422, "inspections"),
    ('{"inspections": [1]}', 422, "inspections[0].body"),
    ('{"inspections": [], "colour": "red"}', 422, "colour"),
    ('{"id": "\ud800"}', 400, None),
]


def test_a_body_that_is_no_reading_is_refused(created: httpx.Client) -> None:
    headers = {"content-type": "application/json"}
    for text, status, field in RAW:
        content = text.encode("utf-8", "surrogatepass")
        sent = created.post("/v1/rotors/r1/inspections", content=content, headers=headers)
        refuse(sent, status, field)
    assert head(created) == 0


@pytest.mark.parametrize("text", [
    '{"\\ud800": 1}', '{"inspections": [{"\\udc00x": 1}]}', '{"inspections": [{"id": "\\ud800"}]}',
    '{"inspections": [], "\\ud800": 1}', '["\\ud800"]', '"\\ud800"',
])  # fmt: skip
@pytest.mark.parametrize("path", ["/v1/rotors", "/v1/rotors/r1/inspections", "/v1/webhooks",
                                  "/v1/rotors/r1/diagnoses", "/v1/models"])  # fmt: skip
def test_half_a_character_is_refused_like_any_other_fault(
    created: httpx.Client, path: str, text: str
) -> None:
    headers = {"content-type": "application/json"}
    answer = created.post(path, content=text.encode(), headers=headers)
    assert answer.status_code in (400, 422), answer.text
    assert answer.json()["detail"]


def test_a_bare_list_is_refused_with_the_shape_of_a_batch(created: httpx.Client) -> None:
    told = refuse(created.post("/v1/rotors/r1/inspections", json=[one(), one("i2")]), 422)
    assert told["faults"][0]["remedy"].startswith('give {"inspections": […]}')
    assert head(created) == 0


def test_every_fault_of_a_batch_is_listed_by_its_index(created: httpx.Client) -> None:
    bad = one("a", blade="B9", unit="m", time_h=-1.0, value=1e6)
    batch = {"inspections": [bad, one("b"), one("c", time_h=-2.0)]}
    body = refuse(created.post("/v1/rotors/r1/inspections", json=batch), 422)
    named = [fault["field"] for fault in body["faults"]]
    assert named == [
        *(f"inspections[0].{field}" for field in ("blade", "unit", "time_h", "values")),
        "inspections[2].time_h",
    ]
    assert body["faults"][4]["value"] == -2.0


def test_a_row_that_cannot_be_read_hides_no_fault_of_the_others(created: httpx.Client) -> None:
    batch = {"inspections": [one("a", value="long"), one("b", blade="B9"), one("c")]}
    body = refuse(created.post("/v1/rotors/r1/inspections", json=batch), 422)
    named = [fault["field"] for fault in body["faults"]]
    assert named == ["inspections[0].value", "inspections[1].blade"]
    assert head(created) == 0


ROWS: list[tuple[Json, list[str]]] = [
    ({"value": "long", "blade": "B9"}, ["value", "blade"]),
    ({"time_h": "soon", "unit": "m", "blade": "B9"}, ["time_h", "blade", "unit"]),
    ({"sigma": -1.0, "value": 1e6}, ["sigma", "values"]),
    ({"blade": 7, "time_h": -1.0}, ["blade", "time_h"]),
    ({"id": "", "unit": "m"}, ["id", "unit"]),
    ({"colour": "red", "time_h": -1.0}, ["colour", "time_h"]),
    ({"quantity": 3, "blade": "B9"}, ["quantity", "blade"]),
    ({"value": None, "unit": "m"}, ["value", "unit"]),
    ({"value": None, "values": [[0.1]], "nodes": ["one"], "time_h": -1.0}, ["nodes[0]", "time_h"]),
    ({"id": 1, "blade": 2, "quantity": 3, "time_h": "4", "value": "5"},
     ["id", "blade", "quantity", "time_h", "value"]),
]  # fmt: skip


@pytest.mark.parametrize(("fields", "named"), ROWS)
def test_a_field_that_cannot_be_read_hides_no_other_fault_of_its_row(
    created: httpx.Client, fields: Json, named: list[str]
) -> None:
    body = refuse(created.post("/v1/rotors/r1/inspections", json=one("a", **fields)), 422)
    assert [fault["field"] for fault in body["faults"]] == named
    assert "unread" not in str(body), "what stands in for a field is never told"
    assert head(created) == 0


def test_a_row_that_is_no_reading_at_all_is_told_as_that(created: httpx.Client) -> None:
    body = refuse(created.post("/v1/rotors/r1/inspections", json={"inspections": [3, "a"]}), 422)
    named = [fault["field"] for fault in body["faults"]]
    assert len(named) == 2


def test_csv_is_read_row_by_row(created: httpx.Client, worker: Worker) -> None:
    text = (
        "id,blade,quantity,time_h,value,node,unit,campaign\r\n"
        "a,B1,elongation,8000,0.11,,mm,outage 1\r\n"
        'b,B2,ceeq,8e3,0.0012,17,1,"outage, 1"\r\n'
    )
    headers = {"content-type": "text/csv; charset=utf-8"}
    answer = created.post("/v1/rotors/r1/inspections", content=text.encode(), headers=headers)
    assert [item["seq"] for item in answer.json()["items"]] == [1, 2]
    stored = created.get("/v1/rotors/r1/inspections/b").json()
    assert (stored["values"], stored["nodes"], stored["campaign"]) == ([0.0012], [17], "outage, 1")


CSV: list[tuple[str, int, str | None]] = [
    ("id,blade,quantity,time_h\na,B1,elongation,1\n", 422, "value"),
    ("id,blade,quantity,time_h,value,colour\na,B1,elongation,1,0.1,red\n", 422, "colour"),
    ("id,blade,quantity,time_h,value\na,B1,elongation,1,nan\n", 422, "line 2.value"),
    ("id,blade,quantity,time_h,value\na,B1,elongation,1_0,0.1\n", 422, "line 2.time_h"),
    ("id,blade,quantity,time_h,value\na,B1,elongation,1\n", 422, "line 2"),
    ("id,blade,quantity,time_h,value\na,B1,elongation,1,0.1,9\n", 422, "line 2"),
    ("id,blade,quantity,time_h,value\n", 422, "body"),
    ("id,id,blade,quantity,time_h,value\na,a,B1,elongation,1,0.1\n", 422, "header"),
    ("", 422, "id"),
    ("id\xff", 400, None),
]


def test_csv_that_cannot_be_used_is_refused_by_line(created: httpx.Client) -> None:
    headers = {"content-type": "text/csv"}
    for text, status, field in CSV:
        content = text.encode("latin-1")
        sent = created.post("/v1/rotors/r1/inspections", content=content, headers=headers)
        refuse(sent, status, field)
    assert head(created) == 0


UNTIDY: list[tuple[str, str, str]] = [
    ('a,B1,elongation,1,"0,11",mm,', "line 2.value", "decimal point"),
    ('a,B1,elongation,"8,000",0.11,mm,', "line 2.time_h", "no comma"),
    ("a,B1,elongation,1,0.11 mm,,", "line 2.value", "no comma, unit"),
    ("a,B1,elongation,1,N/A,mm,", "line 2.value", "leave out what is not known"),
    ("a,B1,elongation,1,,mm,", "line 2.value", "leave the reading out"),
    ("a,B1,elongation,1,0.1,mm,04.05.2031", "line 2.observed_at", "2031-05-04T10:00:00Z"),
    ("a,B1,elongation,1,0.1,mm,2031-05-04", "line 2.observed_at", "2031-05-04T10:00:00Z"),
    ("a,B1,elongation,1,0,11,mm,", "line 2", "double quotes"),
    ("a,B1,elongation,1,0.0041,in,", "line 2.unit", "convert the value to 'mm'"),
]


@pytest.mark.parametrize(("row", "field", "remedy"), UNTIDY)
def test_what_a_shop_writes_is_refused_with_what_to_write(
    created: httpx.Client, row: str, field: str, remedy: str
) -> None:
    text = f"id,blade,quantity,time_h,value,unit,observed_at\n{row}\n"
    headers = {"content-type": "text/csv"}
    sent = created.post("/v1/rotors/r1/inspections", content=text.encode(), headers=headers)
    (fault,) = refuse(sent, 422, field)["faults"]
    assert remedy in fault["remedy"]
    assert "value error" not in fault["problem"]
    assert "leave the unit out" not in fault["remedy"], "inches would count as millimetres"


def test_a_header_that_is_nearly_right_is_told_how_it_is_written(created: httpx.Client) -> None:
    text = "ID, blade,quantity,time_h,Value ,unit,\na,B1,elongation,1,0.1,mm,\n"
    headers = {"content-type": "text/csv"}
    sent = created.post("/v1/rotors/r1/inspections", content=text.encode(), headers=headers)
    told = {fault["field"]: fault["remedy"] for fault in refuse(sent, 422)["faults"]}
    assert told.pop("header").startswith("delete the column without a name")
    assert told == {
        "ID": "write it 'id'",
        " blade": "write it 'blade'",
        "Value ": "write it 'value'",
    }


def test_a_file_whose_lines_were_joined_is_told_how_to_keep_them(created: httpx.Client) -> None:
    """``curl -d @file`` takes line breaks out; 201 columns were said to be too many."""
    rows = ["id,blade,quantity,time_h,value", "a,B1,elongation,1,0.1", "b,B1,elongation,2,0.2"]
    headers = {"content-type": "text/csv"}
    for count in (2, 3):
        text = "".join(rows[:count])
        sent = created.post("/v1/rotors/r1/inspections", content=text.encode(), headers=headers)
        assert "--data-binary" in refuse(sent, 422, "body")["faults"][0]["remedy"]
    sent = created.post("/v1/rotors/r1/inspections", content=rows[0].encode(), headers=headers)
    assert refuse(sent, 422, "body")["faults"][0]["problem"] == "holds no row"


def test_lines_of_empty_cells_are_no_readings(created: httpx.Client) -> None:
    text = "id,blade,quantity,time_h,value\r\na,B1,elongation,1,0.1\r\n\r\n,,,,\r\n,,,,,,\r\n"
    headers = {"content-type": "text/csv"}
    sent = created.post("/v1/rotors/r1/inspections", content=text.encode(), headers=headers)
    assert [item["id"] for item in sent.json()["items"]] == ["a"]


def test_a_file_of_another_encoding_is_told_by_line(created: httpx.Client) -> None:
    text = (
        "id,blade,quantity,time_h,value,unit\na,B1,elongation,1,0.1,mm\nb,B1,elongation,2,90,µm\n"
    )
    headers = {"content-type": "text/csv"}
    sent = created.post(
        "/v1/rotors/r1/inspections", content=text.encode("latin-1"), headers=headers
    )
    detail = refuse(sent, 400)["detail"]
    assert "byte 0xb5 in line 3" in detail
    assert "save the file as CSV in UTF-8" in detail


def test_an_id_that_a_request_gives_twice_is_not_said_to_be_there(created: httpx.Client) -> None:
    batch = {"inspections": [one("a"), one("b"), one("a", value=0.12)]}
    (fault,) = refuse(created.post("/v1/rotors/r1/inspections", json=batch), 409)["faults"]
    assert (fault["value"], fault["problem"]) == ("a", "is given twice, with different content")
    assert head(created) == 0


def test_a_name_with_a_blank_at_its_end_is_none(created: httpx.Client) -> None:
    """ "outage 1 " would be another campaign than "outage 1", and nobody sees it."""
    for name, remedy in (("outage 1 ", "leave the blank out"), ("outage\t1", "without tabs")):
        sent = created.post("/v1/rotors/r1/inspections", json=one(campaign=name))
        assert remedy in refuse(sent, 422, "campaign")["faults"][0]["remedy"]


ROTORS: list[tuple[Json, str, str]] = [
    ({"blades": ["B1"]}, "blades[0]", "write an object"),
    ({"blades": [{"id": "B1", "slot": 1}]}, "blades[0].slot", "in double quotes"),
    ({"blades": [{"id": "B1", "time_h0": "8,000"}]}, "blades[0].time_h0", "bare number"),
    ({"diagnose": "always"}, "diagnose", "use one of these"),
    ({"particles": 1.5}, "particles", "whole number"),
]


@pytest.mark.parametrize(("given", "field", "remedy"), ROTORS)
def test_a_rotor_that_is_refused_is_told_what_to_write(
    api: httpx.Client, given: Json, field: str, remedy: str
) -> None:
    body = {"id": "r9", "model": "rotor-blade", "blades": [{"id": "B1"}]} | given
    (fault,) = refuse(api.post("/v1/rotors", json=body), 422, field)["faults"]
    assert remedy in fault["remedy"]


def test_a_built_in_model_that_is_not_registered_is_told_how_to_register(store: SqlStore) -> None:
    science = FakeScience(builtins=("rotor-blade", "wide"))
    with pytest.raises(FaultsError, match=r'POST /v1/models {"builtin": "wide"} registers it'):
        check_network(store, science, "wide", None)
    with pytest.raises(FaultsError, match="GET /v1/models lists those that exist"):
        check_network(store, science, "wider", None)


def test_a_rotor_without_blades_is_told_to_get_one(api: httpx.Client) -> None:
    bare = {"id": "r9", "model": "rotor-blade", "blades": []}
    assert api.post("/v1/rotors", json=bare).status_code == 201
    (fault,) = refuse(api.post("/v1/rotors/r9/inspections", json=one()), 422, "blade")["faults"]
    assert fault["remedy"] == "POST /v1/rotors/r9/blades"


def test_another_media_type_is_refused(created: httpx.Client) -> None:
    headers = {"content-type": "application/xml"}
    refuse(created.post("/v1/rotors/r1/inspections", content=b"<a/>", headers=headers), 415)


def test_a_scan_of_the_whole_mesh_is_accepted_and_listed_short(created: httpx.Client) -> None:
    scan = one(
        "scan",
        quantity="deformation",
        value=None,
        nodes=list(range(6448)),
        values=[[0.001 * i, -0.2, 0.3333333333333333] for i in range(6448)],
    )
    assert created.post("/v1/rotors/r1/inspections", json=scan).status_code == 202
    listed = created.get("/v1/rotors/r1/inspections").json()["items"][0]
    assert (listed["count"], listed["values"], listed["nodes"]) == (6448, None, None)
    assert created.get("/v1/rotors/r1/inspections/scan").json()["values"] == scan["values"]


def chunks(total: int) -> Iterator[bytes]:
    yield b'{"id": "'
    for _ in range(total // 2**20):
        yield b"x" * 2**20


@pytest.mark.parametrize("chunked", [False, True])
def test_a_body_above_the_limit_is_refused_with_413(created: httpx.Client, chunked: bool) -> None:
    size = 100 * 2**20
    content = chunks(size) if chunked else b"x" * size
    headers = {"content-type": "application/json"}
    refuse(created.post("/v1/rotors/r1/inspections", content=content, headers=headers), 413, "body")
    assert head(created) == 0


def test_a_batch_of_20_mib_is_below_the_limit(created: httpx.Client) -> None:
    nodes, row = list(range(6448)), [0.1234567890123456, -0.1234567890123456, 0.33333333333333]
    batch = {
        "inspections": [
            one(f"s{i}", quantity="deformation", value=None, nodes=nodes, values=[row] * 6448)
            for i in range(40)
        ]
    }
    content = json.dumps(batch).encode()
    assert len(content) > 15 * 2**20
    headers = {"content-type": "application/json"}
    answer = created.post("/v1/rotors/r1/inspections", content=content, headers=headers)
    assert answer.json()["head_seq"] == 40


def test_an_unforeseen_failure_is_a_problem_and_the_connection_goes_on(
    created: httpx.Client, worker: Worker, monkeypatch: pytest.MonkeyPatch
) -> None:
    worker.drain()
    monkeypatch.setattr(FakeScience, "predict", lambda *args: 1 / 0)
    refuse(created.get("/v1/rotors/r1/blades/B1/prediction?times=1"), 500)
    assert created.get("/v1/rotors/r1").status_code == 200


def test_a_correction_and_a_retraction_are_entries_of_their_own(
    created: httpx.Client, worker: Worker
) -> None:
    created.post("/v1/rotors/r1/inspections", json=one("a"))
    created.post("/v1/rotors/r1/inspections", json=one("b", value=0.12, replaces="a"))
    url = "/v1/rotors/r1/inspections/b/retraction"
    answer = created.post(url)
    assert answer.status_code == 202
    assert answer.json() == {"items": [{"id": "b", "seq": 3, "status": "accepted"}], "head_seq": 3}
    assert created.post(url).json() == answer.json()
    status = [i["status"] for i in created.get("/v1/rotors/r1/inspections").json()["items"]]
    assert status == ["counts", "retracted"]
    refuse(created.post("/v1/rotors/r1/inspections/zz/retraction"), 404, "inspection")
    refuse(created.post(url, json={"reason": "why"}), 422, "reason")


def test_a_list_is_paged_to_its_end_and_its_maximum_enforced(created: httpx.Client) -> None:
    batch = {"inspections": [one(f"i{i}", time_h=1000.0 + i) for i in range(7)]}
    created.post("/v1/rotors/r1/inspections", json=batch)
    seen: list[str] = []
    params = {"limit": "3"}
    while True:
        page = created.get("/v1/rotors/r1/inspections", params=params).json()
        seen += [item["id"] for item in page["items"]]
        if page["next"] is None:
            break
        params["cursor"] = page["next"]
    assert seen == [f"i{i}" for i in range(7)]
    above = created.get("/v1/rotors/r1/inspections?limit=201")
    refuse(above, 422, "limit")
    assert "To mend it: ask for 1 … 200, and follow `next`" in above.json()["detail"]
    refuse(created.get("/v1/rotors/r1/inspections?limit=0"), 422, "limit")
    refuse(created.get("/v1/rotors/r1/inspections?cursor=zz"), 422, "cursor")
    for i in range(4):
        created.post("/v1/rotors", json=ROTOR | {"id": f"s{i}"})
    page = created.get("/v1/rotors?limit=3").json()
    assert [item["id"] for item in page["items"]] == ["r1", "s0", "s1"]
    rest = created.get("/v1/rotors", params={"limit": 3, "cursor": page["next"]}).json()
    assert [item["id"] for item in rest["items"]] == ["s2", "s3"]
    assert rest["next"] is None


def test_a_list_of_rotors_says_of_each_whether_it_can_be_trusted(
    created: httpx.Client, worker: Worker
) -> None:
    """Who looks at the list alone would take a contradicted rotor for a sound one."""
    created.post("/v1/rotors", json=ROTOR | {"id": "r2"})
    (first, _) = created.get("/v1/rotors").json()["items"]
    assert (first["sealed"], first["health"]) == (None, None), "no posterior yet"
    worker.drain()
    created.post("/v1/rotors/r1/inspections", json=one(value=4.1))
    worker.drain()
    listed = created.get("/v1/rotors").json()["items"]
    for row in listed:
        whole = created.get(f"/v1/rotors/{row['id']}").json()
        assert (row["sealed"], row["health"]) == (whole["posterior"]["sealed"], whole["health"])


def test_a_rotor_is_created_once(created: httpx.Client) -> None:
    first = created.get("/v1/rotors/r1").json()
    again = created.post("/v1/rotors", json=ROTOR)
    assert (again.status_code, again.headers["idempotent-replayed"]) == (201, "true")
    assert again.headers["location"] == "/v1/rotors/r1"
    refuse(created.post("/v1/rotors", json=ROTOR | {"seed": 2}), 409, "rotor.id")
    refuse(created.post("/v1/rotors", json=ROTOR | {"id": "x", "model": "none"}), 422, "model")
    refuse(created.post("/v1/rotors", json=ROTOR | {"id": "x", "seed": 2**63}), 422, "seed")
    refuse(created.post("/v1/rotors", json=ROTOR | {"id": "x", "colour": 1}), 422, "colour")
    twice = ROTOR | {"id": "x", "blades": [{"id": "B1"}, {"id": "B1"}]}
    refuse(created.post("/v1/rotors", json=twice), 422, "blades")
    assert created.get("/v1/rotors/r1").json() == first


def test_a_blade_joins_and_leaves(created: httpx.Client, worker: Worker) -> None:
    refuse(created.post("/v1/rotors/r1/inspections", json=one(blade="B3")), 422, "blade")
    joined = created.post("/v1/rotors/r1/blades", json={"id": "B3", "lot": "L7", "time_h0": 12.5})
    assert joined.json() == {"items": [{"id": "B3", "seq": 1, "status": "accepted"}], "head_seq": 1}
    again = created.post("/v1/rotors/r1/blades", json={"id": "B3", "lot": "L7", "time_h0": 12.5})
    assert again.json() == joined.json()
    refuse(created.post("/v1/rotors/r1/blades", json={"id": "B3"}), 409, "blade.id")
    refuse(created.post("/v1/rotors/r1/blades", json={"id": "B1", "slot": "2"}), 409, "blade.id")
    assert created.post("/v1/rotors/r1/inspections", json=one(blade="B3")).status_code == 202
    assert created.post("/v1/rotors/r1/blades/B1/retirement").status_code == 202
    refuse(created.post("/v1/rotors/r1/blades/B9/retirement"), 404, "blade")
    worker.drain()
    view = created.get("/v1/rotors/r1").json()
    assert created.post("/v1/rotors/r1/blades", json={"id": "B4"}).json()["head_seq"] == 4
    for what in ("posterior", "prediction?times=1"):
        told = refuse(created.get(f"/v1/rotors/r1/blades/B4/{what}"), 409, "version")
        assert "wait_for=4" in told["detail"]
    assert [(b["id"], b["lot"], b["retired"]) for b in view["blades"]] == [
        ("B1", None, True),
        ("B2", None, False),
        ("B3", "L7", False),
    ]
    assert created.get("/v1/rotors/r1/blades/B3/posterior").json()["names"] == ["rate", "offset"]


def test_a_blade_that_has_left_is_not_answered_as_if_it_were_in_service(
    created: httpx.Client,
) -> None:
    """It was 202, `Idempotent-Replayed`, and the blade stayed retired."""
    url, blade = "/v1/rotors/r1/blades", {"id": "B3", "lot": "L7"}
    key = {"Idempotency-Key": "k1"}
    first = created.post(url, json=blade, headers=key)
    again = created.post(url, json=blade)
    assert (again.status_code, again.headers["idempotent-replayed"]) == (202, "true")
    assert created.post(url, json={"id": "B2"}).json()["items"][0]["seq"] == 0, "of the creation"
    for name in ("B2", "B3"):
        assert created.post(f"{url}/{name}/retirement").status_code == 202
        assert created.post(f"{url}/{name}/retirement").headers["idempotent-replayed"] == "true"
    for sent, seq in ((blade, 3), ({"id": "B2"}, 2), ({"id": "B3", "lot": "L8"}, 3)):
        told = refuse(created.post(url, json=sent), 409, "blade.id")
        assert f"has left, by entry {seq}" in told["detail"]
        assert "choose a new id for the new blade" in told["detail"]
    same = created.post(url, json=blade, headers=key)
    assert (same.status_code, same.json()) == (202, first.json()), "the answer of that very request"
    assert created.get("/v1/rotors/r1").json()["head_seq"] == 3


@pytest.mark.parametrize(
    "path",
    [
        "/v1/rotors/r1/posterior",
        "/v1/rotors/r1/blades/B1/posterior",
        "/v1/rotors/r1/blades/B1/prediction?times=8000",
        "/v1/rotors/r1",
    ],
)
def test_an_etag_holds_until_the_state_changes(
    created: httpx.Client, worker: Worker, path: str
) -> None:
    worker.drain()
    tag = created.get(path).headers["etag"]
    same = created.get(path, headers={"if-none-match": f'"other", W/{tag}'})
    assert (same.status_code, same.content, same.headers["etag"]) == (304, b"", tag)
    created.post("/v1/rotors/r1/inspections", json=one())
    worker.drain()
    fresh = created.get(path, headers={"if-none-match": tag})
    assert fresh.status_code == 200
    assert fresh.headers["etag"] != tag


class Doubtful(FakeScience):
    """Says of its states what `told` says."""

    told: ClassVar[Json]

    def update(self, *args: Any, **kw: Any) -> FakeState:
        state = super().update(*args, **kw)
        return replace(state, meta=state.meta | {"health": self.told})


class Degenerate(Doubtful):
    found: ClassVar[Json] = {"nodes": 64, "ess": 2.0, "ess_ratio": 0.03, "tempered": 1.0}
    told = verdict(found | {"message_tilt_nat": 0.0}, [], sealed=True)


class OfAnEarlierRelease(Doubtful):
    told: ClassVar[Json] = {"ess": 64, "ess_ratio": 1.0}


@pytest.mark.parametrize(
    ("science_type", "status", "trusted"),
    [
        (FakeScience, "ok", True),
        (Degenerate, "degenerate", False),
        (OfAnEarlierRelease, "unknown", False),
    ],
)
def test_a_state_below_its_floor_is_never_read_without_being_told(
    created: httpx.Client,
    store: SqlStore,
    settings: Settings,
    science_type: type[FakeScience],
    status: str,
    trusted: bool,
) -> None:
    assert created.get("/v1/rotors/r1").json()["health"] is None
    assert "bladetwin-health" not in created.get("/v1/rotors/r1").headers
    make_worker(store, science_type(), settings).drain()
    for path in ("", "/posterior", "/blades/B1/posterior", "/blades/B1/prediction?times=1"):
        answer = created.get(f"/v1/rotors/r1{path}")
        health = answer.json()["health"]
        assert (health["status"], health["trusted"]) == (status, trusted)
        assert bool(health["reasons"]) == (not trusted)
        assert health["contradicted"] == []
        assert answer.headers["bladetwin-health"] == status


def test_an_older_version_can_be_read_and_an_unknown_one_is_refused(
    created: httpx.Client, worker: Worker
) -> None:
    path = "/v1/rotors/r1/blades/B1/prediction?times=50000"
    refuse(created.get(path), 409, "version")
    worker.drain()
    prior = created.get(path).json()
    created.post("/v1/rotors/r1/inspections", json=one())
    worker.drain()
    assert created.get(path).json()["mean"] != prior["mean"]
    assert created.get(path + "&version=1").json() == prior
    refuse(created.get(path + "&version=3"), 404, "version")
    refuse(created.get("/v1/rotors/r1/blades/B9/prediction"), 404, "blade")


def test_a_posterior_is_summarised(created: httpx.Client, worker: Worker) -> None:
    worker.drain()
    body = created.get("/v1/rotors/r1/blades/B1/posterior").json()
    rate = body["parameters"]["rate"]
    assert rate["mean"] == pytest.approx(0.5, abs=4 * 0.1 / 1000**0.5)
    assert rate["sd"] == pytest.approx(0.1, rel=0.1)
    assert list(rate["quantiles"]) == ["0.025", "0.05", "0.16", "0.5", "0.84", "0.95", "0.975"]
    assert [row[i] for i, row in enumerate(body["correlation"])] == [1.0, 1.0]
    assert body["ess"] == pytest.approx(1000.0)
    assert 1.0 <= rate["r_hat"] <= body["r_hat"] < 1.02  # 1 + 4 / (2 ESS) is expected


def test_who_waits_is_answered_when_the_entry_is_applied(
    created: httpx.Client, worker: Worker
) -> None:
    worker.drain()
    seq = created.post("/v1/rotors/r1/inspections", json=one()).json()["head_seq"]
    answers: list[Json] = []

    def wait() -> None:
        url = f"/v1/rotors/r1?wait_for={seq}&timeout=50"
        with httpx.Client(base_url=created.base_url, timeout=60) as client:
            answers.append(client.get(url).json())

    waiting = threading.Thread(target=wait)
    waiting.start()
    time.sleep(0.3)
    assert answers == []
    worker.drain()
    waiting.join(PATIENCE_S)
    assert answers[0]["applied_seq"] == seq
    late = created.get(f"/v1/rotors/r1?wait_for={seq + 1}&timeout=0.05").json()
    assert late["applied_seq"] == seq
    refuse(created.get("/v1/rotors/r1?wait_for=1&timeout=61"), 422, "timeout")
    refuse(created.get("/v1/rotors/r1?wait_for=-1"), 422, "wait_for")


def test_models_and_jobs_are_told(created: httpx.Client, worker: Worker) -> None:
    listed = created.get("/v1/models").json()["items"]
    assert [m["id"] for m in listed] == ["rotor-blade"], "registered at the first start"
    model = created.get("/v1/models/rotor-blade").json()
    assert model["network"]["name"] == "fake"
    assert model["outputs"]["elongation"] == {"unit": "mm", "kind": "scalar"}
    answer = created.post("/v1/models", json={"builtin": "rotor-blade"})
    assert answer.status_code == 202
    location = answer.headers["location"]
    assert created.get(location).json()["status"] == "queued"
    worker.drain()
    done = created.get(location).json()
    assert (done["status"], done["result"]["model"]) == ("done", "rotor-blade")
    refuse(created.post("/v1/models", json={"builtin": "other"}), 422, "builtin")
    refuse(created.get("/v1/jobs/none"), 404, "job")
    refuse(created.get("/v1/models/none"), 404, "model")


def test_health_and_readiness(api: httpx.Client) -> None:
    assert api.get("/healthz").json() == {"status": "alive"}
    assert api.get("/readyz").json()["ready"] is True


def test_every_route_answers_an_unknown_thing_and_a_wrong_method_with_a_problem(
    api: httpx.Client,
) -> None:
    routes = api.get("/openapi.json").json()["paths"]
    assert len(routes) == 41
    for path, methods in routes.items():
        url = path.replace("{r}", "zz").replace("{b}", "zz").replace("{i}", "zz")
        url = url.replace("{m}", "zz").replace("{id}", "zz").replace("{d}", "zz")
        url = url.replace("{w}", "zz")
        refuse(api.request("PATCH", url), 405)
        for method in methods:
            if "{" in path:
                body = {"json": one()} if url.endswith("inspections") else {}
                body = {"json": {"id": "B1"}} if url.endswith("blades") else body
                body = {"json": {"adopt": "never"}} if url.endswith("policy") else body
                needed = "?limit=1" if url.endswith("life") else ""
                refuse(api.request(method, url + needed, **body), 404)
        spaced = path.replace("{r}", "a%20b").replace("{m}", "a%00b").replace("{id}", "a%00")
        spaced = spaced.replace("{b}", "x").replace("{i}", "x").replace("{d}", "x")
        spaced = spaced.replace("{w}", "a%20b")
        if spaced != path and "get" in methods:
            refuse(api.get(spaced), 422)
    refuse(api.get("/nowhere"), 404)
    refuse(api.get("/v1/rotors/"), 404)


def test_the_client_goes_the_whole_way(api: httpx.Client, worker: Worker) -> None:
    twin = Client(http=api)
    twin.ready()
    twin.create_rotor("r1", blades=["B1", {"id": "B2", "lot": "L1"}], seed=3)
    seq = twin.post_inspections("r1", [one("a"), one("b", blade="B2")])
    worker.drain()
    assert twin.wait_for("r1", seq)["applied_seq"] == 2
    assert twin.wait_sealed("r1")["posterior"]["sealed"] is True
    bands = twin.prediction("r1", "B1", times=[0.0, 50_000.0])
    assert bands["mean"][0] == 0.0
    assert (bands["instrument"], bands["noise_from"]) == (None, "prior")
    assert bands["health"]["trusted"] is True
    assert set(twin.posterior("r1")["parameters"]) == {"rate"}
    assert twin.retract("r1", "b") == 3
    assert twin.add_blade("r1", "B3") == 4
    assert twin.retire_blade("r1", "B3") == 5
    assert twin.retry("r1")["id"] == "r1"
    assert [m["id"] for m in twin.models()] == ["rotor-blade"]
    refused: list[tuple[Callable[[], Any], str]] = [
        (lambda: twin.post_inspections("r1", [one("x", blade="B9")]), "inspections[0].blade"),
        (lambda: twin.prediction("r1", "B1", instrument="gauge 1"), "instrument"),
        (lambda: twin.create_rotor("x", blades=[], network={"forgetting_h": 2e4}), "network"),
        (lambda: twin.add_blade("r1", {"id": "B4", "known": {"load": 2.0}}), "known.load"),
    ]
    for ask, field in refused:
        with pytest.raises(ProblemError) as caught:
            ask()
        assert caught.value.faults[0]["field"] == field


def test_the_client_says_that_a_rotor_is_blocked(
    created: httpx.Client, store: SqlStore, settings: Settings
) -> None:
    class Broken(FakeScience):
        def update(self, card: Any, rotor: Any, readings: Any, *args: Any, **kw: Any) -> Any:
            if readings:
                raise RuntimeError("no luck")
            return super().update(card, rotor, readings, *args, **kw)

    created.post("/v1/rotors/r1/inspections", json=one("a"))
    make_worker(store, Broken(), settings).drain()
    with pytest.raises(BlockedError, match="no luck"):
        Client(http=created).wait_for("r1", 1)
    view = created.get("/v1/rotors/r1").json()
    assert (view["status"], view["last_error"]["event"]) == ("blocked", "a")
    assert created.post("/v1/rotors/r1/retry").json()["status"] == "pending"


def test_no_number_of_an_answer_is_lost_or_not_json(created: httpx.Client, worker: Worker) -> None:
    value = 0.1234567890123456
    created.post("/v1/rotors/r1/inspections", json=one("a", value=value, time_h=8000))
    text = created.get("/v1/rotors/r1/inspections/a").text
    assert json.loads(text, parse_constant=pytest.fail)["values"] == [value]


def test_while_the_database_is_away_every_route_says_so(
    created: httpx.Client, monkeypatch: pytest.MonkeyPatch, store: SqlStore
) -> None:
    def away(*args: Any, **kw: Any) -> Any:
        raise OperationalError("SELECT", {}, Exception("gone"))

    monkeypatch.setattr(type(store.engine), "connect", away)
    body = refuse(created.get("/v1/rotors/r1"), 503)
    assert body["type"].endswith(":database-away")
    sent = created.post("/v1/rotors/r1/inspections", json=one())
    refuse(sent, 503)
    assert sent.headers["retry-after"] == "1"
    assert created.get("/readyz").json() == {"ready": False, "database": "Exception"}
    assert created.get("/healthz").status_code == 200
