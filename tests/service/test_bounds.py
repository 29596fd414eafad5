"""What a small request may cost: no text, count or size of it takes minutes or gigabytes."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any

import httpx
import pytest

from core.errors import FaultsError
from service.api import csv_rows, reading_bodies, sensorthings, services
from service.api.csv_rows import csv_rows as rows_of
from service.api.kept import Ground, Kept, Shelf
from service.api.loopback import by_loopback
from service.api.problems import MOST_FAULTS, RequestError
from service.api.reading_bodies import read_inspections
from service.api.routers.reads import LONGEST_TIMES
from service.declared import read_network
from service.names import LONGEST_NUMBER, is_number
from service.worker.loop import Worker

URL = "/v1/rotors/r1/inspections"
PREDICTION = "/v1/rotors/r1/blades/B1/prediction"
DIGITS = 60_000
"""Of a number with a wrong character behind it: by a pattern that tries every split, minutes."""


def refused(body: bytes, kind: str) -> RequestError:
    with pytest.raises(RequestError) as caught:
        read_inspections(body, kind)
    return caught.value


def test_a_long_number_is_none_and_is_seen_at_once() -> None:
    assert is_number("1" * LONGEST_NUMBER)
    assert not is_number("1" * (LONGEST_NUMBER + 1))
    assert not is_number("1" * 100_000 + "x")
    head = b"id,blade,quantity,time_h,value\n"
    told = refused(head + b"a,B1,elongation," + b"1" * 19_000 + b"x,0.1\n", "text/csv")
    assert [one["field"] for one in told.faults] == ["line 2.time_h"]
    with pytest.raises(FaultsError, match=r"neither YAML nor JSON|is no mapping|is missing"):
        read_network("name: " + "1" * 120_000 + "x")


def test_hours_of_many_digits_are_refused_in_time(
    api: httpx.Client, rotor: str, worker: Worker
) -> None:
    worker.drain()
    told = api.get(PREDICTION, params={"times": "1" * DIGITS + "x"})
    assert told.status_code in (422, 431)
    told = api.get(PREDICTION, params={"times": "8000," + "1" * 3000 + "x"})
    assert told.status_code == 422
    assert told.json()["faults"][0]["field"] == "times"


def test_an_answer_tells_a_thousand_faults_and_that_there_are_more() -> None:
    bad = json.dumps({"inspections": [0] * (3 * MOST_FAULTS)}).encode()
    for body, kind in (
        (bad, "application/json"),
        (b"id,blade,quantity,time_h,value\n" + b"x\n" * 3 * MOST_FAULTS, "text/csv"),
        (b"[" + b"0," * 3 * MOST_FAULTS + b"0]", reading_bodies.MEDIA),
    ):
        told = refused(body, kind)
        assert len(told.faults) == MOST_FAULTS + 1, kind
        assert "of which these are the first" in told.faults[-1]["problem"]
    few = refused(json.dumps({"inspections": [0] * 5}).encode(), "application/json")
    assert len(few.faults) == 5


def test_more_readings_than_a_body_holds_are_refused_by_their_number(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(reading_bodies, "MOST_READINGS", 3)
    one = {"id": "a", "blade": "B1", "quantity": "elongation", "time_h": 8e3, "value": 0.1}
    batch = [one | {"id": f"i{i}"} for i in range(4)]
    assert len(read_inspections(json.dumps({"inspections": batch[:3]}).encode(), "")) == 3
    told = refused(json.dumps({"inspections": batch}).encode(), "")
    assert told.faults[0]["problem"] == "are above 3"
    monkeypatch.setattr(csv_rows, "MOST_ROWS", 3)
    told = refused(b"id,blade,quantity,time_h,value\n" + b"a,B1,elongation,1,1\n" * 4, "text/csv")
    assert told.faults[0]["problem"] == "has more than 3 lines"


@pytest.mark.parametrize(("sign", "called"), [(";", "semicolons"), ("\t", "tabs"), ("|", "bars")])
def test_a_spreadsheet_s_other_separators_are_told_in_one_fault(sign: str, called: str) -> None:
    """Where a comma is decimal; each column was said to be missing, and the cells to be mangled."""
    rows = [("id", "blade", "quantity", "time_h", "value"), ("i", "b", "elongation", "9", "0,4")]
    body = "\n".join(sign.join(row) for row in rows).encode()
    with pytest.raises(RequestError) as told:
        rows_of(body)
    (one,) = told.value.faults
    assert (one["field"], one["problem"]) == ("header", f"is separated by {called}")
    assert "numbers with a point" in one["remedy"]


def test_a_line_longer_than_its_cells_may_be_is_no_csv() -> None:
    with pytest.raises(RequestError, match="20,000 bytes or more") as caught:
        rows_of(b"id" + b"," * 100_000 + b"\n")
    assert caught.value.status == 400


def test_many_unknown_parameters_are_one_fault(api: httpx.Client, rotor: str) -> None:
    told = api.get("/v1/rotors?" + "&".join(f"a{i}" for i in range(51)))
    assert (told.status_code, len(told.json()["faults"])) == (422, 1)
    told = api.get("/v1/rotors?" + "&".join(f"limi{i}" for i in range(20)))
    remedies = [one["remedy"] for one in told.json()["faults"]]
    assert remedies[0] == "use limit"
    assert len(remedies) == 20


def test_a_kept_answer_counts_with_its_question_and_long_ones_are_not_kept() -> None:
    ground = Ground("r1", lambda store, rotor: 1, 1)
    kept = Kept(ground, '"a"', [(b"etag", b"x" * 100)], None, {})
    room = 10 * Shelf.ENTRY_BYTES
    shelf = Shelf(room / 2**20)
    for number in range(100):
        shelf.put(("/v1/x", b"q" * 3000 + b"%d" % number, False), kept)
    held = [n for n in range(100) if shelf.get(("/v1/x", b"q" * 3000 + b"%d" % n, False))]
    assert held == [96, 97, 98, 99], "four of 6 KiB in 30"
    shelf.put(("/v1/x", b"q" * Shelf.LONGEST, False), kept)
    assert shelf.get(("/v1/x", b"q" * Shelf.LONGEST, False)) is None


def loop(**headers: str) -> dict[str, Any]:
    told = {"host": "127.0.0.1:8000", **{k.replace("_", "-"): v for k, v in headers.items()}}
    raw = [(name.encode(), value.encode()) for name, value in told.items()]
    ends = {"client": ("127.0.0.1", 5000), "server": ("127.0.0.1", 8000)}
    return {"type": "http", "headers": raw, **ends}


def test_what_another_site_s_page_asks_needs_a_key_though_it_names_no_origin() -> None:
    for site in ("cross-site", "same-site"):
        assert not by_loopback(loop(sec_fetch_site=site), ())
    for site in ("none", "same-origin"):
        assert by_loopback(loop(sec_fetch_site=site), ())
    allowed = "https://dash.example"
    asked = loop(sec_fetch_site="cross-site", origin=allowed)
    assert by_loopback(asked, (allowed,))
    assert not by_loopback(asked, ())


def chunks() -> Iterator[bytes]:
    for _ in range(40):
        yield b" " * 2**15


@pytest.mark.parametrize("path", ["/v1/rotors", URL, "/v1/rotors/r1/blades"])
def test_a_body_without_a_length_above_the_limit_is_too_large_on_every_route(
    serving: Callable[..., AbstractContextManager[httpx.Client]], rotor: str, path: str
) -> None:
    with serving(max_body_mb=1.0) as client:
        head = {"content-type": "application/json"}
        told = client.post(path, content=chunks(), headers=head)
        assert (told.status_code, told.json()["type"]) == (
            413,
            "urn:bladetwin:problem:body-too-large",
        )
        assert client.get("/healthz").status_code == 200


def test_a_moment_holds_no_control_character(api: httpx.Client, rotor: str) -> None:
    blade = {"id": "B9", "installed_at": "2031-05-04\x0010:00:00+00:00"}
    told = api.post("/v1/rotors/r1/blades", json=blade)
    assert told.status_code == 422
    assert told.json()["faults"][0]["field"] == "installed_at"


def test_a_tag_is_of_this_release(
    api: httpx.Client, rotor: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = {"format": "csv"}
    first = api.get(URL, params=whole).headers["etag"]
    assert api.get(URL, params=whole).headers["etag"] == first
    monkeypatch.setattr(services, "RELEASE", services.RELEASE + ".other")
    assert api.get(URL, params=whole).headers["etag"] != first


@pytest.mark.parametrize(
    "text",
    ["{name: !!bool x}", "{name: !!int ''}", "{name: !!timestamp x}", "!!map [a]", "{[a]: 1}"],
)
def test_tags_on_what_they_do_not_fit_are_told_as_a_fault(text: str) -> None:
    with pytest.raises(FaultsError, match="neither YAML nor JSON"):
        read_network(text)


def test_numbers_of_a_network_are_finite_and_its_names_can_be_posted() -> None:
    text = """
