"""Frames hold what the API says: the same numbers, every page, sensible types."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pandas
import pytest
import xarray

from core.errors import BladetwinError
from service.client import Client, ProblemError, framed
from service.client.frames import collected
from service.client.steps import Call, Walk
from service.testing import in_memory, in_memory_async

Json = dict[str, Any]
CSV = """id,blade,quantity,time_h,value,unit,sigma,instrument,campaign,observed_at
a1,B1,elongation,8000,0.101,mm,0.015,gauge 3,c1,2031-05-04T10:00:00+02:00
a2,B2,elongation,8100,0.124,,,,c1,
b1,B1,elongation,16000,0.163,mm,,,c2,2032-05-04T10:00:00.25Z
b2,B2,elongation,7000,0.11,mm,,,c2,
"""
BLADES = [
    {"id": "B1", "slot": "2", "lot": "L1", "installed_at": "2030-01-01T00:00:00Z"},
    {"id": "B2", "slot": "1"},
    "B3",
]
HOURS = [0.1, 8000.0, 5e4]
PAGE = 2


@pytest.fixture(scope="module")
def twin() -> Iterator[Client]:
    """Two blades with readings of every kind; lists come in pages of two."""
    with in_memory(page_limit=PAGE) as twin:
        twin.create_rotor("r1", blades=BLADES)
        twin.post_csv("r1", CSV)
        scan: Json = {"quantity": "deformation", "time_h": 16_000, "unit": "mm"}
        values = [[0.0, 0.0, 0.1], [0.0, 0.0, 0.11]]
        many = {"id": "many", "nodes": list(range(20)), "values": [values[0]] * 20}
        seq = twin.post_inspections(
            "r1",
            [
                {"id": "scan", "blade": "B2", "nodes": [6446, 6447], "values": values} | scan,
                {"blade": "B1"} | scan | many,
                {"id": "strain", "blade": "B2", "quantity": "ceeq", "time_h": 9000, "nodes": [3]}
                | {"values": [0.0001]},
                {"id": "a1+", "blade": "B1", "quantity": "elongation", "time_h": 8000}
                | {"value": 0.104, "replaces": "a1"},
            ],
        )
        twin.retract("r1", "a2")
        twin.wait_for("r1", seq + 1)
        twin.wait_sealed("r1")
        yield twin


def test_readings_are_a_row_each_over_every_page(twin: Client) -> None:
    frame = twin.readings_frame("r1")
    listed = list(twin.inspections("r1"))
    assert len(listed) == len(frame) == 8
    assert len(frame) > 2 * PAGE
    assert frame["id"].tolist() == [one["id"] for one in listed]
    for name in ("blade", "quantity", "time_h", "status", "seq", "posted_by"):
        assert frame[name].tolist() == [one[name] for one in listed], name
    assert frame.attrs == {"rotor": "r1"}
    by = frame.set_index("id")
    assert by.loc["a1", ["value", "sigma", "count"]].tolist() == [0.101, 0.015, 1]
    assert by.loc[["a1", "a2", "b1"], "status"].tolist() == ["replaced", "retracted", "counts"]
    assert by.loc["a1+", "replaces"] == "a1"
    assert by.index[by["late"]].tolist() == ["b2", "strain", "a1+"], "after later hours"
    assert np.isnan(by.loc["a2", "sigma"])
    assert pandas.isna(by.loc["a2", "unit"])
    assert twin.readings_frame("r1", blade="B1")["id"].tolist() == ["a1", "b1", "many", "a1+"]


def test_a_scan_is_one_row_with_its_number_of_nodes(twin: Client) -> None:
    by = twin.readings_frame("r1").set_index("id")
    assert by.loc[["scan", "many", "strain", "b1"], "count"].tolist() == [2, 20, 1, 1]
    assert by.loc[["scan", "many"], "value"].isna().all()
    assert by.loc["strain", ["value", "node"]].tolist() == [0.0001, 3]
    assert by.loc[["scan", "many", "b1"], "node"].isna().all()
    assert len(twin.inspection("r1", "many")["values"]) == by.loc["many", "count"]


def test_moments_are_in_utc_and_columns_the_same_where_there_is_no_reading(twin: Client) -> None:
    frame = twin.readings_frame("r1")
    at = frame.set_index("id")["observed_at"]
    assert at["a1"] == pandas.Timestamp("2031-05-04T08:00:00Z")
    assert at["b1"] == pandas.Timestamp("2032-05-04T10:00:00.25Z")
    assert pandas.isna(at["a2"])
    empty = twin.readings_frame("r1", blade="B3")
    assert (len(empty), list(empty.columns)) == (0, list(frame.columns))
    assert empty.dtypes.equals(frame.dtypes)
    kinds = {str(kind): list(frame.columns[frame.dtypes == kind]) for kind in set(frame.dtypes)}
    assert kinds["datetime64[us, UTC]"] == ["observed_at", "received_at"]
    assert kinds["float64"] == ["time_h", "value", "sigma"]
    assert {"id", "blade", "quantity", "status"} <= set(kinds["string"])


def test_a_prediction_has_the_answer_s_numbers_and_what_they_rest_on(twin: Client) -> None:
    frame = twin.prediction_frame("r1", "B1", "elongation", times=HOURS, probability=0.8)
    told = twin.prediction("r1", "B1", "elongation", times=HOURS, probability=0.8)
    assert (frame.index.name, frame.index.tolist()) == ("time_h", HOURS)
    for name in ("mean", "lower", "upper"):
        assert frame[name].tolist() == told[name]
    assert frame["sd"].tolist() == told["sd"]["total"]
    sources = ("parameters", "surrogate", "discrepancy", "noise")
    assert list(frame.columns[4:]) == [f"sd_{source}" for source in sources]
    for source in sources:
        assert frame[f"sd_{source}"].tolist() == told["sd"][source]
    assert frame.attrs["probability"] == 0.8
    for name in ("unit", "quantity", "blade", "rests_on", "health", "noise_from", "node"):
        assert frame.attrs[name] == told[name]
    first = twin.prediction_frame("r1", "B1", times=HOURS, version=1)
    assert first.attrs["rests_on"]["version"] == 1
    assert not np.allclose(first["mean"][1:], frame["mean"][1:]), "negative control"


def test_a_vector_s_columns_have_a_level_of_components(twin: Client) -> None:
    frame = twin.prediction_frame("r1", "B1", "deformation", times=HOURS, node=6446)
    told = twin.prediction("r1", "B1", "deformation", times=HOURS, node=6446)
    assert frame.columns.names == ["of", "component"]
    assert frame["mean"].to_numpy().tolist() == told["mean"]
    assert frame["sd_noise"]["x"].tolist() == [row[0] for row in told["sd"]["noise"]]
    assert frame[("upper", "z")].tolist() == [row[2] for row in told["upper"]]


def test_blades_are_a_row_each_over_every_page(twin: Client) -> None:
    frame = twin.blades_frame("r1", time_h=2e4)
    listed = list(twin.blades("r1", time_h=2e4))
    assert frame.index.tolist() == ["B1", "B2", "B3"]
    assert len(frame) > PAGE
    assert frame["mean"].tolist() == [one["prediction"]["mean"] for one in listed]
    assert frame["sd"].tolist() == [one["prediction"]["sd"]["total"] for one in listed]
    assert frame["sd_blade"].tolist() == [one["prediction"]["sd"]["blade"] for one in listed]
    assert frame["counting"].tolist() == [3, 3, 0]
    assert frame["overruled"].tolist() == [1, 1, 0]
    assert frame["slot"].tolist()[:2] == ["2", "1"]
    assert pandas.isna(frame.loc["B3", "slot"])
    assert frame.loc["B2", "last_id"] == "strain"
    assert frame.loc["B1", "installed_at"] == pandas.Timestamp("2030-01-01T00:00:00Z")
    assert (frame.attrs["unit"], frame.attrs["time_h"]) == ("mm", 2e4)
    vector = twin.blades_frame("r1", quantity="deformation", node=6447)
    told = next(twin.blades("r1", quantity="deformation", node=6447))
    assert vector.loc["B1", ["sd_x", "sd_y", "sd_z"]].tolist() == told["prediction"]["sd"]["total"]
    assert "mean" not in vector


def test_known_inputs_of_blades_are_columns(twin: Client) -> None:
    items = list(twin.blades("r1"))
    items[1]["known"] = {"stress": 150.0}
    head = {"rotor": "r1", "unit": "mm", "time_h": 5e4, "next": None}
    frame = framed.blades(head | {"items": items})
    assert frame.loc["B2", "known_stress"] == 150.0
    assert frame["known_stress"].isna().tolist() == [True, False, True]
    assert frame.attrs == {"rotor": "r1", "unit": "mm", "time_h": 5e4}


def test_residuals_are_a_row_each_over_every_page_with_their_tests(twin: Client) -> None:
    while (frame := twin.residuals_frame("r1")).attrs["pending"]:
        time.sleep(0.02)
    listed: list[Json] = []
    cursor: dict[str, str] = {}
    while True:
        page = twin.residuals("r1", **cursor)
        listed += page["items"]
        if page["next"] is None:
            break
        cursor = {"cursor": page["next"]}
    assert len(frame) == len(listed) > PAGE
    for name in ("inspection", "blade", "y", "mean", "sd", "z", "pit", "time_h", "visit"):
        assert frame[name].tolist() == [one[name] for one in listed], name
    assert frame.attrs["tests"] == page["tests"]
    assert frame.attrs["as_of"] == page["as_of"]
    own = twin.residuals_frame("r1", blade="B1", campaign="c2")
    assert own["inspection"].tolist() == ["b1"]
    none = twin.residuals_frame("r1", quantity="ceeq")
    assert (len(none), list(none.columns)) == (0, list(frame.columns))


def test_joint_draws_share_what_is_shared(twin: Client) -> None:
    frame = twin.draws_frame("r1", count=50)
    told = twin.draws("r1", count=50)
    assert frame.index.names == ["draw", "blade"]
    assert len(frame) == 50 * 3
    assert list(frame.columns) == ["rate", "offset"]
    offsets = frame["offset"].unstack("blade")[told["blades"]].to_numpy()
    assert offsets.tolist() == np.array(told["local"]["values"])[:, :, 0].tolist()
    rates = frame["rate"].unstack("blade")
    assert rates["B3"].tolist() == [row[0] for row in told["shared"]["values"]]
    assert (rates.nunique(axis="columns") == 1).all()
    assert frame.attrs["units"] == {"rate": "mm", "offset": "mm"}
    assert frame.attrs["level"] == {"rate": "shared", "offset": "local"}
    assert frame.attrs["rests_on"] == told["rests_on"]
    assert frame.attrs["health"] == told["health"]


def test_draws_of_a_blade_are_a_column_for_each_parameter(twin: Client) -> None:
    frame = twin.draws_frame("r1", "B1", count=40)
    told = twin.draws("r1", "B1", count=40)
    assert frame.index.name == "draw"
    assert frame[told["names"]].to_numpy().tolist() == told["values"]


def test_a_field_is_a_data_set_that_netcdf_takes(twin: Client, tmp_path: Path) -> None:
    found = twin.field_xarray("r1", "B1", "deformation", times=HOURS)
    series = twin.field_series("r1", "B1", "deformation", times=HOURS)
    assert dict(found.sizes) == {"time_h": 3, "node": 6448, "axis": 3}
    assert np.array_equal(found["mean"], series["mean"])
    assert np.array_equal(found["sd"], series["sd"])
    assert found["mean"].attrs["units"] == series["unit"] == "mm"
    assert found["time_h"].attrs["units"] == "h"
    assert found.attrs["blade"] == "B1"
    assert found.attrs["version"] == series["facts"]["version"]
    found.to_netcdf(tmp_path / "field.nc")
    with xarray.open_dataset(tmp_path / "field.nc") as again:
        assert again.equals(found)
    strain = twin.field_xarray("r1", "B1", "ceeq", times=[8000.0])
    assert dict(strain.sizes) == {"time_h": 1, "node": 6448}
    told = twin.field("r1", "B1", "ceeq", time_h=8000.0)
    assert strain["mean"].sel(time_h=8000.0, node=6447).item() == pytest.approx(
        told["mean"][-1], rel=1e-6
    )


async def _told() -> tuple[Any, Any]:
    async with in_memory_async() as twin:
        await twin.create_rotor("r1", blades=["B1", "B2"])
        await twin.wait_for("r1", await twin.post_csv("r1", CSV))
        return await twin.readings_frame("r1"), await twin.prediction_frame("r1", "B2")


def test_both_clients_have_them() -> None:
    readings, prediction = asyncio.run(_told())
    assert readings["id"].tolist() == ["a1", "a2", "b1", "b2"]
    assert prediction.attrs["blade"] == "B2"


def test_pages_of_two_versions_are_read_anew_and_not_mixed() -> None:
    def page(version: int, item: int, further: str | None) -> httpx.Response:
        body = {"items": [item], "next": further, "rests_on": {"version": version}}
        return httpx.Response(200, json=body, request=httpx.Request("GET", "http://x"))

    first = Call("GET", "/v1/rotors/r1/blades", {"quantity": "ceeq"})
    walk = Walk(collected(first))
    assert walk.go() == first
    second = walk.go(page(1, 10, "c1"))
    assert second == Call("GET", first.path, {"quantity": "ceeq", "cursor": "c1"})
    assert walk.go(page(2, 20, None)) == first, "from the beginning"
    assert walk.go(page(2, 10, "c1")) == second
    assert walk.go(page(2, 20, None)) is None
    assert walk.value["items"] == [10, 20]

    restless = Walk(collected(first))
    restless.go()

    def on() -> None:
        for version in range(1, 100):
            restless.go(page(version, 10, "c1"))

    with pytest.raises(BladetwinError, match="changed 10 times"):
        on()


def test_the_client_loads_neither_pandas_nor_matplotlib_before_they_are_needed() -> None:
    asked = "import json, sys, service.client; print(json.dumps(sorted(sys.modules)))"
    told = subprocess.run([sys.executable, "-c", asked], capture_output=True, check=True, text=True)
    loaded = set(json.loads(told.stdout))
    assert "service.client.frames" in loaded
    assert loaded.isdisjoint({"pandas", "xarray", "matplotlib", "arviz", "fastapi", "sqlalchemy"})


def test_rows_of_a_frame_are_posted_as_they_are(tmp_path: Path) -> None:
    """Numbers of numpy, moments of pandas; what is missing is refused by field and row."""
    frame = pandas.DataFrame({
        "id": ["a", "b"], "blade": "B1", "quantity": "elongation", "time_h": np.array([8000, 9000]),
        "value": [0.11, 0.12], "observed_at": pandas.to_datetime(["2031-05-04T10:00:00Z"] * 2),
    })  # fmt: skip
    (tmp_path / "more.csv").write_text("id,blade,quantity,time_h,value\nc,B1,elongation,9500,0.2\n")
    with in_memory() as twin:
        twin.create_rotor("r1", blades=["B1"])
        rows = [frame.loc[i].to_dict() | {"time_h": frame["time_h"][i]} for i in frame.index]
        assert isinstance(rows[0]["time_h"], np.integer)
        assert twin.post_inspections("r1", rows) == 2
        assert twin.inspection("r1", "b")["observed_at"] == "2031-05-04T10:00:00+00:00"
        assert twin.post_csv("r1", tmp_path / "more.csv") == 3
        with pytest.raises(ProblemError, match=r"inspections\[1\].value = 'NaN'"):
            twin.post_inspections("r1", [rows[0], rows[1] | {"id": "n", "value": np.nan}])
        with pytest.raises(TypeError, match="is no value of a reading"):
            twin.post_inspections("r1", [rows[0] | {"value": object()}])
