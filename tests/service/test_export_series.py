"""Fields over hours: PVD with its VTU files, and numpy arrays."""

from __future__ import annotations

import io
import json
import sys
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import meshio
import numpy as np
import pyarrow
import pytest

from core.observation import Inspection
from service.client import Client
from service.export.series import angles
from service.handlers import series
from service.handlers.rotors import create_rotor
from service.ports import BladeRecord
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker

BLADE, ROTOR = "/v1/rotors/r1/blades/B1", "/v1/rotors/r1"
HOURS = (0.1, 8000.0, 50_000.0)
TIMES = "times=0.1,8000,50000"


@pytest.fixture
def told(
    rotor: str, post: Callable[..., int], reading: Callable[..., Inspection], worker: Worker
) -> str:
    """B1 has a reading."""
    post(rotor, reading("i1"))
    worker.drain()
    return rotor


def collected(body: bytes, folder: Path) -> dict[tuple[str, float], meshio.Mesh]:
    """What a PVD names, by blade and hour; the zip holds that and nothing else."""
    with zipfile.ZipFile(io.BytesIO(body)) as archive:
        assert archive.testzip() is None
        archive.extractall(folder)
        names = set(archive.namelist())
    root = ET.parse(folder / "field.pvd").getroot()
    assert (root.tag, root.attrib["type"]) == ("VTKFile", "Collection")
    listed = root.findall("Collection/DataSet")
    assert {one.attrib["file"] for one in listed} == names - {"field.pvd"}
    assert len(listed) == len(names) - 1
    return {
        (one.attrib["name"], float(one.attrib["timestep"])): meshio.read(
            folder / one.attrib["file"]
        )
        for one in listed
    }


@pytest.mark.parametrize("quantity", ["deformation", "ceeq"])
def test_each_step_of_a_pvd_is_the_field_that_the_api_says_at_its_hour(
    api: httpx.Client, told: str, tmp_path: Path, quantity: str
) -> None:
    answer = api.get(f"{BLADE}/field?quantity={quantity}&{TIMES}&format=pvd")
    assert answer.headers["content-type"] == "application/zip"
    version = api.get(ROTOR).json()["version"]
    saved = f'attachment; filename="r1-B1-{quantity}-v{version}.pvd.zip"'
    assert answer.headers["content-disposition"] == saved
    found = collected(answer.content, tmp_path)
    assert sorted(found) == [("B1", hour) for hour in HOURS]
    for (_, hour), mesh in found.items():
        said = api.get(f"{BLADE}/field?quantity={quantity}&time_h={hour!r}").json()
        for what in ("mean", "sd"):
            values = mesh.point_data[f"{quantity} {what} [{said['unit']}]"]
            assert values.tolist() == said[what], (hour, what)
        assert mesh.field_data["TimeValue"].tolist() == [hour]
    again = api.get(f"{BLADE}/field?quantity={quantity}&{TIMES}&format=pvd")
    assert again.content == answer.content, "no clock is in it"
    tag = {"If-None-Match": answer.headers["etag"]}
    assert api.get(f"{BLADE}/field?quantity={quantity}&{TIMES}&format=pvd", headers=tag
                   ).status_code == 304  # fmt: skip


def test_the_blades_of_a_rotor_stand_around_its_axis(
    api: httpx.Client, store: SqlStore, worker: Worker, tmp_path: Path
) -> None:
    """Four slots, of which the second is empty; a mean is turned with its blade."""
    blades = [BladeRecord(n, slot=s) for n, s in (("A:1", "4"), ("A_1", "1"), ("C", "3"))]
    create_rotor(store, "r4", "rotor-blade", blades, 64, 7)
    worker.drain()
    answer = api.get("/v1/rotors/r4/field?quantity=deformation&times=0.5,50000&format=pvd")
    found = collected(answer.content, tmp_path)
    assert sorted(found) == [(n, h) for n in ("A:1", "A_1", "C") for h in (0.5, 50_000.0)]
    flat = np.array(api.get("/v1/models/rotor-blade/surface").json()["points"])
    for name, slot in (("A:1", 4), ("A_1", 1), ("C", 3)):
        angle = np.pi / 2 * (slot - 1)
        out = np.array([0.0, -np.sin(angle), np.cos(angle)])  # where its z, the radius, goes
        mesh = found[name, 50_000.0]
        assert np.abs(mesh.points @ out - flat[:, 2]).max() < 1e-3 + 1e-6 * flat[:, 2].max()
        assert np.abs(mesh.points[:, 0] - flat[:, 0]).max() < 1e-3
        said = api.get(f"/v1/rotors/r4/blades/{name}/field?quantity=deformation").json()
        mean = np.array(said["mean"])[:, 2]
        assert mean[-1] > 0.1
        turned = mesh.point_data["deformation mean [mm]"]
        np.testing.assert_allclose(turned @ out, mean, rtol=1e-12)
        assert mesh.point_data["deformation sd [mm]"].tolist() == said["sd"], "the blade's own axes"
    only = api.get("/v1/rotors/r4/field?quantity=ceeq&times=0.5&blades=C,A_1&format=pvd")
    two = collected(only.content, tmp_path / "two")
    assert sorted(two) == [("A_1", 0.5), ("C", 0.5)]
    for name in ("A_1", "C"):  # where it stands among all, not among those that are shown
        assert np.array_equal(two[name, 0.5].points, found[name, 0.5].points)


