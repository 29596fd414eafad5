"""Time to a limit, rows for dashboards and the posterior as a file: routes that others rely on."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import h5netcdf
import httpx
import numpy as np
import pytest
from scipy.special import ndtr

from core.calibration.state import blade_posterior
from core.life import life
from core.model import rotor_blade
from core.observation import Inspection
from core.prediction import QUANTILES
from service.bootstrap import make_worker
from service.client import Client
from service.handlers.inspections import Item, post_inspections
from service.handlers.life import along_question
from service.handlers.life import life as told_life
from service.handlers.models import register_builtins
from service.handlers.reads import basis
from service.handlers.rotors import create_rotor
from service.ports import BladeRecord, Which
from service.science import CoreScience
from service.settings import Settings
from service.store.engine import open_engine
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker
from tests.service.test_api import refuse

Json = dict[str, Any]
Post = Callable[..., int]
Reading = Callable[..., Inspection]
BLADE = "/v1/rotors/r1/blades/B1"


@pytest.fixture
def read(rotor: str, post: Post, reading: Reading, worker: Worker) -> str:
    post(rotor, reading("i1"), reading("i2", blade="B2", time_h=9000.0))
    worker.drain()
    return rotor


# --- life -----------------------------------------------------------------------------------------


def test_the_time_to_a_limit_is_the_exact_one(api: httpx.Client, read: str) -> None:
    """y = r h with r normal: r from the band's mean and sd of its parameters at 50,000 h."""
    at_end = api.get(f"{BLADE}/prediction?times=50000").json()
    rate, sd = at_end["mean"][0], at_end["sd"]["parameters"][0]
    hours = np.array([0.0, 10_000.0, 30_000.0, 50_000.0])
    asked = {"limit": 0.5, "times": ",".join(map(str, hours))}
    body = api.get(f"{BLADE}/life", params=asked).json()
    assert "quantity" in body, body
    assert (body["quantity"], body["unit"], body["limit"]) == ("elongation", "mm", 0.5)
    h = hours[1:] / 50_000
    assert body["passed"][0] == 0.0
    assert body["passed"][1:] == pytest.approx(ndtr((rate * h - 0.5) / (sd * h)), abs=1e-12)
    half = 50_000 * 0.5 / rate
    told = body["quantiles"]["0.5"]
    assert (told is None) == (half > 50_000)
    if told is not None:
        assert told == pytest.approx(half, rel=1e-9)
    assert [*map(float, body["quantiles"])] == [*QUANTILES], "as of the real science"
    known = [hour for hour in body["quantiles"].values() if hour is not None]
    assert known == sorted(known)
    assert body["rests_on"]["version"] == 1
    assert body["health"]["trusted"]


def test_a_limit_may_be_any_number(api: httpx.Client, read: str) -> None:
    told = {
        limit: api.get(f"{BLADE}/life", params={"limit": limit, "times": "0,50000"}).json()
        for limit in ("1e308", "-1e308", "1e-320", "-1e-320")
    }
    passed = {limit: body["passed"] for limit, body in told.items()}
    assert passed["-1e308"] == passed["-1e-320"] == [1.0, 1.0]
    assert passed["1e308"] == [0.0, 0.0]
    assert passed["1e-320"] == [0.0, pytest.approx(1.0)]
    refuse(api.get(f"{BLADE}/life?limit=1e309"), 422, "limit")


def test_an_answer_has_an_etag_and_is_not_sent_twice(api: httpx.Client, read: str) -> None:
    first = api.get(f"{BLADE}/life?limit=0.3")
    tag = {"If-None-Match": first.headers["etag"]}
    assert api.get(f"{BLADE}/life?limit=0.3", headers=tag).status_code == 304
    assert api.get(f"{BLADE}/life?limit=0.31", headers=tag).status_code == 200


@pytest.mark.parametrize(
    ("query", "field"),
    [
        ("", "limit"),
        ("limit=high", "limit"),
        ("limit=nan", "limit"),
        ("limit=0.3&quantity=colour", "quantity"),
        ("limit=0.3&component=x", "component"),
        ("limit=0.3&quantity=deformation&component=w", "component"),
        ("limit=0.3&times=60000", "times"),
        ("limit=0.3&node=tip", "node"),
        ("limit=0.3&probability=0.9", "probability"),
    ],
)
def test_what_cannot_be_asked_is_refused(
    api: httpx.Client, read: str, query: str, field: str
) -> None:
    refuse(api.get(f"{BLADE}/life?{query}"), 422, field)


def test_all_faults_of_a_question_are_told(api: httpx.Client, read: str) -> None:
    body = refuse(api.get(f"{BLADE}/life?limit=0.3&component=x&times=60000"), 422)
    assert [one["field"] for one in body["faults"]] == ["times", "component"]


def test_a_direction_of_a_vector_has_a_life_of_its_own(api: httpx.Client, read: str) -> None:
    """The twin's deformation is along the radius alone: z passes, x never does."""
    found = {
        axis: api.get(
            f"{BLADE}/life", params={"limit": 0.01, "quantity": "deformation", "component": axis}
        ).json()
        for axis in "xz"
    }
    assert found["z"]["component"] == "z"
    assert found["z"]["passed"][-1] > 0.5
    assert found["x"]["passed"][-1] == 0.0
    assert set(found["x"]["quantiles"].values()) == {None}
    plain = api.get(f"{BLADE}/life?limit=0.01&quantity=deformation").json()
    assert plain["component"] == "z"
    assert plain["passed"] == found["z"]["passed"]


