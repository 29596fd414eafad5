"""Which inspection next, over HTTP: with the exact twin, and once with the real science."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import httpx
import numpy as np
import pytest

from core.observation import Inspection
from service.bootstrap import make_worker
from service.client import Client, ProblemError
from service.fake import SCATTER, SD, SIGMA
from service.handlers.inspections import post_inspections
from service.handlers.models import register_builtins
from service.handlers.plans import plan, runs, target_of
from service.handlers.reads import basis
from service.handlers.rotors import create_rotor
from service.ports import BladeRecord, Which
from service.settings import Settings
from service.store.engine import open_engine
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker
from tests.service.smooth import formula_science
from tests.service.test_diagnoses import straight
from tests.service.test_effects import visits

__all__ = ["straight"]
Make = Callable[..., Inspection]


@pytest.fixture
def known(straight: str, worker: Worker) -> str:
    """A rotor of three blades, read at 8,000, 16,000 and 24,000 h, with its posterior."""
    worker.drain()
    return straight


def test_a_blades_own_reading_narrows_it_most_by_the_exact_share(
    api: httpx.Client, known: str
) -> None:
    got = Client(http=api).plan("r1", blade="B2", time_h=50_000.0)
    assert got["target"]["blade"] == "B2"
    assert got["single"][0]["blade"] == "B2"
    # The blade's rate: its prior, what the others tell of it, three readings; then one at 24,000 h.
    h2 = np.array([0.16, 0.32, 0.48]) ** 2
    others = 2 / (SCATTER**2 + SIGMA**2 / h2.sum()) + 1 / SD**2
    prior = SCATTER**2 + 1 / others
    now = 1 / (1 / prior + h2.sum() / SIGMA**2)
    left = 1 / (1 / now + h2[-1] / SIGMA**2)
    assert got["target"]["sd"] == pytest.approx(np.sqrt(now), rel=1e-6)
    assert got["single"][0]["sd_after"] == pytest.approx(np.sqrt(left), rel=1e-6)
    assert got["single"][0]["narrower"] == pytest.approx(1 - np.sqrt(left / now), rel=1e-6)
    assert got["single"][-1]["narrower"] < 0.02, "the control: another blade's"


def test_instruments_that_make_no_difference_do_not_fill_the_list(settings: Settings) -> None:
    """Read by two instruments under one noise: each reading to come is told once, by whomever."""
    science = formula_science()
    store = SqlStore(open_engine(settings.database_url))
    register_builtins(store, science)
    create_rotor(store, "r1", "rotor-blade", [BladeRecord(f"B{b}") for b in range(6)], 400, 7)
    items = [
        replace(item, reading=replace(item.reading, instrument=f"g{n % 2}"))
        for n, item in enumerate(visits(0.0))
    ]
    post_inspections(store, "r1", items)
    make_worker(store, science, settings, "w").drain()
    found = basis(store, science, "r1", Which(), "B2")
    got = plan(store, science, found, target_of(found, "elongation", 50_000.0, None), 2)
    store.close()
    named = [(one["blade"], one["quantity"], one["time_h"]) for one in got["single"]]
    assert len(set(named)) == len(named)
    assert {one["instrument"] for one in (*got["single"], *got["set"])} == {None}


def test_a_shared_parameter_is_the_target_where_none_is_named(
    api: httpx.Client, known: str
) -> None:
    plain = api.get("/v1/rotors/r1/plan")
    assert plain.status_code == 200, plain.text
    assert plain.json()["target"]["parameter"] == "rate"
    assert plain.json()["rests_on"]["version"] == 1
    again = api.get("/v1/rotors/r1/plan", headers={"If-None-Match": plain.headers["etag"]})
    assert again.status_code == 304
    own = api.get("/v1/rotors/r1/plan", params={"parameter": "offset", "blade": "B1"}).json()
    assert own["target"]["blade"] == "B1"


@pytest.mark.parametrize(
    ("asked", "status", "said"),
    [
        ({"parameter": "colour"}, 422, "is not calibrated"),
        ({"parameter": "offset"}, 422, "name a blade"),
        ({"parameter": "rate", "time_h": 5e4}, 422, "give one of the two"),
        ({"quantity": "elongation"}, 422, "name a blade"),
        ({"blade": "B1", "time_h": 9e4}, 422, "0 … 50000 h"),
        ({"blade": "B1", "time_h": "nan"}, 422, "hours inside"),
        ({"blade": "B1", "quantity": "deformation"}, 422, "three components"),
        ({"blade": "B1", "quantity": "colour"}, 422, "is not predicted"),
        ({"blade": "B9"}, 404, "B9"),
        ({"count": 9}, 422, "count"),
    ],
)
def test_what_cannot_be_planned_for_is_refused_by_name(
    api: httpx.Client, known: str, asked: dict[str, Any], status: int, said: str
) -> None:
    answer = api.get("/v1/rotors/r1/plan", params=asked)
    assert answer.status_code == status, answer.text
    assert said in answer.text


def test_a_rotor_without_a_posterior_has_no_plan_yet(api: httpx.Client, rotor: str) -> None:
    with pytest.raises(ProblemError) as refused:
        Client(http=api).plan("r1", blade="B1")
    assert refused.value.status == 409


def test_blades_that_left_or_came_later_are_not_inspected() -> None:
    assert runs(BladeRecord("a"), 5)
    assert runs(BladeRecord("a", retired_seq=6), 5)
    assert not runs(BladeRecord("a", retired_seq=5), 5)
    assert not runs(BladeRecord("a", added_seq=6), 5)


def test_the_real_science_plans_for_a_blades_last_hour(settings: Settings) -> None:
    """The blade's own late readings narrow its elongation at 50,000 h; now and others' do less."""
    science = formula_science()
    store = SqlStore(open_engine(settings.database_url))
    register_builtins(store, science)
    create_rotor(store, "r1", "rotor-blade", [BladeRecord(f"B{b}") for b in range(6)], 400, 7)
    post_inspections(store, "r1", visits(0.0))
    make_worker(store, science, settings, "w").drain()
    found = basis(store, science, "r1", Which(), "B2")
    got = plan(store, science, found, target_of(found, "elongation", 50_000.0, None), 2)
    store.close()
    best, worst = got["single"][0], got["single"][-1]
    assert (best["blade"], best["ahead_h"]) == ("B2", 16_000.0)
    assert best["sigma"] == pytest.approx(0.004)
    assert best["sd_after"] < 0.7 * got["target"]["sd"]
    assert worst["blade"] != "B2"
    assert got["set"][1]["sd_after"] < got["set"][0]["sd_after"] == best["sd_after"]
    assert got["target"]["unit"] == "mm"


def test_what_an_effect_adds_is_planned_for_in_the_unit_of_the_readings(settings: Settings) -> None:
    """0.039 of "1" was told of an offset of 0.039 mm."""
    science = formula_science()
    store = SqlStore(open_engine(settings.database_url))
    register_builtins(store, science)
    prior = {"kind": "normal", "low": -0.1, "high": 0.1, "mean": 0.0, "sd": 0.05}
    size = {"name": "zero", "level": "shared", "prior": prior}
    bias = {"name": "zero", "quantity": "elongation", "shape": [[0.0, 1.0]], "campaign": "v1"}
    network = {"effects": {"parameters": [size], "drifts": [], "biases": [bias]}}
    blades = [BladeRecord(f"B{b}") for b in range(6)]
    create_rotor(store, "r1", "rotor-blade", blades, 400, 7, network=network)
    post_inspections(store, "r1", visits(0.0))
    make_worker(store, science, settings, "w").drain()
    found = basis(store, science, "r1", Which(), None)
    for name, unit in (("zero", "mm"), ("t1t_rate", "1")):
        got = plan(store, science, found, target_of(found, None, None, name), 1)
        assert got["target"]["unit"] == unit
    store.close()


def test_where_no_blade_runs_there_is_nothing_to_plan(
    api: httpx.Client, rotor: str, worker: Worker
) -> None:
    for name in ("B1", "B2", "B3"):
        assert api.post(f"/v1/rotors/r1/blades/{name}/retirement").status_code == 202
    worker.drain()
    told = api.get("/v1/rotors/r1/plan")
    assert told.status_code == 422, told.text
    assert "have all retired. To mend it: add a blade" in told.json()["detail"]