def test_a_blade_stands_where_it_stands_whichever_are_shown_or_left() -> None:
    def half_turns(shown: str, everyone: list[BladeRecord]) -> list[float]:
        blades = [one for one in everyone if one.id in shown]
        return [round(a / np.pi, 3) for a in angles(blades, everyone)]

    slots = [BladeRecord(n, slot=s) for n, s in (("A", "1"), ("B", "3"), ("C", "4"))]
    assert half_turns("ABC", slots) == [0.0, 1.0, 1.5]
    assert half_turns("B", slots) == [1.0]
    left = [*slots[:2], replace(slots[2], retired_seq=9)]
    assert half_turns("AB", left) == [0.0, 1.0], "the slot is there though its blade left"
    after = [*left, BladeRecord("D", slot="4")]
    assert half_turns("ABD", after) == [0.0, 1.0, 1.5], "another blade in the same slot"
    assert half_turns("C", after) == [1.5]
    named = [BladeRecord("A", slot="one"), *slots[1:], BladeRecord("D")]
    assert half_turns("AD", named) == [0.0, 1.5]


@pytest.mark.parametrize("quantity", ["deformation", "ceeq"])
def test_arrow_reads_a_batch_for_each_hour(api: httpx.Client, told: str, quantity: str) -> None:
    answer = api.get(f"{BLADE}/field?quantity={quantity}&{TIMES}&format=arrow")
    assert answer.headers["content-type"] == "application/vnd.apache.arrow.stream"
    with pyarrow.ipc.open_stream(answer.content) as stream:
        facts = json.loads(stream.schema.metadata[b"facts"])
        batches = list(stream)
        unit = stream.schema.field(2).metadata[b"unit"].decode()
    assert (facts["rotor"], facts["blade"], facts["quantity"]) == ("r1", "B1", quantity)
    assert [one["time_h"][0].as_py() for one in batches] == list(HOURS)
    for one, hour in zip(batches, HOURS, strict=True):
        said = api.get(f"{BLADE}/field?quantity={quantity}&time_h={hour!r}").json()
        assert unit == said["unit"]
        frame = one.to_pandas()
        assert frame["node"].tolist() == list(range(len(said["mean"])))
        for what in ("mean", "sd"):
            ends = ["_x", "_y", "_z"] if quantity == "deformation" else [""]
            found = frame[[what + end for end in ends]].to_numpy()
            assert found.tolist() == np.reshape(said[what], found.shape).tolist()


def test_the_client_has_the_stream_too(api: httpx.Client, told: str) -> None:
    twin = Client(http=api)
    body = twin.field_arrow("r1", "B1", "ceeq", times=[5.0, 9000.0])
    frame = pyarrow.ipc.open_stream(body).read_all().to_pandas()
    assert sorted(set(frame["time_h"])) == [5.0, 9000.0]
    series = twin.field_series("r1", "B1", "ceeq", times=[5.0, 9000.0])
    assert frame["mean"].tolist() == series["mean"].reshape(-1).tolist()


