"""A rotor whose residuals ask for diagnoses by themselves; with the exact twin."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import httpx
import numpy as np
import pytest
from sqlalchemy import ColumnElement, select, true, update

from core.observation import Inspection
from service.client import Client
from service.fake import HORIZON_H
from service.handlers.adoptions import back_out
from service.handlers.diagnoses import cancel_diagnosis, request_diagnosis
from service.handlers.inspections import retract
from service.handlers.rotors import create_rotor
from service.handlers.transfer_in import import_rotor
from service.handlers.transfer_out import export_rotor
from service.ports import Adopt, BladeRecord, Diagnose, JobRecord
from service.settings import Settings
from service.store import tables as t
from service.store.unit_of_work import SqlStore
from service.worker import asking
from service.worker.asking import Asking
from service.worker.loop import Worker
from service.worker.residuals import Residuals
from tests.patience import PATIENCE_S
from tests.service.adopting import Offsets

Make = Callable[..., Inspection]
Post = Callable[..., int]
NAME = "campaign offset (campaign c2)"
BLADES = tuple(f"B{k}" for k in range(1, 9))


@pytest.fixture
def science() -> Offsets:
    return Offsets()


def made(store: SqlStore, diagnose: Diagnose = "alarm", adopt: Adopt = "never") -> str:
    blades = [BladeRecord(name) for name in BLADES]
    create_rotor(store, "r1", "rotor-blade", blades, 64, 7, adopt=adopt, diagnose=diagnose)
    return "r1"


def visit(reading: Make, k: int, off: float = 0.0, campaign: str | None = None) -> list[Inspection]:
    """Every blade along its line at 4,000 h · k with noise; all of the visit may be off."""
    rng = np.random.default_rng([20310504, k])
    return [
        reading(
            f"{b}-{k}",
            blade=b,
            time_h=4e3 * k,
            value=(0.4 + 0.03 * i) * 4e3 * k / HORIZON_H + 0.02 * rng.normal() + off,
            campaign=campaign or f"c{k}",
        )
        for i, b in enumerate(BLADES)
    ]


def diagnoses(store: SqlStore) -> list[JobRecord]:
    """Those of the rotor, the oldest first."""
    with store.read() as tx:
        return tx.records.jobs_of("r1", "diagnose", None, 100)[::-1]


def alarms(store: SqlStore) -> int:
    with store.read() as tx:
        return tx.records.residuals("r1").alarms


def test_the_loop_closes_by_itself(
    api: httpx.Client, store: SqlStore, post: Post, reading: Make, follow: Callable[[], None]
) -> None:
    """Readings are posted, and nothing else is asked of the service."""
    twin = Client(http=api)
    twin.create_rotor("r1", blades=BLADES, particles=64, adopt="effect", diagnose="alarm")
    assert twin.rotor("r1")["diagnose"] == "alarm"
    post("r1", *visit(reading, 1))
    follow()
    assert (alarms(store), diagnoses(store)) == (0, [])
    post("r1", *visit(reading, 2, 0.2), *visit(reading, 3), *visit(reading, 4))
    follow()
    (one,) = twin.diagnoses("r1")
    assert (one["status"], one["verdict"], one["names"]) == ("done", "effect", [NAME])
    because = one["request"]["because"]
    assert because["version"] >= 2
    assert because["alarms"] >= len(because["tests"]) > 0
    assert {"grouping": "campaign", "value": "c2", "statistic": "mean"} in because["tests"]
    assert one["request"]["compare"] is True
    assert one["request"]["horizon_h"] == HORIZON_H
    (change,) = twin.adoptions("r1")
    assert (change["diagnosis"], change["unasked"]) == (one["id"], True)
    now = twin.rotor("r1")
    assert [effect["name"] for effect in now["effects"]] == [NAME]
    assert now["status"] == "current"
    assert alarms(store) == 0, "what alarmed is in the model"
    assert api.get("/v1/rotors/r1/residuals").json()["pending"] is False


def test_what_alarms_still_with_an_effect_in_the_model_is_asked_about_again(
    store: SqlStore, post: Post, reading: Make, follow: Callable[[], None]
) -> None:
    """Two campaigns are off: the larger is found and adopted, then the other."""
    made(store, "alarm", "effect")
    rest = [one for k in (1, 3, 5, 6) for one in visit(reading, k)]
    post("r1", *visit(reading, 2, 0.3), *visit(reading, 4, -0.2), *rest)
    for _ in range(2):
        follow()
    found = diagnoses(store)
    names = [(job.result or {}).get("names") for job in found]
    assert names[:2] == [[NAME], ["campaign offset (campaign c4)"]]
    assert alarms(store) == 0
    assert len(found) == 2


def test_a_rotor_may_ask_with_its_readings_though_nothing_alarms(
    store: SqlStore, post: Post, reading: Make, follow: Callable[[], None]
) -> None:
    made(store, "readings")
    post("r1", *visit(reading, 1), *visit(reading, 2))
    follow()
    assert alarms(store) == 0
    (first,) = diagnoses(store)
    assert first.status == "done"
    told = first.request["because"]
    assert (told["readings"], told["alarms"], told["tests"]) == (16, 0, [])
    post("r1", *visit(reading, 3)[:3])
    follow()
    assert len(diagnoses(store)) == 1, "19 readings of 16"
    post("r1", visit(reading, 3)[3])
    follow()
    assert [job.request["because"]["readings"] for job in diagnoses(store)] == [16, 20]


def test_a_rotor_without_readings_asks_nothing(
    store: SqlStore, post: Post, reading: Make, follow: Callable[[], None]
) -> None:
    made(store, "readings")
    post("r1", reading("a"))
    retract(store, "r1", "a")
    follow()
    assert diagnoses(store) == []


def test_it_is_asked_of_nobody_who_does_not_say_so(
    store: SqlStore, post: Post, reading: Make, follow: Callable[[], None]
) -> None:
    made(store, "never", "effect")
    post("r1", *visit(reading, 1), *visit(reading, 2, 0.2), *visit(reading, 3))
    follow()
    assert alarms(store) > 0
    assert diagnoses(store) == []


def test_it_is_asked_once_for_what_alarms_and_again_with_a_quarter_more_readings(
    store: SqlStore, post: Post, reading: Make, follow: Callable[[], None]
) -> None:
    made(store)
    last = visit(reading, 4)
    post("r1", *visit(reading, 1), *visit(reading, 2, 0.2), *visit(reading, 3), *last[:6])
    follow()
    (first,) = diagnoses(store)
    assert first.request["through_seq"] == 30
    again = [replace(one, id=f"{one.id}-again") for one in last]
    for more in (last[6:], again[:5]):
        post("r1", *more)
        follow()
        assert alarms(store) > 0
        assert diagnoses(store) == [first], "37 readings and 30 of them: nothing new"
    post("r1", again[5])
    follow()
    _, second = diagnoses(store)
    assert second.request["through_seq"] == 38
    follow()
    assert len(diagnoses(store)) == 2


def test_it_is_asked_again_where_another_campaign_alarms(
    store: SqlStore, post: Post, reading: Make, follow: Callable[[], None]
) -> None:
    made(store)
    posted = [visit(reading, k) for k in (1, 3, 4, 5, 6, 7)]
    post("r1", *visit(reading, 2, 0.2), *(r for own in posted for r in own))
    follow()
    (first,) = diagnoses(store)
    odd = visit(reading, 8, -0.4)[:5]
    assert 56 + len(odd) < 56 * asking.GROWN
    post("r1", *odd)
    follow()
    _, second = diagnoses(store)
    before, after = (
        {one["value"] for one in job.request["because"]["tests"] if one["grouping"] == "campaign"}
        for job in (first, second)
    )
    assert "c8" in after - before


@pytest.mark.parametrize("end", ["done", "cancelled"])
def test_what_is_asked_already_is_waited_for(
    store: SqlStore,
    science: Offsets,
    post: Post,
    reading: Make,
    worker: Worker,
    diagnoser: Worker,
    settings: Settings,
    end: str,
) -> None:
    """Somebody's own diagnosis of this log is the answer; one that was cancelled is none."""
    made(store)
    post("r1", *visit(reading, 1), *visit(reading, 2, 0.2), *visit(reading, 3))
    worker.drain()
    own, _ = request_diagnosis(store, science, "r1", (), compare=False, horizon_h=None)
    assert Residuals(store, science, settings, "d").run_once()
    assert not Asking(store).run_once(), "a diagnosis is under way"
    if end == "cancelled":
        cancel_diagnosis(store, "r1", own.id)
    diagnoser.drain()
    found = diagnoses(store)
    assert [(job.id, job.status) for job in found[:1]] == [(own.id, end)]
    assert len(found) == (1 if end == "done" else 2)
    assert not Asking(store).run_once(), "judged, either way"