name: n
parameters: [{name: rate, level: shared, nominal: .nan, prior: {kind: uniform, low: 0, high: 1}}]
quantities:
  - {name: pressure drop, unit: kPa, kind: scalar, low: 0, high: .inf,
     sigma_obs: {kind: log_uniform, low: 0.05, high: 2}}
"""
    with pytest.raises(FaultsError) as caught:
        read_network(text)
    assert [one.what for one in caught.value.faults] == [
        "network.parameters[0].nominal",
        "network.quantities[0].high",
        "network.quantities[0].name",
    ]
    big = text.replace(".nan", "1" + "0" * 400).replace(".inf", "9")
    with pytest.raises(FaultsError, match="the number at line 3 has 401 characters, above 40"):
        read_network(big)


@pytest.mark.parametrize(
    ("kind", "body", "problem"),
    [
        ("text/csv", (b"a" * 19_000 + b"\n") * 200, "is no column"),
        ("text/csv", b",".join(b"c%d" % i for i in range(3000)) + b"\nx\n" * 3000, "more columns"),
        ("", b'{"id":"a","values":[' + b'"a",' * 500_000 + b"0]}", "at most 100000 items"),
        ("", b"{" + b",".join(b'"%d":0' % i for i in range(50_000)) + b"}", "are too many"),
    ],
)
def test_a_body_of_one_megabyte_is_refused_in_a_second_or_two(
    kind: str, body: bytes, problem: str
) -> None:
    begun = time.process_time()
    told = refused(body, kind)
    assert time.process_time() - begun < 10
    assert any(problem in one["problem"] for one in told.faults), told.faults[:2]
    assert len(told.faults) <= MOST_FAULTS + 1


def test_observations_above_the_bound_are_refused_while_they_are_read(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sensorthings, "MOST_READINGS", 3)
    rows = [[f"i{i}", 0.1, 8e3] for i in range(4)]
    names = ["id", "result", "parameters/time_h"]
    stream = {"Datastream": {"@iot.id": "B1/elongation"}, "components": names}

    def body(count: int) -> bytes:
        return json.dumps([stream | {"dataArray": rows[:count]}]).encode()

    assert len(read_inspections(body(3), reading_bodies.MEDIA)) == 3
    told = refused(body(4), reading_bodies.MEDIA)
    assert told.faults[0]["problem"] == "are above 3"


def test_times_longer_than_its_bound_are_refused_and_the_document_says_which(
    api: httpx.Client, rotor: str, worker: Worker
) -> None:
    worker.drain()
    long = ",".join(["8000"] * 3500)
    assert len(long) > LONGEST_TIMES
    for path, more in (
        (PREDICTION, {}),
        ("/v1/rotors/r1/blades/B1/life", {"limit": "1"}),
        ("/v1/rotors/r1/life", {"limit": "1"}),
        ("/v1/rotors/r1/series", {}),
    ):
        told = api.get(path, params={"times": long} | more)
        fields = [one["field"] for one in told.json()["faults"]]
        assert (told.status_code, "times" in fields) == (422, True), path
    told = api.get("/v1/rotors/r1/life", params={"limit": "1", "ahead": long})
    assert (told.status_code, [one["field"] for one in told.json()["faults"]]) == (422, ["ahead"])
    text = json.dumps(api.get("/openapi.json").json())
    assert text.count(f'"maxLength": {LONGEST_TIMES}') == 7


def test_another_site_s_page_needs_a_loopback_name_as_everybody() -> None:
    allowed = "https://dash.example"
    asked = loop(sec_fetch_site="cross-site", origin=allowed, host="evil.example")
    assert not by_loopback(asked, (allowed,))


@pytest.mark.parametrize("number", ["1" + "0" * 400, "1" + ":1" * 50_000, "1." + "0" * 60])
def test_a_number_of_a_network_above_forty_characters_is_told_with_its_line(number: str) -> None:
    begun = time.process_time()
    with pytest.raises(FaultsError, match=r"the number at line 2 has \d+ characters, above 40"):
        read_network(f"name: n\nschema: {number}")
    assert time.process_time() - begun < 2


def test_a_network_of_too_many_entries_is_one_fault() -> None:
    with pytest.raises(FaultsError) as caught:
        read_network("{name: n, parameters: [" + "0," * 2000 + "0], quantities: []}")
    (one,) = caught.value.faults
    assert (one.what, one.value, one.problem) == ("network.parameters", 2001, "are too many")
    keys = ",".join(f"k{i}: 0" for i in range(2000))
    with pytest.raises(FaultsError) as caught:
        read_network("{" + keys + "}")
    assert [one.problem for one in caught.value.faults] == ["are too many"]


def test_numbers_are_finite_wherever_a_network_has_them() -> None:
    text = """
name: n
notes: {seen: [1, .nan]}
parameters:
  - {name: "rate\\n", level: local, prior: {kind: normal, low: 0, high: 1, mean: .nan},
     population: {spread: .inf}}
quantities:
  - {name: drop, unit: kPa, kind: scalar, low: 0, high: 1, numerical: .nan,
     sigma_obs: {kind: log_uniform, low: 0.05, high: 2}, discrepancy: {sd: -.inf}}
"""
    with pytest.raises(FaultsError) as caught:
        read_network(text)
    assert {one.what for one in caught.value.faults} == {
        "network.notes.seen[1]",
        "network.parameters[0].name",
        "network.parameters[0].prior.mean",
        "network.parameters[0].population.spread",
        "network.quantities[0].numerical",
        "network.quantities[0].discrepancy.sd",
    }