def test_without_pyarrow_a_stream_is_refused_with_what_else_there_is(
    api: httpx.Client, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    answer = api.get(f"{BLADE}/field?{TIMES}&format=arrow")
    assert answer.headers["content-type"] == "application/problem+json"
    assert "use format=npz" in answer.json()["detail"]


def test_numpy_reads_a_series_and_what_it_rests_on(api: httpx.Client, told: str) -> None:
    answer = api.get(f"{BLADE}/field?quantity=deformation&{TIMES}&format=npz")
    with np.load(io.BytesIO(answer.content), allow_pickle=False) as found:
        assert found["time_h"].tolist() == list(HOURS)
        assert (found["mean"].shape, found["sd"].shape) == ((3, 6448, 3), (3, 6448, 3))
        assert str(found["unit"]) == "mm"
        facts = json.loads(str(found["facts"]))
        for step, hour in enumerate(HOURS):
            said = api.get(f"{BLADE}/field?quantity=deformation&time_h={hour!r}").json()
            assert found["mean"][step].tolist() == said["mean"]
            assert found["sd"][step].tolist() == said["sd"]
    assert facts["state_digest"] == said["rests_on"]["state_digest"]
    assert (facts["blade"], facts["rotor"]) == ("B1", "r1")
    twin = Client(http=api)
    same = twin.field_series("r1", "B1", "deformation", times=HOURS)
    assert same["mean"][2].tolist() == said["mean"]
    assert (same["unit"], same["facts"]) == ("mm", facts)
    assert twin.field_pvd("r1", "B1", "ceeq", times=[5.0])[:2] == b"PK"
    assert len(twin.field_series("r1", "B1", "ceeq")["time_h"]) == 6, "the model's instants"


@pytest.mark.parametrize(
    ("query", "field", "problem"),
    [
        ("times=5&format=vtu", "times", "is not for format=vtu"),
        ("times=5", "times", "is not for format=json"),
        ("time_h=5&format=pvd", "time_h", "is not for format=pvd"),
        ("times=5,5&format=npz", "times", "do not rise"),
        ("times=5,4&format=pvd", "times", "do not rise"),
        ("times=5,50001&format=pvd", "times", "lies outside 0 … 50000 h, which the model covers"),
        ("times=5,x&format=pvd", "times", "is not a number"),
        ("times=24,000&format=pvd", "times", "is what a comma for thousands leaves"),
        ("quantity=elongation&format=pvd", "quantity", "is no field of the model"),
    ],
)
def test_a_series_that_cannot_be_is_refused(
    api: httpx.Client, told: str, query: str, field: str, problem: str
) -> None:
    answer = api.get(f"{BLADE}/field?{query}")
    assert answer.status_code == 422
    fault = answer.json()["faults"][0]
    assert (fault["field"], fault["problem"]) == (field, problem)


def test_more_than_an_answer_should_hold_is_refused_with_the_number_that_is_not(
    api: httpx.Client, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(series, "MOST_FILES", 8)
    times = "times=1,2,3"
    refused = api.get(f"{ROTOR}/field?quantity=ceeq&{times}").json()["faults"][0]
    assert (refused["value"], refused["problem"]) == (9, "are 3 hours of 3 blades")
    assert api.get(f"{ROTOR}/field?quantity=ceeq&times=1,2").status_code == 200
    monkeypatch.setattr(series, "MOST_VALUES", 2 * 2 * 6448)
    refused = api.get(f"{BLADE}/field?quantity=ceeq&{times}&format=npz").json()["faults"][0]
    assert (refused["value"], refused["remedy"]) == (3, "ask for 2 hours at once")
    assert api.get(f"{BLADE}/field?quantity=ceeq&times=1,2&format=npz").status_code == 200
    missing = api.get(f"{ROTOR}/field?quantity=ceeq&times=1&blades=B1,B7")
    assert missing.status_code == 404
    twice = api.get(f"{ROTOR}/field?quantity=ceeq&times=1&blades=B1,B1").json()["faults"][0]
    assert (twice["field"], twice["value"]) == ("blades", "B1")


def test_a_zip_that_breaks_off_is_no_zip(api: httpx.Client, told: str) -> None:
    """What fails while it is sent cannot be taken for whole: the directory stands at its end."""
    body: Any = api.get(f"{BLADE}/field?quantity=ceeq&times=1,2&format=pvd").content
    assert len(zipfile.ZipFile(io.BytesIO(body)).namelist()) == 3
    with pytest.raises(zipfile.BadZipFile):
        zipfile.ZipFile(io.BytesIO(body[: len(body) - 200]))