def test_the_client_asks_for_it(api: httpx.Client, read: str) -> None:
    twin = Client(http=api)
    told = twin.life("r1", "B1", 0.3, times=[8000, 50_000])
    assert told == api.get(f"{BLADE}/life?limit=0.3&times=8000.0,50000.0").json()


def test_the_real_science_says_when(settings: Settings, reading: Reading) -> None:
    """Against `core.life` on the state that the worker sealed."""
    science = CoreScience()
    store = SqlStore(open_engine(settings.database_url))
    register_builtins(store, science)
    create_rotor(store, "r1", "rotor-blade", [BladeRecord("B1")], 400, 7)
    post_inspections(store, "r1", [Item("", reading("i1"))])
    make_worker(store, science, settings, "w").drain()
    found = basis(store, science, "r1", Which(), "B1")
    asked, part = along_question(found.card, None, None, None, None)
    told = told_life(store, science, found, asked, part, 0.3)
    one, two = asked.times[-9], asked.times[-2]
    late = [
        told_life(store, science, found, replace(asked, times=hours), part, 0.3)
        for hours in ((one, two), (two, one, two), (two,))
    ]
    with store.read() as tx:
        own = blade_posterior(found.state.meta, tx.states.reader(found.state), "B1")
    store.close()
    alone = life(rotor_blade(), own, "elongation", 0.3, asked.times)
    assert told["passed"] == alone.passed.tolist()
    assert told["quantiles"] == {str(p): hour for p, hour in alone.quantiles.items()}
    assert 0.0 < alone.passed[-1] < 1.0
    for some, hours in zip(late, ([one, two], [one, two], [two]), strict=True):
        assert some["time_h"] == hours
        at = [list(alone.time_h).index(hour) for hour in hours]
        assert some["passed"] == pytest.approx(alone.passed[at], abs=1e-12)
        assert some["quantiles"] == told["quantiles"], "in all hours, whichever are asked for"


# --- rows -----------------------------------------------------------------------------------------


def test_rows_are_the_bands_of_each_blade(api: httpx.Client, read: str) -> None:
    body = api.get("/v1/rotors/r1/series?times=8000,50000&probability=0.9").json()
    assert [(row["blade"], row["time"]) for row in body["items"]] == [
        (blade, hour) for blade in ("B1", "B2", "B3") for hour in (8000, 50_000)
    ]
    assert body["next"] is None
    for row in body["items"]:
        path = f"/v1/rotors/r1/blades/{row['blade']}/prediction"
        bands = api.get(path, params={"times": row["time"], "probability": 0.9}).json()
        told = {name: bands[name][0] for name in ("lower", "upper")} | {"value": bands["mean"][0]}
        assert {name: row[name] for name in told} == told


def test_rows_come_by_pages_of_blades_or_of_one_blade(api: httpx.Client, read: str) -> None:
    first = api.get("/v1/rotors/r1/series?times=8000&limit=2").json()
    assert ([row["blade"] for row in first["items"]], first["next"]) == (["B1", "B2"], "B2")
    last = api.get("/v1/rotors/r1/series?times=8000&limit=2&cursor=B2").json()
    assert ([row["blade"] for row in last["items"]], last["next"]) == (["B3"], None)
    one = api.get("/v1/rotors/r1/series?times=8000&blade=B2").json()
    assert one["items"] == first["items"][1:]
    assert [row["blade"] for row in Client(http=api).series("r1", times=[8000])] == [
        *("B1", "B2", "B3")
    ]
    refuse(api.get("/v1/rotors/r1/series?blade=B9"), 404, "blade")
    refuse(api.get("/v1/rotors/r1/series?limit=0"), 422, "limit")


def test_rows_of_a_vector_are_of_one_direction(api: httpx.Client, read: str) -> None:
    path = "/v1/rotors/r1/series?times=50000&blade=B1&quantity=deformation"
    radius, x = api.get(path).json(), api.get(f"{path}&component=x").json()
    assert (radius["component"], x["component"]) == ("z", "x")
    assert radius["items"][0]["value"] > 0.0 == x["items"][0]["value"]


# --- the posterior as a file ----------------------------------------------------------------------


@pytest.mark.parametrize("path", ["/v1/rotors/r1", BLADE])
def test_the_posterior_as_netcdf_is_the_file_of_its_draws(
    api: httpx.Client, read: str, path: str
) -> None:
    answer = api.get(f"{path}/posterior?format=netcdf")
    assert answer.headers["content-type"] == "application/x-netcdf"
    same = api.get(f"{path}/draws?format=netcdf&count=1000")
    with (
        h5netcdf.File(io.BytesIO(answer.content)) as one,
        h5netcdf.File(io.BytesIO(same.content)) as other,
    ):
        assert set(one.groups) == set(other.groups) >= {"posterior"}
        for name in one["posterior"].variables:
            ours, theirs = (f["posterior"].variables[name][...] for f in (one, other))
            assert np.array_equal(ours, theirs)
    refuse(api.get(f"{path}/posterior?format=xml"), 422, "format")
