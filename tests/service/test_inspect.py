"""`bladetwin inspect` against a served rotor."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

import httpx
import pytest
from typer.testing import CliRunner

from core.errors import BladetwinError
from core.observation import Inspection
from service.cli import app
from service.client import ProblemError
from service.client.table import Calls
from service.commands.blade_table import around, blade_lines
from service.handlers.blades import retire_blade
from service.report.words import percent
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker

Json = dict[str, Any]


def run(*words: str) -> str:
    done = CliRunner().invoke(app, ["inspect", *words])
    if done.exception is not None:
        raise done.exception
    assert done.exit_code == 0
    return done.output


@pytest.fixture
def url(
    api: httpx.Client, rotor: str, post: Callable[..., int],
    reading: Callable[..., Inspection], worker: Worker, store: SqlStore,
) -> str:  # fmt: skip
    """B1 and B2 have a reading, B3 none and is retired."""
    post(rotor, reading("i1"), reading("i2", blade="B2", time_h=16_000.0, value=0.31))
    retire_blade(store, rotor, "B3")
    worker.drain()
    return str(api.base_url)


def test_the_summary_says_of_each_blade_what_the_api_says(api: httpx.Client, url: str) -> None:
    told = json.loads(run("r1", "--url", url, "--limit", "0.9", "--json"))
    rotor = api.get("/v1/rotors/r1").json()
    assert told["rotor"] == rotor
    assert (
        told["posterior"] == api.get(f"/v1/rotors/r1/posterior?version={rotor['version']}").json()
    )
    assert told["question"] == {
        "quantity": "elongation", "unit": "mm", "time_h": 50_000.0, "node": None, "limit": 0.9,
    }  # fmt: skip
    listed = api.get("/v1/rotors/r1/blades").json()["items"]
    asked = {"limit": 0.9, "times": 50_000, "version": rotor["version"]}
    life = api.get("/v1/rotors/r1/life", params=asked).json()
    assert told["life"] == {
        **{name: life[name][0] for name in ("time_h", "expected", "any")}, "ahead": False,
    }  # fmt: skip
    passed = {one["id"]: one["passed"][0] for one in life["blades"]}
    assert {*passed} == {"B1", "B2"}, "B3 has left"
    for blade, own in zip(told["blades"], listed, strict=True):
        added = ("parameters", "margin_sd", "passed")
        assert {k: v for k, v in blade.items() if k not in added} == own
        assert blade["passed"] == passed.get(blade["id"])
        mean, sd = own["prediction"]["mean"], own["prediction"]["sd"]["blade"]
        assert blade["margin_sd"] == (0.9 - mean) / sd
        posterior = api.get(f"/v1/rotors/r1/blades/{blade['id']}/posterior").json()
        offset = posterior["parameters"]["offset"]
        assert blade["parameters"] == {"offset": {"mean": offset["mean"], "sd": offset["sd"]}}


def test_hours_ahead_are_of_each_blade_from_its_own_age(api: httpx.Client, url: str) -> None:
    words = ("r1", "--url", url, "--limit", "0.5", "--ahead", "8000")
    told = json.loads(run(*words, "--json"))
    life = api.get("/v1/rotors/r1/life", params={"limit": 0.5, "ahead": 8000}).json()
    assert told["life"] == {
        "time_h": 8000.0, "expected": life["expected"][0], "any": life["any"][0], "ahead": True,
    }  # fmt: skip
    own = {one["id"]: one for one in life["blades"]}
    for blade in told["blades"][:2]:
        for name in ("age_h", "age_by"):
            assert blade[name] == own[blade["id"]][name]
        assert blade["passed"] == own[blade["id"]]["passed"][0]
        assert "margin_sd" not in blade, "it would be of another hour"
    assert [one["age_h"] for one in told["blades"]] == [8000.0, 16_000.0, None]
    text = run(*words)
    assert "  limit    0.5 mm within 8,000 h from now on: " in text
    head = next(line for line in text.splitlines() if line.startswith("blade "))
    assert re.search(r"age \[h\]  passed ", head)
    assert "margin" not in head
    assert text.count("age as of its last reading") == 2, "no campaign tells that B1 has run since"
    with pytest.raises(BladetwinError, match="is given without --limit"):
        run("r1", "--url", url, "--ahead", "8000")


def test_people_get_a_table_with_what_to_look_at(api: httpx.Client, url: str) -> None:
    text = run("r1", "--url", url, "--limit", "1.0")
    lines = text.splitlines()
    version = api.get("/v1/rotors/r1").json()["version"]
    assert lines[0].startswith("rotor r1: 3 blades, model rotor-blade fake-")
    assert "  status   current, 3 of 3 entries applied" in lines
    assert any(
        line.startswith(f"  version  {version}, sealed, through entry 3, ") for line in lines
    )
    assert "  health   ok" in lines
    head = next(line for line in lines if line.startswith("blade "))
    assert "elongation [mm] at 50,000 h" in head
    assert "posted last, at [h]" in head, "its hour: a late reading has an early one"
    assert "offset [mm]" in head
    rate = api.get("/v1/rotors/r1/posterior").json()["parameters"]["rate"]
    assert f"  rate = {around(rate['mean'], rate['sd'])} mm" in lines
    rows = {line.split()[0]: line for line in lines[lines.index(head) + 1 :]}
    assert list(rows) == ["B1", "B2", "B3"]
    told = json.loads(run("r1", "--url", url, "--limit", "1.0", "--json"))
    chances = {one["id"]: one["passed"] for one in told["blades"]}
    assert chances["B1"] < 0.001
    assert 0.023 < chances["B2"] < 0.5
    assert rows["B2"].endswith(f"limit passed with {percent(chances['B2'])}")
    assert f" {percent(chances['B2'])} " in rows["B2"], "and in its column"
    assert re.search(r"margin \[sd\]  passed +offset \[mm\]$", head)
    assert "< 0.1 %" in rows["B1"]
    assert not rows["B1"].endswith("%")
    expected, at_all = told["life"]["expected"], percent(told["life"]["any"])
    assert (
        f"  limit    1 mm by 50,000 h of each blade: {expected:.1f} expected past it, "
        f"at least one with {at_all}"
    ) in lines
    beyond = run("r1", "--url", url, "--limit", "0.1")
    assert beyond.count("beyond the limit (> 99.9 %)") == 2
    assert rows["B3"].endswith("retired, limit within 2 sd, no reading")
    assert "limit" not in run("r1", "--url", url), "negative control: none was given"
    assert rows["B1"].index(" 0.6") + 1 == head.index("elongation"), "columns are under their heads"


def test_residuals_that_alarm_are_told(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """No blade's line says it: their predictions may all be wrong alike."""
    assert json.loads(run("r1", "--url", url, "--json"))["residuals"] is None
    test = {"grouping": "campaign", "value": "c2", "statistic": "mean", "alarm": True}
    found = {"as_of": {"version": 1}, "tests": [test, test | {"value": "c3", "alarm": False}]}
    monkeypatch.setattr(Calls, "residuals", lambda *given, **more: found)
    assert "  residuals alarm in version 1: campaign c2 (mean)" in run("r1", "--url", url)
    told = json.loads(run("r1", "--url", url, "--json"))
    assert told["residuals"] == {"version": 1, "alarms": [test]}


