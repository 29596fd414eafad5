"""`bladetwin inspect` against a served rotor."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import httpx
import pytest
from typer.testing import CliRunner

from core.errors import BladetwinError
from core.observation import Inspection
from service.cli import app
from service.client import ProblemError
from service.handlers.rotors import retire_blade
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
    for blade, own in zip(told["blades"], listed, strict=True):
        assert {k: v for k, v in blade.items() if k not in ("parameters", "margin_sd")} == own
        mean, sd = own["prediction"]["mean"], own["prediction"]["sd"]["blade"]
        assert blade["margin_sd"] == (0.9 - mean) / sd
        posterior = api.get(f"/v1/rotors/r1/blades/{blade['id']}/posterior").json()
        offset = posterior["parameters"]["offset"]
        assert blade["parameters"] == {"offset": {"mean": offset["mean"], "sd": offset["sd"]}}


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
    assert "elongation [mm] at 50000 h" in head
    assert "offset [mm]" in head
    rate = api.get("/v1/rotors/r1/posterior").json()["parameters"]["rate"]
    assert f"  rate = {rate['mean']:.4g} ± {rate['sd']:.2g} mm" in lines
    rows = {line.split()[0]: line for line in lines[lines.index(head) + 1 :]}
    assert list(rows) == ["B1", "B2", "B3"]
    assert rows["B2"].endswith("limit within 2 sd")
    assert rows["B3"].endswith("retired, limit within 2 sd, no reading")
    assert "limit" not in run("r1", "--url", url), "negative control: none was given"
    assert rows["B1"].index(" 0.6") + 1 == head.index("elongation"), "columns are under their heads"


def test_a_vector_is_told_in_three_directions(api: httpx.Client, url: str) -> None:
    asked = ("--quantity", "deformation", "--time-h", "16000", "--node", "17")
    text = run("r1", "--url", url, *asked)
    assert "deformation [mm] at 16000 h" in text
    path = "/v1/rotors/r1/blades?quantity=deformation&time_h=16000&node=17"
    z = api.get(path).json()["items"][1]["prediction"]["mean"][2]
    assert f"0 ± 0, 0 ± 0, {z:.4g} ± " in text


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
