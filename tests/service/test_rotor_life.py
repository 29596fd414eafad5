"""Which blades of a rotor pass a limit, over HTTP: the twin's exact answer, and the real one's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from core.calibration.state import blade_posterior
from core.life import life
from core.model import rotor_blade
from core.observation import Inspection
from core.rotor_life import rotor_life
from service.api.scopes import RULES
from service.bootstrap import make_worker
from service.client import Client
from service.fake import FakeScience
from service.handlers import life as use
from service.handlers.inspections import Item, post_inspections
from service.handlers.life import along_question
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
URL = "/v1/rotors/r1/life"


@pytest.fixture
def read(rotor: str, post: Post, reading: Reading, worker: Worker) -> str:
    post(rotor, reading("i1"), reading("i2", blade="B2", time_h=9000.0))
    worker.drain()
    return rotor


def ask(api: httpx.Client, **asked: object) -> Json:
    answer = api.get(URL, params={"limit": 0.5} | asked)  # type: ignore[arg-type]
    assert answer.status_code == 200, answer.text
    body: Json = answer.json()
    return body


def test_each_blade_s_chance_is_that_of_its_own_route(api: httpx.Client, read: str) -> None:
    body = ask(api)
    assert (body["rotor"], body["quantity"], body["unit"], body["limit"]) == (
        "r1", "elongation", "mm", 0.5,
    )  # fmt: skip
    assert [one["id"] for one in body["blades"]] == ["B1", "B2", "B3"]
    for one in body["blades"]:
        own = api.get(f"/v1/rotors/r1/blades/{one['id']}/life?limit=0.5").json()
        assert one["passed"] == own["passed"]
        assert one["held_from_h"] == own["held_from_h"]
        for name in ("time_h", "node", "component", "health", "rests_on"):
            assert body[name] == own[name], name
    whole = np.array([one["passed"] for one in body["blades"]])
    assert body["expected"] == pytest.approx(whole.sum(axis=0))
    assert np.all(np.diff(body["any"]) >= -1e-15)


def test_any_is_that_of_the_joint_normal(api: httpx.Client, read: str, store: SqlStore) -> None:
    """r_b = m + l_b: blades know of each other by m, and independent ones would be told more."""
    hour, limit = 40_000.0, 0.5
    body = ask(api, limit=limit, times=f"{hour}")
    rates = [api.get(f"/v1/rotors/r1/blades/{b}/prediction?times=50000").json() for b in
             ("B1", "B2", "B3")]  # fmt: skip
    mean = np.array([one["mean"][0] for one in rates])
    sd = np.array([one["sd"]["parameters"][0] for one in rates])
    state = basis(store, FakeScience(), "r1", Which()).state
    with store.read() as tx:
        get = tx.states.reader(state)
        variance = get("shared/moments")[1]
        counts = [get(f"column/{b}")[0] for b in ("B1", "B2", "B3")]
    slope = np.array([1.0 - n * 0.2**2 / (1.0 + n * 0.2**2) for n in counts])  # of r_b with m
    cov = variance * np.outer(slope, slope)
    cov[np.diag_indices(3)] = sd**2
    needed = limit * 50_000 / hour
    none = multivariate_normal(mean, cov, seed=1, abseps=1e-9).cdf(np.full(3, needed))
    assert body["any"][0] == pytest.approx(1.0 - none, abs=1e-5)
    passed = np.array([one["passed"][0] for one in body["blades"]])
    alone = 1.0 - np.prod(1.0 - passed)
    assert 0.05 < body["any"][0] < 0.95
    assert abs(alone - body["any"][0]) > 1e-3, "negative control"


def test_only_blades_that_run_in_the_version_count(
    api: httpx.Client, read: str, worker: Worker
) -> None:
    before = ask(api, times="40000")
    version = before["rests_on"]["version"]
    assert api.post("/v1/rotors/r1/blades", json={"id": "A9"}).status_code == 202
    assert ask(api, times="40000") == before, "it is in no version yet"
    assert api.post("/v1/rotors/r1/blades/B3/retirement").status_code == 202
    worker.drain()
    after = ask(api, times="40000")
    assert [one["id"] for one in after["blades"]] == ["A9", "B1", "B2"]
    assert after["expected"][0] == pytest.approx(sum(one["passed"][0] for one in after["blades"]))
    assert ask(api, times="40000", version=version) == before
    for blade in ("A9", "B1", "B2"):
        api.post(f"/v1/rotors/r1/blades/{blade}/retirement")
    worker.drain()
    nobody = ask(api, times="40000")
    assert (nobody["any"], nobody["expected"], nobody["blades"]) == ([0.0], [0.0], [])


def test_an_answer_has_an_etag_and_is_the_version_s(api: httpx.Client, read: str) -> None:
    first = api.get(f"{URL}?limit=0.3")
    tag = {"If-None-Match": first.headers["etag"]}
    assert api.get(f"{URL}?limit=0.3", headers=tag).status_code == 304
    assert api.get(f"{URL}?limit=0.31", headers=tag).status_code == 200
    named = first.json()["rests_on"]["version"]
    assert api.get(f"{URL}?limit=0.3&version={named}").json() == first.json()
    refuse(api.get(f"{URL}?limit=0.3&version=9"), 404)
    refuse(api.get("/v1/rotors/r9/life?limit=0.3"), 404, "rotor")
    assert RULES["GET /v1/rotors/{r}/life"].scope == "read"


@pytest.mark.parametrize(
    ("query", "field"),
    [
        ("", "limit"),
        ("limit=nan", "limit"),
        ("limit=1e309", "limit"),
        ("limit=0.3&quantity=colour", "quantity"),
        ("limit=0.3&component=x", "component"),
        ("limit=0.3&times=60000", "times"),
        ("limit=0.3&times=", "times"),
        ("limit=0.3&node=tip", "node"),
        ("limit=0.3&blade=B1", "blade"),
        ("limit=0.3&times=8000&ahead=8000", "ahead"),
        ("limit=0.3&ahead=8,000", "ahead"),
        ("limit=0.3&ahead=60000", "times"),
        ("limit=0.3&ahead=41001", "ahead"),
    ],
)
def test_what_cannot_be_asked_is_refused(
    api: httpx.Client, read: str, query: str, field: str
) -> None:
    refuse(api.get(f"{URL}?{query}"), 422, field)


def test_hours_of_all_blades_are_bounded_but_never_the_model_s_own(
    api: httpx.Client, read: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = len(ask(api)["time_h"])
    monkeypatch.setattr(use, "MOST_CHANCES", 3 * (own + 1))
    hours = ",".join(str(1000 + k) for k in range(own + 2))
    told = refuse(api.get(URL, params={"limit": 0.3, "times": hours}), 422, "times")
    assert f"1 … {own + 1} times" in told["faults"][0]["remedy"]
    assert len(ask(api, times=hours.rpartition(",")[0])["any"]) == own + 1
    monkeypatch.setattr(use, "MOST_CHANCES", 1)
    assert len(ask(api, limit=0.31)["time_h"]) == own, "not a kept one"


def test_a_direction_of_a_vector_has_chances_of_its_own(api: httpx.Client, read: str) -> None:
    found = {
        axis: ask(api, limit=0.01, quantity="deformation", **component)
        for axis, component in (("x", {"component": "x"}), ("z", {}))
    }
    assert found["z"]["component"] == "z"
    assert found["z"]["any"][-1] > 0.9
    assert (found["x"]["any"][-1], found["x"]["expected"][-1]) == (0.0, 0.0)


def test_an_outage_is_another_hour_of_blades_of_other_ages(
    api: httpx.Client, rotor: str, post: Post, reading: Reading, worker: Worker
) -> None:
    """B2 came 10,000 h after B1, B3 was never read."""
    post(
        rotor,
        reading("a", time_h=20_000.0, campaign="c1"),
        reading("b", blade="B2", time_h=10_000.0, campaign="c1"),
        reading("c", time_h=24_000.0, campaign="c2"),
    )
    worker.drain()
    body = ask(api, ahead="0,8000")
    ages = {"B1": (24_000.0, "campaign"), "B2": (14_000.0, "campaign"), "B3": (24_000.0, "rotor")}
    assert (body["ahead"], body["time_h"]) == (True, [0.0, 8000.0])
    assert {one["id"]: (one["age_h"], one["age_by"]) for one in body["blades"]} == ages
    for one in body["blades"]:
        hours = f"{one['age_h']},{one['age_h'] + 8000}"
        own = api.get(f"/v1/rotors/r1/blades/{one['id']}/life?limit=0.5&times={hours}").json()
        assert one["passed"] == pytest.approx(own["passed"], abs=1e-12)
    same = ask(api, times="32000")
    assert (same["ahead"], {one["age_h"] for one in same["blades"]}) == (False, {None})
    assert same["any"][0] > body["any"][1], "negative control: B2 would be 32,000 h old"
    told = refuse(api.get(f"{URL}?limit=0.5&ahead=26001"), 422, "ahead")["faults"][0]
    assert told["problem"] == "is hour 50001 of blade B1; the model ends at 50000 h"
    assert told["remedy"] == "ask for 26000 h ahead at most"
    before = body["rests_on"]["version"]
    post(rotor, reading("d", blade="B2", time_h=16_000.0))
    worker.drain()
    assert [one["age_h"] for one in ask(api, ahead="0")["blades"]] == [26_000.0, 16_000.0, 26_000.0]
    assert ask(api, ahead="0,8000", version=before) == body, "as of the version"


def test_the_client_asks_for_it(api: httpx.Client, read: str) -> None:
    told = Client(http=api).rotor_life("r1", 0.3, "elongation", times=[8000, 50_000])
    assert told == api.get(f"{URL}?limit=0.3&quantity=elongation&times=8000.0,50000.0").json()
    told = Client(http=api).rotor_life("r1", 0.3, ahead=[8000])
    assert told == api.get(f"{URL}?limit=0.3&ahead=8000.0").json()


def test_the_real_science_says_which(settings: Settings, reading: Reading) -> None:
    """Against `core.rotor_life`, and blade by blade `core.life`, on the state that was sealed."""
    science = CoreScience()
    store = SqlStore(open_engine(settings.database_url))
    register_builtins(store, science)
    create_rotor(store, "r1", "rotor-blade", [BladeRecord("B2"), BladeRecord("B1")], 400, 7)
    post_inspections(store, "r1", [Item("", reading("i1"))])
    make_worker(store, science, settings, "w").drain()
    found = basis(store, science, "r1", Which())
    asked, part = along_question(found.card, None, None, None, None)
    told = use.rotor_life(store, science, found, asked, part, 0.3)
    later, _ = along_question(found.card, None, [0.0, 42_000.0], None, None)
    ahead = use.rotor_life(store, science, found, later, part, 0.3, True)
    with store.read() as tx:
        get = tx.states.reader(found.state)
        names = ("B1", "B2")
        own = [blade_posterior(found.state.meta, get, blade) for blade in names]
        state = science.restore(found.state.meta, get)
        whole = rotor_life(rotor_blade(), state, names, "elongation", 0.3, asked.times)
    store.close()
    assert (told["any"], told["expected"]) == (whole.any.tolist(), whole.expected.tolist())
    assert [one["id"] for one in told["blades"]] == ["B1", "B2"]
    for one, particles in zip(told["blades"], own, strict=True):
        alone = life(rotor_blade(), particles, "elongation", 0.3, asked.times)
        assert one["passed"] == pytest.approx(alone.passed, abs=1e-12)
    assert told["time_h"] == sorted(asked.times)
    at = told["time_h"].index(50_000.0)
    assert ahead["time_h"] == [0.0, 42_000.0]
    assert ahead["any"][1] == pytest.approx(told["any"][at], abs=1e-12)
    assert {(one["age_h"], one["age_by"]) for one in ahead["blades"]} == {
        (8000.0, "reading"),
        (8000.0, "rotor"),
    }
    assert 0.0 < told["blades"][1]["passed"][-1] < told["any"][-1] < told["expected"][-1]