def test_who_asks_for_what_is_asked_already_is_told_so(
    store: SqlStore,
    science: Offsets,
    api: httpx.Client,
    post: Post,
    reading: Make,
    worker: Worker,
    settings: Settings,
) -> None:
    made(store)
    post("r1", *visit(reading, 1), *visit(reading, 2, 0.2), *visit(reading, 3))
    worker.drain()
    assert Residuals(store, science, settings, "d").run_once()
    assert Asking(store).run_once()
    (unasked,) = diagnoses(store)
    sent = api.post("/v1/rotors/r1/diagnoses")
    assert (sent.status_code, sent.headers["Idempotent-Replayed"]) == (202, "true")
    assert sent.json()["diagnosis"]["id"] == unasked.id
    other = api.post("/v1/rotors/r1/diagnoses", json={"compare": False})
    assert other.json()["diagnosis"]["id"] != unasked.id, "it is another question"


def test_a_diagnosis_of_an_older_log_is_no_answer(
    store: SqlStore,
    science: Offsets,
    post: Post,
    reading: Make,
    worker: Worker,
    diagnoser: Worker,
) -> None:
    made(store)
    post("r1", *visit(reading, 1), *visit(reading, 2, 0.2))
    own, _ = request_diagnosis(store, science, "r1", (), compare=False, horizon_h=None)
    post("r1", *visit(reading, 3), *visit(reading, 4))
    worker.drain()
    diagnoser.drain()
    told = [(job.request["through_seq"], "because" in job.request) for job in diagnoses(store)]
    assert told == [(16, False), (32, True)]
    assert diagnoses(store)[0].id == own.id


