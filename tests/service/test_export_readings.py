"""Readings as CSV, which can be posted again, and as Parquet, read back by pandas."""

from __future__ import annotations

import builtins
import io
from collections.abc import Callable
from datetime import datetime
from typing import Any

import httpx
import pandas
import pyarrow.parquet
import pytest

from core.observation import Inspection
from service.handlers import listing
from service.handlers.inspections import retract
from service.handlers.rotors import create_rotor
from service.ports import BladeRecord
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker

Json = dict[str, Any]
Post = Callable[..., int]
URL = "/v1/rotors/r1/inspections"
CSV = {"content-type": "text/csv"}
SCAN = {
    "id": "scan", "blade": "B2", "quantity": "deformation", "time_h": 0.1 + 0.2, "nodes": [12, 7],
    "values": [[0.01, -0.02, 1e-05], [0.1 + 0.2, 0.0, 1 / 3]], "unit": "mm", "sigma": 0.02,
}  # fmt: skip
READINGS: list[Json] = [
    {"id": "a", "blade": "B1", "quantity": "elongation", "time_h": 8000, "value": 0.11},
    {"id": "b", "blade": "B2", "quantity": "ceeq", "time_h": 8000.25, "values": [0.0012],
     "nodes": [17], "unit": "1", "campaign": 'outage, "1"'},
    SCAN,
    {"id": "c", "blade": "B1", "quantity": "elongation", "time_h": 8000, "value": 0.12,
     "replaces": "a", "instrument": "=1+1", "observed_at": "2031-05-04T10:00:00+02:00"},
    {"id": "d", "blade": "B3", "quantity": "elongation", "time_h": 9e3, "value": 1 / 3},
    {"id": "e", "blade": "B3", "quantity": "ceeq", "time_h": 9e3, "value": 0.001},
]  # fmt: skip


@pytest.fixture
def posted(api: httpx.Client, rotor: str, worker: Worker) -> httpx.Client:
    """Six readings, of which `a` was replaced and `d` retracted."""
    assert api.post(URL, json={"inspections": READINGS}).status_code == 202
    assert api.post(f"{URL}/d/retraction").status_code == 202
    worker.drain()
    return api


def test_readings_posted_again_are_the_same_readings(
    posted: httpx.Client, store: SqlStore, worker: Worker
) -> None:
    text = posted.get(f"{URL}?format=csv").content
    again = posted.post(URL, content=text, headers=CSV)
    assert again.headers["idempotent-replayed"] == "true"
    assert again.json()["head_seq"] == 6, "a replayed answer, nothing new"
    assert posted.get("/v1/rotors/r1").json()["head_seq"] == 7
    create_rotor(store, "r2", "rotor-blade", [BladeRecord(b) for b in ("B1", "B2", "B3")], 64, 7)
    assert posted.post("/v1/rotors/r2/inspections", content=text, headers=CSV).status_code == 202
    worker.drain()
    ends = [posted.get(f"/v1/rotors/{r}").json()["posterior"] for r in ("r1", "r2")]
    assert ends[0]["events_digest"] == ends[1]["events_digest"]
    assert ends[0]["state_digest"] == ends[1]["state_digest"]
    spoiled = text.replace(b"0.001,", b"0.002,")
    assert spoiled != text
    refused = posted.post(URL, content=spoiled, headers=CSV)
    assert (refused.status_code, refused.json()["faults"][0]["value"]) == (409, "e")


def test_pandas_reads_the_readings_that_count(posted: httpx.Client) -> None:
    answer = posted.get(f"{URL}?format=csv")
    assert answer.headers["content-type"] == "text/csv; charset=utf-8"
    assert answer.headers["content-disposition"] == 'attachment; filename="r1-readings-7.csv"'
    found = pandas.read_csv(io.BytesIO(answer.content))
    assert found["id"].tolist() == ["b", "scan", "scan", "c", "e"]
    assert found["time_h"].tolist() == [8000.25, 0.1 + 0.2, 0.1 + 0.2, 8000.0, 9000.0]
    scan = found[found["id"] == "scan"]
    assert scan[["x", "y", "z"]].to_numpy().tolist() == SCAN["values"]
    assert scan["node"].tolist() == [12, 7]
    assert found["campaign"].dropna().tolist() == ['outage, "1"']
    mine = posted.get(f"{URL}?format=csv&blade=B3").content
    assert pandas.read_csv(io.BytesIO(mine))["id"].tolist() == ["e"]


def test_pandas_and_pyarrow_read_every_reading_with_its_status(posted: httpx.Client) -> None:
    answer = posted.get(f"{URL}?format=parquet")
    found = pandas.read_parquet(io.BytesIO(answer.content))
    assert found["id"].tolist() == ["a", "b", "scan", "scan", "c", "d", "e"]
    status = dict(zip(found["id"], found["status"], strict=True))
    listed = posted.get(URL).json()["items"]
    assert status == {one["id"]: one["status"] for one in listed}
    assert (status["a"], status["d"]) == ("replaced", "retracted")
    for one in listed:
        rows = found[found["id"] == one["id"]]
        assert set(rows["seq"]) == {one["seq"]}
        came = datetime.fromisoformat(one["received_at"])
        assert abs((rows["received_at"].iloc[0] - came).total_seconds()) < 0.001
        values = one["values"]
        if one["id"] == "scan":
            assert rows[["x", "y", "z"]].to_numpy().tolist() == values
            assert rows["value"].isna().all()
        else:
            assert rows["value"].tolist() == values
    schema = pyarrow.parquet.read_schema(io.BytesIO(answer.content))
    assert (schema.metadata[b"rotor"], schema.metadata[b"head_seq"]) == (b"r1", b"7")