def test_a_vector_is_told_in_three_directions(api: httpx.Client, url: str) -> None:
    asked = ("--quantity", "deformation", "--time-h", "16000", "--node", "17")
    text = run("r1", "--url", url, *asked)
    assert "deformation x, y, z [mm] at node 17, 16,000 h" in text
    path = "/v1/rotors/r1/blades?quantity=deformation&time_h=16000&node=17"
    told = api.get(path).json()["items"][1]["prediction"]
    assert f"0, 0, {around(told['mean'][2], told['sd']['blade'][2])}  " in text
    limited = run("r1", "--url", url, *asked, "--limit", "1")
    assert "margin of z [sd]" in limited
    assert "  limit    1 mm by 16,000 h of each blade: 0.0 expected past it" in limited


def test_a_field_is_told_at_its_node_and_what_nobody_chose_as_on_the_pages(
    url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "ceeq [1] at node 3 (critical), 50,000 h" in run(
        "r1", "--url", url, "--quantity", "ceeq"
    )
    monkeypatch.setattr("service.commands.inspect.USUAL_H", 30_000.0)  # of a model that goes on
    told = json.loads(run("r1", "--url", url, "--quantity", "ceeq", "--json"))
    assert told["question"]["time_h"] == 30_000.0
    assert told["question"]["node"] == 3
    other = json.loads(run("r1", "--url", url, "--quantity", "ceeq", "--time-h", "50000", "--json"))
    mean = [one["blades"][0]["prediction"]["mean"] for one in (told, other)]
    assert mean[0] < mean[1]


def test_a_narrow_terminal_gets_whole_lines(url: str) -> None:
    told = json.loads(run("r1", "--url", url, "--limit", "1.0", "--json"))
    wide = [*blade_lines(told, None)]
    most = max(map(len, wide))
    assert [*blade_lines(told, most)] == wide
    first, head, *rows, left, out = blade_lines(told, 100)
    assert max(map(len, [first, head, *rows, left, out])) <= 100 < most
    assert first == "predicted: elongation [mm] at 50,000 h"
    assert "offset" not in head
    assert [row.split()[0] for row in rows] == ["B1", "B2", "B3"]
    assert left.startswith("slots, lots, margins and parameters are left out")
    assert head.split()[-1] == "passed", "the margin misleads more easily"
    del told["question"]["limit"]
    assert [*blade_lines(told, 70)][-2].startswith("slots, lots and parameters are left out")
    assert out == f"100 columns, and the whole table {most}"


def test_a_rotor_without_a_posterior_says_what_is_missing(api: httpx.Client, rotor: str) -> None:
    text = run("r1", "--url", str(api.base_url))
    assert "no posterior yet" in text
    assert json.loads(run("r1", "--url", str(api.base_url), "--json"))["blades"] == []


def test_what_is_not_there_and_who_does_not_answer_are_said(url: str) -> None:
    with pytest.raises(ProblemError, match="404"):
        run("nobody", "--url", url)
    with pytest.raises(ProblemError, match="temperature"):
        run("r1", "--url", url, "--quantity", "temperature")
    with pytest.raises(BladetwinError, match="does not answer"):
        run("r1", "--url", "http://127.0.0.1:9")


HEAD = "id,blade,quantity,time_h,value,unit\n"
FILES = {
    "good.csv": (HEAD + "i1,B1,elongation,8000,0.11,\nn1,B2,elongation,9000,0.2,mm\n", 1, 1, []),
    "none.csv": ("", 0, 0, ["id", "blade", "quantity", "time_h", "value"]),
    "bad.csv": (
        HEAD + "i1,B1,elongation,8000,0.12,\nn2,B7,elongation,60000,77,m\nn3,B1,ceeq,1,0.1,\n"
        "n3,B1,ceeq,1,0.2,\n",
        2, 0, ["line 3.blade", "line 3.unit", "line 3.time_h", "line 3.values", "line 2.id",
               "line 5.id"],
    ),
    "one.json": ('{"id": "n", "blade": "B1", "quantity": "ceeq", "time_h": 1, "value": 0.1}',
                 1, 0, []),
    "entities.json": ('[{"Datastream": {"@iot.id": "B1/ceeq"}, "components": ["id", "result"], '
                      '"dataArray": [["n", 0.1]]}]', 0, 0, ["[0].dataArray[0].parameters.time_h"]),
    "broken.json": ("{", 0, 0, ["file"]),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_a_file_is_checked_as_the_service_would_and_nothing_is_posted(
    api: httpx.Client, url: str, tmp_path: Any, name: str
) -> None:
    text, new, same, fields = FILES[name]
    file = tmp_path / name
    file.write_text(text)
    head = api.get("/v1/rotors/r1").json()["head_seq"]
    done = CliRunner().invoke(app, ["inspect", "r1", "--file", str(file), "--url", url, "--json"])
    told = json.loads(done.output)
    assert done.exit_code == (3 if fields else 0)
    assert (told["new"], told["same"]) == (new, same)
    assert [one["field"] for one in told["faults"]][: len(fields)] == fields
    assert all(one["remedy"] for one in told["faults"])
    assert api.get("/v1/rotors/r1").json()["head_seq"] == head
    if name.endswith(".csv") and name != "bad.csv":
        sent = api.post("/v1/rotors/r1/inspections", content=text.encode(),
                        headers={"content-type": "text/csv"})  # fmt: skip
        assert (sent.status_code == 202) == (not fields), "the service says the same"


def test_the_check_of_a_file_is_told_in_lines(url: str, tmp_path: Any) -> None:
    file = tmp_path / "x.csv"
    file.write_text(FILES["good.csv"][0])
    assert run("r1", "--file", str(file), "--url", url).splitlines() == [
        f"{file}: 2 readings, 1 of them new to rotor r1, 1 there already", "it can be posted",
    ]  # fmt: skip
    file.write_text(HEAD + "n1,B7,elongation,8000,x,\nn2,B1,elongation,,0.2,\n")
    done = CliRunner().invoke(app, ["inspect", "r1", "--file", str(file), "--url", url])
    first, *faults, last = done.output.splitlines()
    assert first == f"{file}: 3 faults, and its readings cannot be counted before they are mended"
    assert [one.split()[1][0] for one in faults] == ["2", "2", "3"], "by line"
    assert last.startswith("nothing of it can be posted")
    with pytest.raises(BladetwinError, match="cannot be read"):
        run("r1", "--file", str(tmp_path / "none.csv"), "--url", url)
    with pytest.raises(BladetwinError, match="beside a file"):
        run("r1", "--file", str(file), "--limit", "0.9", "--url", url)


def test_corrections_that_leave_two_readings_are_noted(
    api: httpx.Client, url: str, tmp_path: Any
) -> None:
    first = {"blade": "B1", "quantity": "elongation", "time_h": 9000, "value": 0.2}
    for name, replaced in (("k", None), ("k2", "k")):
        sent = first | {"id": name} | ({"replaces": replaced} if replaced else {})
        assert api.post("/v1/rotors/r1/inspections", json=sent).status_code == 202
    file = tmp_path / "x.csv"
    rows = [("k2", "k"), ("k3", "k"), ("k4", "k2"), ("k5", "k2"), ("k6", "misspelt"), ("k7", "k6")]
    lines = [
        f"{own},B1,elongation,9000,{0.2 + 0.01 * (n > 0) * n:g},{named}\n"
        for n, (own, named) in enumerate(rows)
    ]
    file.write_text("id,blade,quantity,time_h,value,replaces\n" + "".join(lines))
    done = CliRunner().invoke(app, ["inspect", "r1", "--file", str(file), "--url", url, "--json"])
    told = json.loads(done.output)
    assert (done.exit_code, told["same"], told["new"], told["faults"]) == (0, 1, 5, [])
    assert [
        (one["field"], one["value"], one["problem"].split(":")[0]) for one in told["notes"]
    ] == [
        ("line 3.replaces", "k", "is replaced already"),
        ("line 5.replaces", "k2", "is replaced by line 4, too"),
        ("line 6.replaces", "misspelt", "is no reading of the rotor yet"),
    ]
    text = run("r1", "--file", str(file), "--url", url).splitlines()
    assert [line.split()[0] for line in text[1:-1]] == ["note:"] * 3


def test_readings_that_come_again_under_other_ids_are_noted(
    api: httpx.Client, url: str, tmp_path: Any
) -> None:
    """A shop numbers its rows anew with each export; the rotor would count each reading twice."""
    first = {"blade": "B1", "quantity": "elongation", "time_h": 9000, "campaign": "c1"}
    for name, value in (("k", 0.2), ("gone", 0.3)):
        sent = first | {"id": name, "value": value}
        assert api.post("/v1/rotors/r1/inspections", json=sent).status_code == 202
    assert api.post("/v1/rotors/r1/inspections/gone/retraction").status_code == 202
    file = tmp_path / "x.csv"
    rows = [
        "1,B1,elongation,9000,0.2,c1,", "2,B1,elongation,9000,0.2,c2,",  # another campaign
        "3,B1,elongation,9000,0.3,c1,", "4,B1,elongation,9000.0,0.30,c1,",
        "5,B1,elongation,9000,0.2,c1,k",
    ]  # fmt: skip
    file.write_text("id,blade,quantity,time_h,value,campaign,replaces\n" + "\n".join(rows) + "\n")
    done = CliRunner().invoke(app, ["inspect", "r1", "--file", str(file), "--url", url, "--json"])
    told = json.loads(done.output)
    assert (done.exit_code, told["new"], told["faults"]) == (0, 5, [])
    notes = [(one["field"], one["problem"].partition(" (")[0]) for one in told["notes"]]
    assert notes == [("line 2.id", "says what k says"), ("line 5.id", "says what 3 says")]


def test_a_limit_that_is_no_number_is_refused(url: str) -> None:
    with pytest.raises(BladetwinError, match="--limit = nan is no number"):
        run("r1", "--limit", "nan", "--url", url)