def test_what_somebody_backed_out_is_not_adopted_again_unasked(
    store: SqlStore, science: Offsets, post: Post, reading: Make, follow: Callable[[], None]
) -> None:
    made(store, "alarm", "effect")
    post("r1", *visit(reading, 1), *visit(reading, 2, 0.2), *visit(reading, 3), *visit(reading, 4))
    follow()
    (first,) = diagnoses(store)
    back_out(store, science, "r1", first.id)
    follow()
    assert alarms(store) > 0
    assert len(diagnoses(store)) == 1, "it was asked before, under the same model"
    post("r1", *visit(reading, 5), *visit(reading, 6))
    follow()
    _, second = diagnoses(store)
    assert second.status == "done"
    with store.read() as tx:
        result = tx.records.job(second.id).result or {}
        effects = [e.kind for e in tx.log.changes("r1", 0, 10)]
    assert result["verdict"] == "effect"
    assert "backed out what was adopted last, with entry 34" in result["not_adopted"]
    assert effects == ["adoption", "back-out"]


def test_what_somebody_backed_out_stays_out_whatever_was_adopted_since(
    store: SqlStore,
    science: Offsets,
    post: Post,
    reading: Make,
    follow: Callable[[], None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Both offsets go out, and one comes back by hand: the other one came back by itself."""
    made(store, "alarm", "effect")
    rest = [one for k in (1, 3, 5, 6) for one in visit(reading, k)]
    post("r1", *visit(reading, 2, 0.3), *visit(reading, 4, -0.2), *rest)
    for _ in range(2):
        follow()
    first, second = (job.id for job in diagnoses(store))
    for one in (second, first):
        back_out(store, science, "r1", one)
    follow()
    whole = Offsets._off

    def first_c4(readings: Sequence[Inspection]) -> dict[str, float]:
        off = whole(readings)
        return {"c4": off["c4"]} if abs(off["c4"]) > 0.1 else off

    monkeypatch.setattr(Offsets, "_off", staticmethod(first_c4))
    own, _ = request_diagnosis(store, science, "r1", (), compare=False, horizon_h=None)
    for _ in range(2):
        follow()
    with store.read() as tx:
        entries = [(e.kind, json.loads(e.body)["diagnosis"]) for e in tx.log.changes("r1", 0, 10)]
        found = [tx.records.job(job.id) for job in diagnoses(store)]
    assert entries == [
        ("adoption", first), ("adoption", second), ("back-out", second), ("back-out", first),
        ("adoption", own.id),
    ]  # fmt: skip
    (last,) = [job for job in found if job.request["through_seq"] == 53]
    assert "because" in last.request
    told = last.result or {}
    assert told["names"] == [NAME]
    assert f"somebody backed out {NAME}, with entry 52" in told["not_adopted"]


def test_alarms_of_a_model_that_was_left_ask_for_nothing(
    store: SqlStore,
    science: Offsets,
    post: Post,
    reading: Make,
    worker: Worker,
    diagnoser: Worker,
    settings: Settings,
    follow: Callable[[], None],
) -> None:
    """Readings come while a diagnosis runs that is adopted: residuals of before it stand still."""
    made(store, "readings", "effect")
    post("r1", *visit(reading, 1), *visit(reading, 2, 0.2), *visit(reading, 3), *visit(reading, 4))
    worker.drain()
    residuals, asks = Residuals(store, science, settings, "d"), Asking(store)
    assert residuals.run_once()
    assert asks.run_once()
    post("r1", *visit(reading, 5), *visit(reading, 6))
    worker.drain()
    assert residuals.run_once(), "another diagnoser's, of all readings, under the model before"
    assert not asks.run_once(), "a diagnosis is under way"
    assert diagnoser.jobs.run_once(), "adopted; the sealer has not come to it"
    assert alarms(store) > 0
    assert asks.run_once()
    assert [job.request["through_seq"] for job in diagnoses(store)] == [32]
    follow()
    assert alarms(store) == 0, "of the model with the effect in it"
    _, second = diagnoses(store)
    result = second.result or {}
    assert second.request["through_seq"] > 48, "a quarter more readings, under the model of now"
    assert (result["verdict"], result.get("not_adopted")) == ("adequate", None)


def both_at_once(store: SqlStore, monkeypatch: pytest.MonkeyPatch) -> int:
    """How many diagnoses are asked for by two workers that have seen the same alarms."""
    seen = threading.Barrier(2, timeout=PATIENCE_S)
    found = Asking.found

    def looked(tx: object, rotor_id: str) -> object:
        return found(tx, rotor_id)  # type: ignore[arg-type]

    class Slow(Asking):
        found = staticmethod(looked)  # type: ignore[assignment]

    write = store.write
    waited: list[None] = []

    def together() -> object:
        if len(waited) < 2:
            waited.append(None)
            seen.wait()
        return write()

    monkeypatch.setattr(store, "write", together)
    workers = [threading.Thread(target=Slow(store).run_once) for _ in range(2)]
    for one in workers:
        one.start()
    for one in workers:
        one.join()
    monkeypatch.undo()
    return len(diagnoses(store))


@pytest.fixture
def alarming(
    store: SqlStore, science: Offsets, settings: Settings, post: Post, reading: Make, worker: Worker
) -> None:
    """A rotor whose residuals alarm, and nobody has asked yet."""
    made(store)
    post("r1", *visit(reading, 1), *visit(reading, 2, 0.2), *visit(reading, 3))
    worker.drain()
    assert Residuals(store, science, settings, "d").run_once()


def test_two_workers_that_see_the_same_alarms_ask_once(
    store: SqlStore, alarming: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert both_at_once(store, monkeypatch) == 1


def test_without_a_look_under_the_lock_they_would_ask_twice(
    store: SqlStore, alarming: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mutant: what was judged, and what is under way, is not looked at."""

    def always() -> ColumnElement[bool]:
        return true()

    with monkeypatch.context() as patched:
        patched.setattr(asking, "waiting", always)
        patched.setattr(asking, "idle", always)
        patched.setattr(asking, "new", lambda now, before: True)
        assert both_at_once(store, patched) == 2


def test_a_version_is_judged_once(
    store: SqlStore, alarming: None, diagnoser: Worker, monkeypatch: pytest.MonkeyPatch
) -> None:
    diagnoser.drain()
    with store.read() as tx:
        row = tx.connection.execute(select(t.residual.c.judged, t.residual.c.version)).one()
    assert row.judged == row.version
    assert not Asking(store).run_once()
    assert len(diagnoses(store)) == 1


def test_a_damaged_row_asks_for_nothing_and_ends_no_worker(
    store: SqlStore, alarming: None, diagnoser: Worker, caplog: pytest.LogCaptureFixture
) -> None:
    with store.write() as tx:
        tx.connection.execute(update(t.residual).values(body="{"))
    diagnoser.drain()
    assert "residuals of r1 ask for nothing" in caplog.text
    assert diagnoses(store) == []
    assert not Asking(store).run_once(), "until there is another version"


def test_the_option_leaves_with_the_rotor_and_comes_back(
    store: SqlStore, api: httpx.Client, tmp_path: Path
) -> None:
    made(store, "alarm", "never")
    file = tmp_path / "r1.zip"
    export_rotor(store, "r1", file, "test")
    import_rotor(store, Offsets(), file, "copy")
    assert api.get("/v1/rotors/copy").json()["diagnose"] == "alarm"
    body = {"id": "r9", "model": "rotor-blade", "blades": [{"id": "B1"}]}
    assert api.post("/v1/rotors", json=body).json()["diagnose"] == "never"
    assert api.post("/v1/rotors", json=body | {"diagnose": "never"}).status_code == 201
    assert api.post("/v1/rotors", json=body | {"diagnose": "alarm"}).status_code == 409
    assert api.post("/v1/rotors", json=body | {"diagnose": "daily"}).status_code == 422
    one, same = (
        api.post("/v1/rotors", json=body | {"id": "r8", "diagnose": "alarm", "adopt": "effect"})
        for _ in range(2)
    )
    assert one.json() == same.json()
    assert same.headers["Idempotent-Replayed"] == "true"