def test_entries_that_come_while_a_file_is_written_are_left_out(
    rotor: str, store: SqlStore, post: Post, reading: Callable[..., Inspection],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(listing, "PAGE", 2)
    post(rotor, *(reading(f"i{i}", time_h=100.0 * i) for i in range(5)))
    log, pages = listing.all_inspections(store, rotor, None)
    first = next(pages)
    retract(store, rotor, "i3")
    post(rotor, reading("late", replaces="i4"))
    rest = [one for page in pages for one in page]
    assert log.head_seq == 5
    assert [one.body["id"] for one in first + rest] == ["i0", "i1", "i2", "i3", "i4"]
    assert {one.status for one in first + rest} == {"counts"}
    now = [one for page in listing.all_inspections(store, rotor, None)[1] for one in page]
    assert [one.status for one in now] == ["counts"] * 3 + ["retracted", "replaced", "counts"]


def test_what_belongs_to_pages_is_refused_for_a_file(posted: httpx.Client) -> None:
    answer = posted.get(f"{URL}?format=csv&limit=2&cursor=3&newest=true")
    assert answer.status_code == 422
    assert [one["field"] for one in answer.json()["faults"]] == ["limit", "cursor", "newest"]
    assert posted.get("/v1/rotors/none/inspections?format=csv").status_code == 404


def test_without_pyarrow_parquet_is_not_installed_and_csv_is_as_ever(
    posted: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    true = builtins.__import__

    def without(name: str, *args: Any, **kw: Any) -> Any:
        if name.startswith("pyarrow"):
            raise ModuleNotFoundError(name)
        return true(name, *args, **kw)

    monkeypatch.setattr(builtins, "__import__", without)
    answer = posted.get(f"{URL}?format=parquet")
    assert (answer.status_code, answer.json()["title"]) == (501, "not installed")
    fault = answer.json()["faults"][0]
    assert (fault["field"], fault["value"]) == ("format", "parquet")
    assert fault["remedy"] == "install bladetwin[export] on the server, or use format=csv"
    assert posted.get(f"{URL}?format=csv").status_code == 200


HEAD = "id,blade,quantity,time_h,value,node,x,y,z,unit\n"
SCANS: list[tuple[str, str]] = [
    ("s,B1,deformation,1,,3,1,2,,mm\n", "line 2.z"),
    ("s,B1,deformation,1,5,3,1,2,3,mm\n", "line 2.value"),
    ("s,B1,deformation,1,,,1,2,3,mm\n", "line 2.node"),
    ("s,B1,deformation,1,,3,1,2,3,mm\ns,B1,deformation,2,,4,1,2,3,mm\n", "line 3.time_h"),
    ("s,B1,deformation,1,,3,1,2,3,mm\ns,B1,deformation,1,,3,1,2,3,mm\n", "line 2.nodes"),
    ("s,B1,deformation,1,,3,1,nan,3,mm\n", "line 2.y"),
    ("s,B1,deformation,1,,3.5,1,2,3,mm\n", "line 2.node"),
    ("s,B1,elongation,1,,,,,,mm\n", "line 2.value"),
]


@pytest.mark.parametrize(("rows", "field"), SCANS)
def test_a_scan_that_does_not_fit_is_refused_by_line(
    api: httpx.Client, rotor: str, rows: str, field: str
) -> None:
    answer = api.post(URL, content=(HEAD + rows).encode(), headers=CSV)
    assert answer.status_code == 422
    assert answer.json()["faults"][0]["field"] == field
    assert api.get("/v1/rotors/r1").json()["head_seq"] == 0


def test_every_fault_of_a_scan_is_told_by_its_own_line(api: httpx.Client, rotor: str) -> None:
    """A scanner leaves nodes out, and which of five thousand rows it was nobody wants to count."""
    rows = (
        "s,B1,deformation,1,,3,1,2,3,mm\n"
        "s,B1,deformation,1,,4,1,,3,mm\n"
        "s,B1,deformation,1,,tip,NaN,2,3,mm\n"
        "e,B9,elongation,1,0.5,,,,,mm\n"
    )
    answer = api.post(URL, content=(HEAD + rows).encode(), headers=CSV)
    faults = {one["field"]: one["remedy"] for one in answer.json()["faults"]}
    assert [*faults] == ["line 3.y", "line 4.x", "line 4.node", "line 5.blade"]
    assert "leave out the row of a node that was not read" in faults["line 3.y"]


def test_scans_of_a_csv_may_stand_between_other_rows(api: httpx.Client, rotor: str) -> None:
    rows = (
        "s,B1,deformation,1,,3,1,2,3,mm\n"
        "e,B1,elongation,1,0.5,,,,,mm\n"
        "t,B2,deformation,1,,3,4,5,6,mm\n"
        "s,B1,deformation,1,,9,7,8,9,mm\n"
    )
    answer = api.post(URL, content=(HEAD + rows).encode(), headers=CSV)
    assert [item["id"] for item in answer.json()["items"]] == ["s", "e", "t"]
    stored = api.get(f"{URL}/s").json()
    assert (stored["nodes"], stored["values"]) == ([3, 9], [[1, 2, 3], [7, 8, 9]])
