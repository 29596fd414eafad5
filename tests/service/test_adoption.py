"""What a diagnosis named goes into the rotor's model, and out of it, bit for bit."""

from __future__ import annotations

import json
import threading
import zipfile
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import text, update
from typer.testing import CliRunner

from core.diagnosis.concerned import Concerned
from core.diagnosis.verdict import Held
from core.log import Entry
from core.observation import Inspection
from service import bundle
from service.adopt_command import lines_of
from service.adopted import adopted_at
from service.bootstrap import make_worker
from service.bundle import BundleError
from service.cli import app as commands
from service.client import Client, ProblemError
from service.concerned import concerns
from service.diagnose_command import adopted_line
from service.handlers import adoptions
from service.handlers.adoptable import told_effects
from service.handlers.adoptions import adopt
from service.handlers.blades import add_blade
from service.handlers.diagnoses import find_diagnosis, request_diagnosis
from service.handlers.inspections import retract
from service.handlers.rotors import create_rotor, view_rotor
from service.handlers.transfer_in import import_rotor
from service.handlers.transfer_out import export_rotor
from service.ports import BladeRecord, Event, Json
from service.settings import Settings
from service.store import tables as t
from service.store.audit import audit
from service.store.engine import snapshot, transaction
from service.store.log import SqlLog
from service.store.named import digests
from service.store.unit_of_work import SqlStore
from service.worker import claiming, job_lease
from service.worker import lease as leases
from service.worker.loop import Worker
from service.worker.replay import replay
from tests.service.adopting import Offsets

Make = Callable[..., Inspection]
Post = Callable[..., int]
OFF = {"c2": 0.1, "c3": 0.0}
NAME = "campaign offset (campaign c2)"


@pytest.fixture
def science() -> Offsets:
    return Offsets()


def visits(reading: Make, off: dict[str, float], blades: str = "123") -> list[Inspection]:
    """Three blades along lines, read in three campaigns; some of these are off."""
    return [
        reading(
            f"B{b}-{c}",
            blade=f"B{b}",
            time_h=8e3 * k,
            value=(0.4 + 0.1 * int(b)) * 8e3 * k / 5e4 + off.get(c, 0.0),
            campaign=c,
        )
        for b in blades
        for k, c in enumerate(("c1", "c2", "c3", "c4"), 1)
    ]


@pytest.fixture
def off(rotor: str, post: Post, reading: Make, worker: Worker) -> str:
    """A rotor whose second campaign reads 0.1 mm too much, with its posterior."""
    post(rotor, *visits(reading, OFF))
    worker.drain()
    return rotor


def diagnosed(store: SqlStore, science: Offsets, diagnoser: Worker) -> str:
    """A diagnosis of the rotor as it stands, done."""
    job, _ = request_diagnosis(store, science, "r1", (), compare=True, horizon_h=None)
    diagnoser.drain()
    return job.id


@pytest.fixture
def named(store: SqlStore, science: Offsets, off: str, diagnoser: Worker) -> str:
    """The id of a diagnosis that names the effect."""
    found = diagnosed(store, science, diagnoser)
    result = find_diagnosis(store, "r1", found).result
    assert result is not None
    assert (result["verdict"], result["names"]) == ("effect", [NAME])
    return found


def called(store: SqlStore) -> tuple[str, dict[str, str]]:
    """What the newest posterior is called by: its digest and those of its arrays."""
    state = view_rotor(store, "r1").state
    assert state is not None
    with store.read() as tx:
        return state.digest, digests(tx.connection, "r1")


def bands(api: httpx.Client, **which: Any) -> Json:
    told: Json = api.get(
        "/v1/rotors/r1/blades/B1/prediction", params={"times": "25000,50000"} | which
    ).json()
    return told


def test_an_effect_that_is_adopted_is_in_the_next_version_with_the_diagnosed_model(
    api: httpx.Client, store: SqlStore, named: str, worker: Worker
) -> None:
    before, first = bands(api), api.get("/v1/rotors/r1").json()
    assert (first["effects"], first["network"], first["status"]) == ([], None, "current")
    sent = api.post(f"/v1/rotors/r1/diagnoses/{named}/adoption")
    assert sent.status_code == 202, sent.text
    told = sent.json()
    assert (told["head_seq"], told["adoption"]["seq"]) == (13, 13)
    assert told["adoption"]["readings_since"] == 0
    result = find_diagnosis(store, "r1", named).result or {}
    assert told["adoption"]["models"] == result["models"]
    assert bands(api) == before, "until a worker has computed it"
    assert api.get("/v1/rotors/r1").json()["status"] == "pending"
    worker.drain()
    after, rotor = bands(api), api.get("/v1/rotors/r1").json()
    assert after["rests_on"]["model_digest"] == result["models"]["after"]
    assert after["rests_on"]["version"] == before["rests_on"]["version"] + 1
    assert after["rests_on"]["events_digest"] == before["rests_on"]["events_digest"]
    truth = 0.5 * 1.0  # mm at 50,000 h
    assert abs(after["mean"][1] - truth) < 0.25 * abs(before["mean"][1] - truth)
    assert [one["name"] for one in rotor["effects"]] == [NAME]
    assert rotor["effects"][0]["diagnosis"] == named
    assert rotor["network"]["effects"]["biases"][0]["campaign"] == "c2"


def test_backed_out_the_sealed_state_is_bit_identical_to_the_one_before(
    api: httpx.Client, store: SqlStore, named: str, worker: Worker
) -> None:
    before, was = called(store), bands(api)
    api.post(f"/v1/rotors/r1/diagnoses/{named}/adoption")
    worker.drain()
    assert called(store)[0] != before[0]
    sent = api.delete(f"/v1/rotors/r1/diagnoses/{named}/adoption")
    assert (sent.status_code, sent.json()["adoption"]["what"]) == (202, "back-out")
    worker.drain()
    assert called(store) == before
    now = bands(api)
    assert {k: v for k, v in now.items() if k != "rests_on"} == {
        k: v for k, v in was.items() if k != "rests_on"
    }
    rotor = api.get("/v1/rotors/r1").json()
    assert (rotor["effects"], rotor["network"], rotor["version"]) == ([], None, 3)


def test_a_network_of_the_rotor_s_own_comes_back_too(
    store: SqlStore, science: Offsets, settings: Settings, post: Post, reading: Make
) -> None:
    """With the model's own network left in place the rotor would lose what it asked for."""
    asked = {"quantities": {"elongation": {"by_instrument": True}}}
    blades = [BladeRecord(f"B{b}") for b in "123"]
    create_rotor(store, "r1", "rotor-blade", blades, 64, 7, asked)
    post("r1", *visits(reading, OFF))
    make_worker(store, science, settings).drain()
    before = called(store)
    found = diagnosed(store, science, make_worker(store, science, settings, "d", "diagnose"))
    change = adopt(store, science, "r1", found)
    assert change.body["after"]["quantities"] == asked["quantities"]
    make_worker(store, science, settings).drain()
    state = view_rotor(store, "r1").state
    assert state is not None
    assert state.meta["model"] == change.body["models"]["after"]
    from service.handlers.adoptions import back_out

    assert back_out(store, science, "r1", found).body["after"] == asked
    make_worker(store, science, settings).drain()
    assert called(store) == before


def test_reads_of_versions_before_an_adoption_use_the_network_of_then(
    api: httpx.Client, store: SqlStore, named: str, worker: Worker
) -> None:
    kinds = ("", "/posterior", "/blades/B1/posterior")
    then = [api.get(f"/v1/rotors/r1{kind}", params={"version": 1}).json() for kind in kinds]
    before = bands(api, version=1)
    moment = api.get("/v1/rotors/r1/inspections/B3-c4").json()["received_at"]
    with transaction(store.engine, write=True) as connection:  # the entries of another day
        connection.execute(text("UPDATE event SET received_at = received_at - 90000"))
        connection.execute(text("UPDATE rotor SET created_at = created_at - 180000"))
    moment = api.get("/v1/rotors/r1/inspections/B3-c4").json()["received_at"]
    api.post(f"/v1/rotors/r1/diagnoses/{named}/adoption")
    worker.drain()
    assert bands(api, version=1) == before == bands(api, at=moment)
    now = bands(api)
    assert now["rests_on"]["model_digest"] != before["rests_on"]["model_digest"]
    for kind, was in zip(kinds, then, strict=True):
        again = api.get(f"/v1/rotors/r1{kind}", params={"version": 1}).json()
        for told in (again, was):  # the rotor's own place in the log has moved on
            for moved in ("head_seq", "applied_seq", "version", "created_at"):
                told.pop(moved, None)
        assert again == was, kind
    assert api.get("/v1/rotors/r1", params={"version": 2}).json()["effects"][0]["name"] == NAME


def refused(sent: httpx.Response) -> Json:
    assert sent.status_code == 409, sent.text
    told: Json = sent.json()
    assert told["type"] == "urn:bladetwin:problem:not-adoptable"
    assert "nothing was changed" in told["detail"]
    return told


def test_a_diagnosis_that_names_no_effect_is_refused_with_what_to_do(
    api: httpx.Client, store: SqlStore, science: Offsets, off: str, diagnoser: Worker
) -> None:
    job, _ = request_diagnosis(store, science, "r1", (), compare=True, horizon_h=None)
    path = f"/v1/rotors/r1/diagnoses/{job.id}/adoption"
    assert "says done" in refused(api.post(path))["detail"], "it is queued"
    diagnoser.drain()
    result = find_diagnosis(store, "r1", job.id).result or {}
    for change, words in (
        ({"verdict": "adequate"}, "leave the model as it is"),
        ({"verdict": "not separable", "names": ["a", "b"]}, "separate a and b"),
        ({"verdict": "unattributed"}, "families of effects of your own"),
        ({"adds": None}, "release"),
    ):
        with transaction(store.engine, write=True) as connection:
            told = json.dumps(result | change)
            connection.execute(update(t.job).where(t.job.c.id == job.id).values(result=told))
        assert words in refused(api.post(path))["detail"]
    assert view_rotor(store, "r1").rotor.head_seq == 12


def test_cancelled_and_unknown_ones_are_refused_each_in_its_way(
    api: httpx.Client, off: str
) -> None:
    told = api.post("/v1/rotors/r1/diagnoses").json()["diagnosis"]
    api.delete(f"/v1/rotors/r1/diagnoses/{told['id']}")
    path = f"/v1/rotors/r1/diagnoses/{told['id']}/adoption"
    assert "ask anew" in refused(api.post(path))["detail"]
    assert api.delete(path).status_code == 404
    for method in ("POST", "DELETE"):
        assert api.request(method, "/v1/rotors/r1/diagnoses/zz/adoption").status_code == 404
        assert api.request(method, "/v1/rotors/zz/diagnoses/zz/adoption").status_code == 404


def test_adopting_twice_and_backing_out_twice_each_give_the_first_answer_again(
    api: httpx.Client, store: SqlStore, named: str, worker: Worker
) -> None:
    path = f"/v1/rotors/r1/diagnoses/{named}/adoption"
    for method, seq in (("POST", 13), ("DELETE", 14), ("POST", 15)):
        first, again = api.request(method, path), api.request(method, path)
        assert (first.json()["head_seq"], first.headers.get("idempotent-replayed")) == (seq, None)
        assert again.json() == first.json()
        assert again.headers["idempotent-replayed"] == "true"
        worker.drain()
    listed = api.get("/v1/rotors/r1/adoptions").json()["items"]
    assert [(one["what"], one["seq"]) for one in listed] == [
        ("adoption", 13),
        ("back-out", 14),
        ("adoption", 15),
    ]
    assert listed[0]["networks"] == listed[2]["networks"]
    assert listed[1]["networks"]["before"] == listed[0]["networks"]["after"]
    standing = api.get(f"/v1/rotors/r1/diagnoses/{named}").json()["adoption"]
    assert standing == listed[2]


def test_adoptions_lie_on_one_another_and_the_last_one_goes_first(
    api: httpx.Client,
    store: SqlStore,
    science: Offsets,
    rotor: str,
    post: Post,
    reading: Make,
    worker: Worker,
    diagnoser: Worker,
) -> None:
    post(rotor, *visits(reading, {"c2": 0.2, "c3": -0.12}))
    worker.drain()
    before = called(store)
    first = diagnosed(store, science, diagnoser)
    api.post(f"/v1/rotors/r1/diagnoses/{first}/adoption")
    worker.drain()
    between = called(store)
    second = diagnosed(store, science, diagnoser)
    sent = api.post(f"/v1/rotors/r1/diagnoses/{second}/adoption")
    assert sent.status_code == 202, sent.text
    worker.drain()
    effects = api.get("/v1/rotors/r1").json()["effects"]
    assert [one["diagnosis"] for one in effects] == [first, second]
    told = refused(api.delete(f"/v1/rotors/r1/diagnoses/{first}/adoption"))
    assert f"back out {second} first" in told["detail"]
    for one, digest in ((second, between), (first, before)):
        assert api.delete(f"/v1/rotors/r1/diagnoses/{one}/adoption").status_code == 202
        worker.drain()
        assert called(store) == digest


def test_a_refusal_says_what_was_adopted_or_backed_out_since(
    api: httpx.Client,
    store: SqlStore,
    science: Offsets,
    rotor: str,
    post: Post,
    reading: Make,
    worker: Worker,
    diagnoser: Worker,
) -> None:
    """It named what had been there before as adopted since, and had a model diagnosed anew that two
    requests give back."""
    post(rotor, *visits(reading, {"c2": 0.2, "c3": -0.12}))
    path = lambda which: f"/v1/rotors/r1/diagnoses/{which}/adoption"  # noqa: E731
    first = diagnosed(store, science, diagnoser)
    api.post(path(first)).raise_for_status()
    second = diagnosed(store, science, diagnoser)
    beside = api.post("/v1/rotors/r1/diagnoses", json={"horizon_h": 1000.0}).json()["diagnosis"]
    diagnoser.drain()
    api.post(path(second)).raise_for_status()
    told = refused(api.post(path(beside["id"])))
    assert f"(adopted since: {second})" in told["detail"]
    assert told["faults"][0]["remedy"].startswith("ask for a diagnosis of the present model")
    for which in (second, first):
        api.delete(path(which)).raise_for_status()
    told = refused(api.post(path(second)))
    assert f"(backed out since: {first})" in told["detail"]
    assert "adopted since" not in told["detail"]
    assert told["faults"][0]["remedy"].startswith(f"adopt {first} again first, or ask for")
    for which in (first, second):
        assert api.post(path(which)).status_code == 202


def test_a_diagnosis_of_another_model_than_the_rotor_s_is_refused(
    api: httpx.Client, store: SqlStore, science: Offsets, named: str, diagnoser: Worker
) -> None:
    """Two diagnoses of one log: with one of them adopted the other speaks of a model of before."""
    api.post("/v1/rotors/r1/diagnoses", json={"horizon_h": 1000.0})
    diagnoser.drain()
    newest = api.get("/v1/rotors/r1/diagnoses").json()["items"][0]["id"]
    api.post(f"/v1/rotors/r1/diagnoses/{named}/adoption")
    told = refused(api.post(f"/v1/rotors/r1/diagnoses/{newest}/adoption"))
    assert f"adopted since: {named}" in told["detail"]
    assert "diagnosis of the present model" in told["faults"][0]["remedy"]


def test_a_diagnosis_asked_before_an_adoption_speaks_of_the_model_of_then(
    api: httpx.Client, store: SqlStore, science: Offsets, named: str, diagnoser: Worker
) -> None:
    job, _ = request_diagnosis(store, science, "r1", (), compare=False, horizon_h=None)
    api.post(f"/v1/rotors/r1/diagnoses/{named}/adoption")
    diagnoser.drain()
    result = find_diagnosis(store, "r1", job.id).result or {}
    assert result["verdict"] == "effect", "its log ends before the adoption"
    assert result["rests_on"]["model_digest"] == result["models"]["before"]
    later = diagnosed(store, science, diagnoser)
    assert (find_diagnosis(store, "r1", later).result or {})["verdict"] == "adequate"


def test_readings_that_came_since_are_told_and_readings_that_are_gone_forbid_it(
    api: httpx.Client, store: SqlStore, named: str, post: Post, reading: Make
) -> None:
    path = f"/v1/rotors/r1/diagnoses/{named}/adoption"
    post("r1", reading("late", time_h=4e3, value=0.04), reading("other", time_h=5e3, value=0.05))
    post("r1", reading("again", time_h=8e3, value=0.08, replaces="B1-c1"))
    told = refused(api.post(path))
    assert "1 of its 12 readings count no longer (B1-c1)" in told["detail"]
    retract(store, "r1", "again")
    sent = api.post(path)
    assert sent.json()["adoption"]["readings_since"] == 2, sent.text


def test_what_comes_while_the_log_is_read_ahead_counts_and_the_lock_reads_the_rest_alone(
    api: httpx.Client,
    store: SqlStore,
    named: str,
    post: Post,
    reading: Make,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Between reading ahead and the lock one of the diagnosis' readings is corrected."""
    path = f"/v1/rotors/r1/diagnoses/{named}/adoption"
    under_lock: list[int] = []
    own, entries = adoptions.read_ahead, SqlLog.entries

    def late(*args: Any) -> list[Entry]:
        found = own(*args)
        post("r1", reading("again", time_h=8e3, value=0.08, replaces="B1-c1"))
        monkeypatch.setattr(SqlLog, "entries", counted)
        return found

    def counted(self: SqlLog, rotor_id: str, after: int, through: int, limit: int) -> list[Event]:
        under_lock.append(after)
        return entries(self, rotor_id, after, through, limit)

    monkeypatch.setattr(adoptions, "read_ahead", late)
    told = refused(api.post(path))
    assert "1 of its 12 readings count no longer (B1-c1)" in told["detail"]
    assert under_lock == [12]


def test_a_blade_that_joined_since_forbids_only_effects_that_would_concern_it() -> None:
    effect = {"whom": "lot", "value": "L1", "clock": "blade", "shape": "constant"}
    assert concerns(effect, BladeRecord("B9", lot="L1"))
    assert not concerns(effect, BladeRecord("B9", lot="L2"))
    assert not concerns(effect | {"clock": "event"}, BladeRecord("B9", lot="L1"))
    step = {"whom": "all", "value": None, "clock": "rotor", "shape": "step"}
    assert concerns(step, BladeRecord("B9"))
    assert not concerns(step | {"clock": "blade"}, BladeRecord("B9"))
    assert not concerns(step | {"shape": "constant"}, BladeRecord("B9"))
    drift = {"whom": "instrument", "value": "g1", "clock": "rotor", "shape": "linear"}
    assert concerns(drift, BladeRecord("B9"))
    assert not concerns(drift | {"shape": "constant"}, BladeRecord("B9"))
    assert not concerns(step | {"whom": "blade", "value": "B1"}, BladeRecord("B9"))


def of_a_lot(store: SqlStore, diagnosis: str) -> str:
    """As if the effect that it found were of a lot; the effect's name."""
    result = find_diagnosis(store, "r1", diagnosis).result or {}
    result["effects"][0] |= {"whom": "lot", "value": "L1"}
    with transaction(store.engine, write=True) as connection:
        told = json.dumps(result)
        connection.execute(update(t.job).where(t.job.c.id == diagnosis).values(result=told))
    return str(result["effects"][0]["name"])


def test_a_blade_that_joins_an_adopted_effect_s_lot_is_told_to_be_unknown_to_it(
    api: httpx.Client, store: SqlStore, named: str, worker: Worker
) -> None:
    """Its bands, the rotor and no other blade's; no longer once the effect is backed out."""
    name = of_a_lot(store, named)
    path = f"/v1/rotors/r1/diagnoses/{named}/adoption"
    api.post(path).raise_for_status()
    for blade, lot in (("B8", "L2"), ("B9", "L1")):
        add_blade(store, "r1", BladeRecord(blade, lot=lot))
    worker.drain()

    def untold() -> list[Any]:
        bands = [
            api.get(f"/v1/rotors/r1/blades/{blade}/prediction").json()["rests_on"]["untold"]
            for blade in ("B1", "B8", "B9")
        ]
        shared = api.get("/v1/rotors/r1/posterior").json()["rests_on"]["untold"]
        return [
            *bands,
            shared,
            [one["untold"] for one in api.get("/v1/rotors/r1").json()["effects"]],
        ]

    before = api.get("/v1/rotors/r1").json()["posterior"]["version"]
    assert untold() == [[], [], [name], [name], [["B9"]]]
    api.delete(path).raise_for_status()
    worker.drain()
    assert untold() == [[], [], [], [], []]
    then = api.get("/v1/rotors/r1/blades/B9/prediction", params={"version": before}).json()
    assert then["rests_on"]["untold"] == [name]


def test_a_new_blade_of_the_lot_is_named_in_the_refusal(
    api: httpx.Client, store: SqlStore, named: str
) -> None:
    of_a_lot(store, named)
    add_blade(store, "r1", BladeRecord("B9", lot="L1"))
    told = refused(api.post(f"/v1/rotors/r1/diagnoses/{named}/adoption"))["detail"]
    assert "B9 joined since" in told


def automatic(store: SqlStore, settings: Settings, post: Post, reading: Make, option: Any) -> None:
    blades = [BladeRecord(f"B{b}") for b in "123"]
    create_rotor(store, "r1", "rotor-blade", blades, 64, 7, None, option)
    post("r1", *visits(reading, OFF))


@pytest.mark.parametrize(("option", "seq"), [("effect", 13), ("never", 12)])
def test_a_rotor_that_says_so_adopts_what_is_named_and_any_other_does_not(
    store: SqlStore,
    science: Offsets,
    settings: Settings,
    post: Post,
    reading: Make,
    option: str,
    seq: int,
    diagnoser: Worker,
) -> None:
    automatic(store, settings, post, reading, option)
    found = diagnosed(store, science, diagnoser)
    rotor = view_rotor(store, "r1").rotor
    assert (rotor.head_seq, rotor.adopt) == (seq, option)
    with store.read() as tx:
        sheets = adopted_at(tx, rotor).sheets
    assert [one.diagnosis for one in sheets] == [found] * (seq - 12)


def told_of(store: SqlStore, kinds: Sequence[str]) -> list[tuple[str, Json]]:
    """What who listens to the rotor was told, in order."""
    with store.read() as tx:
        return [(n.kind, n.payload) for n in tx.outbox.after("r1", 0, 100) if n.kind in kinds]


@pytest.mark.parametrize("unasked", [True, False])
def test_who_listens_is_told_of_what_goes_into_the_model_and_out_of_it_again(
    api: httpx.Client,
    store: SqlStore,
    science: Offsets,
    settings: Settings,
    post: Post,
    reading: Make,
    diagnoser: Worker,
    unasked: bool,
) -> None:
    automatic(store, settings, post, reading, "effect" if unasked else "never")
    found = diagnosed(store, science, diagnoser)
    for _ in range(2):  # the second changes nothing, and tells nothing
        assert api.post(f"/v1/rotors/r1/diagnoses/{found}/adoption").status_code in (200, 202)
    for _ in range(2):
        assert api.delete(f"/v1/rotors/r1/diagnoses/{found}/adoption").status_code in (200, 202)
    asked = {"diagnosis": found, "effects": [NAME], "posted_by": "loopback"}
    told = asked | ({"posted_by": None} if unasked else {})
    assert told_of(store, ("diagnosed", "adopted", "backed-out")) == [
        ("diagnosed", {"diagnosis": found, "verdict": "effect", "names": [NAME]}),
        ("adopted", told | {"seq": 13, "unasked": unasked}),
        ("backed-out", asked | {"seq": 14}),
    ]


@pytest.mark.parametrize("unasked", [True, False])
def test_a_rotor_says_when_an_effect_was_adopted_and_that_nobody_asked_for_it(
    api: httpx.Client,
    store: SqlStore,
    science: Offsets,
    settings: Settings,
    post: Post,
    reading: Make,
    worker: Worker,
    diagnoser: Worker,
    unasked: bool,
) -> None:
    """So does its line in `inspect`: who adopts by itself has another model overnight."""
    automatic(store, settings, post, reading, "effect" if unasked else "never")
    found = diagnosed(store, science, diagnoser)
    api.post(f"/v1/rotors/r1/diagnoses/{found}/adoption").raise_for_status()
    worker.drain()
    (effect,) = api.get("/v1/rotors/r1").json()["effects"]
    (entry,) = api.get("/v1/rotors/r1/adoptions").json()["items"]
    assert (effect["at"], effect["unasked"]) == (entry["at"], entry["unasked"])
    assert effect["unasked"] is unasked
    told = CliRunner().invoke(commands, ["inspect", "r1", "--url", str(api.base_url)]).stdout
    (line,) = [one for one in told.splitlines() if one.startswith("  effect ")]
    said = f"  effect   {NAME}, adopted {entry['at'][:16]}Z"
    assert line == said + (" by the rotor itself" if unasked else "")


def test_what_forbids_an_adoption_by_itself_stands_in_the_result(
    api: httpx.Client, store: SqlStore, settings: Settings, post: Post, reading: Make
) -> None:
    automatic(store, settings, post, reading, "effect")

    class Retracting(Offsets):
        def diagnose(self, *given: Any) -> Json:
            retract(store, "r1", "B1-c1")
            return super().diagnose(*given)

    science = Retracting()
    found = diagnosed(store, science, make_worker(store, science, settings, "d", "diagnose"))
    job = find_diagnosis(store, "r1", found)
    assert job.status == "done"
    why = (job.result or {})["not_adopted"]
    assert "(B1-c1)" in why
    ((kind, told),) = told_of(store, ("diagnosed", "adopted"))
    assert (kind, told["not_adopted"]) == ("diagnosed", why[:500]), "who listens hears why"
    (listed,) = api.get("/v1/rotors/r1/diagnoses").json()["items"]
    assert (listed["verdict"], listed["not_adopted"]) == ("effect", why)
    assert view_rotor(store, "r1").rotor.head_seq == 13, "the retraction"


@pytest.mark.parametrize("holds", [True, False])
def test_what_fails_in_a_condition_is_not_adopted_unasked_and_may_be_asked_for(
    api: httpx.Client, store: SqlStore, settings: Settings, post: Post, reading: Make, holds: bool
) -> None:
    automatic(store, settings, post, reading, "effect")

    class Conditional(Offsets):
        def diagnose(self, *given: Any) -> Json:
            one = {"input": "stress", "value": 230.0, "holds": holds}
            return super().diagnose(*given) | {"conditions": [one]}

    science = Conditional()
    found = diagnosed(store, science, make_worker(store, science, settings, "d", "diagnose"))
    result = find_diagnosis(store, "r1", found).result or {}
    assert result["verdict"] == "effect"
    assert ("not_adopted" in result) is not holds
    assert view_rotor(store, "r1").rotor.head_seq == 12 + holds
    if not holds:
        assert "does not hold at stress = 230" in result["not_adopted"]
        adopt(store, science, "r1", found)
        assert view_rotor(store, "r1").rotor.head_seq == 13


def test_an_amplitude_that_varies_is_not_adopted_unasked(
    api: httpx.Client, store: SqlStore, settings: Settings, post: Post, reading: Make
) -> None:
    automatic(store, settings, post, reading, "effect")

    class Varying(Offsets):
        def diagnose(self, *given: Any) -> Json:
            half = Held("early and late", (9.0, 3.0), 1.0, "wear", gained=(50.0, 80.0))
            return super().diagnose(*given) | {"holds": [half.to_json()]}

    science = Varying()
    found = diagnosed(store, science, make_worker(store, science, settings, "d", "diagnose"))
    result = find_diagnosis(store, "r1", found).result or {}
    assert "the amplitude of wear early and late is not one" in result["not_adopted"]
    assert view_rotor(store, "r1").rotor.head_seq == 12
    adopt(store, science, "r1", found)
    assert view_rotor(store, "r1").rotor.head_seq == 13


@pytest.mark.parametrize("nat", [-5.0, 0.5])
def test_what_may_be_in_some_blades_only_is_not_adopted_unasked(
    api: httpx.Client,
    store: SqlStore,
    settings: Settings,
    post: Post,
    reading: Make,
    nat: float,
) -> None:
    automatic(store, settings, post, reading, "effect")

    class Concerning(Offsets):
        def diagnose(self, *given: Any) -> Json:
            one = Concerned("campaign offset", 40, nat, 0.3)
            return super().diagnose(*given) | {"concerns": [one.to_json()]}

    science = Concerning()
    found = diagnosed(store, science, make_worker(store, science, settings, "d", "diagnose"))
    result = find_diagnosis(store, "r1", found).result or {}
    assert ("not_adopted" in result) is (nat > 0)
    if nat > 0:
        assert "whether all blades have campaign offset is open" in result["not_adopted"]
        adopt(store, science, "r1", found)
    assert view_rotor(store, "r1").rotor.head_seq == 13


def lost(store: SqlStore, settings: Settings) -> tuple[str, int]:
    """A diagnosis that is cancelled in its last step, and where the rotor's log ends then."""
    names: list[str] = []

    class Cancelled(Offsets):
        def diagnose(self, *given: Any) -> Json:
            with store.write() as tx:
                tx.records.cancel_job(names[0])
            return super().diagnose(*given[:-3], lambda what, done, total: None, *given[-2:])

    science = Cancelled()
    job, _ = request_diagnosis(store, science, "r1", (), compare=True, horizon_h=None)
    names.append(job.id)
    make_worker(store, science, settings, "d", "diagnose").drain()
    return find_diagnosis(store, "r1", job.id).status, view_rotor(store, "r1").rotor.head_seq


def test_a_result_that_is_refused_is_not_adopted_either(
    store: SqlStore, settings: Settings, post: Post, reading: Make
) -> None:
    automatic(store, settings, post, reading, "effect")
    assert lost(store, settings) == ("cancelled", 12)


def test_without_the_fence_it_would_be(
    store: SqlStore,
    settings: Settings,
    post: Post,
    reading: Make,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The mutant: neither who holds a job is asked, nor whether it still runs."""
    automatic(store, settings, post, reading, "effect")
    monkeypatch.setattr(job_lease, "holds", lambda lease: t.job.c.id == lease.id)
    monkeypatch.setattr(job_lease, "runs", lambda: t.job.c.id.is_not(None))
    assert lost(store, settings) == ("done", 13)


def test_a_change_of_the_model_is_the_sealer_s_work_and_takes_later_readings_with_it(
    api: httpx.Client,
    store: SqlStore,
    science: Offsets,
    settings: Settings,
    named: str,
    post: Post,
    reading: Make,
) -> None:
    applier = make_worker(store, science, settings, "a", "apply")
    sealer = make_worker(store, science, settings, "s", "seal")
    api.post(f"/v1/rotors/r1/diagnoses/{named}/adoption")
    post("r1", reading("late", time_h=4e3, value=0.04))
    applier.drain()
    assert view_rotor(store, "r1").rotor.applied_seq == 12
    sealer.drain()
    assert view_rotor(store, "r1").rotor.applied_seq == 14
    post("r1", reading("later", time_h=5e3, value=0.05))
    sealer.drain()
    assert view_rotor(store, "r1").rotor.applied_seq == 14, "readings are the other's work"
    applier.drain()
    assert view_rotor(store, "r1").rotor.applied_seq == 15


def test_a_worker_that_dies_over_the_new_model_leaves_one_version_for_the_next(
    api: httpx.Client, store: SqlStore, science: Offsets, settings: Settings, named: str
) -> None:
    api.post(f"/v1/rotors/r1/diagnoses/{named}/adoption")
    first, second = (make_worker(store, science, settings, name).updater for name in "ab")
    lease = claiming.claim(store.engine, "a", 30.0)
    assert lease is not None
    task = first.read(lease)
    state = first.compute(task, quick=True)
    leases.release(store.engine, "a")
    assert second.run_once()
    found = called(store)
    with pytest.raises(leases.LostLeaseError):
        first.commit(lease, task, state, first.change(task, state))
    assert (called(store), view_rotor(store, "r1").rotor.version) == (found, 2)
    assert state.digest == found[0], "the same model, whoever computes it"


def test_the_log_gives_both_models_again_and_every_digest_is_sound(
    api: httpx.Client, store: SqlStore, science: Offsets, named: str, worker: Worker
) -> None:
    for method in ("POST", "DELETE", "POST"):
        api.request(method, f"/v1/rotors/r1/diagnoses/{named}/adoption")
        worker.drain()
        assert replay(store, science, "r1")["same"] is True
        with snapshot(store.engine) as connection:
            assert audit(connection, "r1") == []


def test_a_changed_adoption_is_found_as_damage_of_the_log(
    api: httpx.Client, store: SqlStore, named: str
) -> None:
    api.post(f"/v1/rotors/r1/diagnoses/{named}/adoption")
    with transaction(store.engine, write=True) as connection:
        change = "UPDATE event SET body = replace(body, '\"c2\"', '\"c3\"') WHERE seq = 13"
        connection.execute(text(change))
    with snapshot(store.engine) as connection:
        found = audit(connection, "r1")
    assert [(one.part, one.name, one.from_log) for one in found] == [("log", "adoption/1", False)]


def test_a_rotor_is_exported_and_imported_with_its_adoptions(
    api: httpx.Client, store: SqlStore, science: Offsets, named: str, worker: Worker, tmp_path: Path
) -> None:
    for method in ("POST", "DELETE", "POST"):
        api.request(method, f"/v1/rotors/r1/diagnoses/{named}/adoption")
    worker.drain()
    file = tmp_path / "r1.zip"
    export_rotor(store, "r1", file, "test")
    import_rotor(store, science, file, "copy")
    worker.drain()
    told = [api.get(f"/v1/rotors/{name}").json() for name in ("r1", "copy")]
    assert told[0]["effects"] == told[1]["effects"]
    assert told[0]["network"] == told[1]["network"]
    assert told[0]["posterior"]["state_digest"] == told[1]["posterior"]["state_digest"]
    copied = api.get("/v1/rotors/copy/adoptions").json()["items"]
    assert [one["what"] for one in copied] == ["adoption", "back-out", "adoption"]
    sent = api.delete(f"/v1/rotors/copy/diagnoses/{named}/adoption")
    assert sent.status_code == 202, "though the diagnosis itself did not travel"


def test_a_file_whose_adoption_does_not_go_on_from_the_network_before_it_is_refused(
    api: httpx.Client, store: SqlStore, science: Offsets, named: str, tmp_path: Path
) -> None:
    api.post(f"/v1/rotors/r1/diagnoses/{named}/adoption")
    file = tmp_path / "r1.zip"
    export_rotor(store, "r1", file, "test")
    with zipfile.ZipFile(file) as archive:
        rows = {
            name: [json.loads(line) for line in archive.read(name).splitlines()]
            for name in bundle.MEMBERS
        }
    body = json.loads(rows["log.jsonl"][12]["body"])
    for change, words in (
        ({"before": {"forgetting_h": 1000.0}}, "another network"),
        ({"number": 2}, "its body says otherwise"),
        ({"after": {"effects": {"biases": [{}]}}}, "network"),
    ):
        from service.digests import digest_of_json

        text_, digest = digest_of_json(body | change)
        log = [*rows["log.jsonl"][:12], rows["log.jsonl"][12] | {"body": text_, "digest": digest}]
        facts = {k: rows["manifest.json"][0][k] for k in ("release", "rotor", "model", "head_seq")}
        other = tmp_path / "other.zip"
        bundle.write(other, facts, rows["rotor.json"][0], rows["blades.jsonl"], log)
        with pytest.raises(BundleError, match=words):
            import_rotor(store, science, other, "copy")


def test_who_adopts_needs_operate_leaves_an_audit_row_and_may_insist_on_what_was_seen(
    serving: Callable[..., AbstractContextManager[httpx.Client]],
    store: SqlStore,
    named: str,
    key: Callable[..., dict[str, str]],
    post: Post,
    reading: Make,
) -> None:
    path = f"/v1/rotors/r1/diagnoses/{named}/adoption"
    with serving(keys="always") as client:
        own = key("read", "operate", name="own")
        seen = client.get("/v1/rotors/r1", headers=own).headers["etag"]
        assert client.post(path, headers=key("read", "ingest")).status_code == 403
        post("r1", reading("late", time_h=4e3, value=0.04))
        assert client.post(path, headers=own | {"If-Match": seen}).status_code == 412
        seen = client.get("/v1/rotors/r1", headers=own).headers["etag"]
        sent = client.post(path, headers=own | {"If-Match": seen})
        assert sent.status_code == 202, sent.text
        assert client.delete(path, headers=key("read")).status_code == 403
        rows = client.get("/v1/audit", headers=own).json()["items"]
        done = [row for row in rows if row["status"] == 202]
        assert done[0]["what"] == "POST /v1/rotors/{r}/diagnoses/{d}/adoption"
        assert done[0]["entries"] == {"first_seq": 14, "last_seq": 14}
        assert done[0]["key"] == sent.json()["adoption"]["posted_by"]


def test_the_option_is_part_of_what_a_rotor_is(api: httpx.Client) -> None:
    body: Json = {"id": "r9", "model": "rotor-blade", "blades": [{"id": "B1"}]}
    assert api.post("/v1/rotors", json=body).json()["adopt"] == "never"
    assert api.post("/v1/rotors", json=body | {"adopt": "never"}).status_code == 201
    assert api.post("/v1/rotors", json=body | {"adopt": "effect"}).status_code == 409
    assert api.post("/v1/rotors", json=body | {"adopt": "always"}).status_code == 422
    twin = Client(http=api)
    twin.create_rotor("r8", blades=["B1"], adopt="effect")
    assert twin.rotor("r8")["adopt"] == "effect"


def command(worker: Worker, diagnoser: Worker, *words: str) -> Any:
    """Run a command against the test's server while workers work beside it."""
    ended = threading.Event()

    def run() -> None:
        while not ended.wait(0.05):
            diagnoser.drain()
            worker.drain()

    beside = threading.Thread(target=run)
    beside.start()
    try:
        return CliRunner().invoke(commands, [*words])
    finally:
        ended.set()
        beside.join()


def test_the_commands_adopt_and_back_out_and_say_so(
    api: httpx.Client, store: SqlStore, off: str, worker: Worker, diagnoser: Worker
) -> None:
    url = ("--url", str(api.base_url))
    before = called(store)
    done = command(worker, diagnoser, "diagnose", "r1", "--adopt", *url)
    assert done.exit_code == 3, done.output
    assert "adopted, with entry 13" in done.stdout
    twin = Client(http=api)
    (first,) = twin.adoptions("r1")
    name = first["diagnosis"]
    done = command(worker, diagnoser, "adopt", "r1", name, "--back-out", "--wait", "120", *url)
    assert done.exit_code == 0, done.output
    assert "backed out with entry 14" in done.stdout
    assert f"{NAME}: " in done.stdout
    assert ": 0.100 ± 0.010 mm added to elongation\n" in done.stdout
    assert called(store) == before
    done = command(worker, diagnoser, "adopt", "r1", name, "--json", *url)
    assert json.loads(done.stdout)["adoption"]["seq"] == 15
    done = command(worker, diagnoser, "diagnose", "r1", "--adopt", *url)
    assert done.exit_code == 0, done.output
    assert "nothing to adopt: the verdict is adequate" in done.stdout
    with pytest.raises(ProblemError, match="404"):
        twin.back_out("r1", "zz")
    assert twin.adopt("r1", name)["head_seq"] == 15


class Unfit(Offsets):
    """Its posterior with an offset in the model cannot be computed."""

    def update(self, card: Any, *given: Any, **named: Any) -> Any:
        if card.network.biases:
            raise ValueError("no particle is left")
        return super().update(card, *given, **named)


def test_backing_out_frees_a_rotor_that_the_adoption_blocked(
    api: httpx.Client, store: SqlStore, settings: Settings, named: str
) -> None:
    """It stayed blocked by an entry that was undone, until somebody tried it again as well."""
    before = called(store)
    once = settings.model_copy(update={"max_attempts": 1})
    worker = make_worker(store, Unfit(), once, "unfit")
    where = f"/v1/rotors/r1/diagnoses/{named}/adoption"
    api.post(where).raise_for_status()
    worker.drain()
    told = api.get("/v1/rotors/r1").json()
    assert (told["status"], told["last_error"]["event"]) == ("blocked", "adoption/1")
    api.delete(where).raise_for_status()
    worker.drain()
    told = api.get("/v1/rotors/r1").json()
    assert (told["status"], told["applied_seq"]) == ("current", 14)
    assert called(store) == before


@pytest.mark.parametrize("option", ["effect", "never"])
def test_the_command_says_that_the_rotor_adopted_by_itself_what_was_found(
    api: httpx.Client,
    store: SqlStore,
    settings: Settings,
    post: Post,
    reading: Make,
    worker: Worker,
    diagnoser: Worker,
    option: str,
) -> None:
    """Whoever asked for it looks at a rotor whose model is another one since."""
    automatic(store, settings, post, reading, option)
    done = command(worker, diagnoser, "diagnose", "r1", "--url", str(api.base_url))
    assert done.exit_code == 3, done.output
    line = "  the rotor adopted it by itself, with entry 13"
    assert (line in done.stdout.splitlines()) is (option == "effect")


def test_the_command_backs_out_what_came_with_an_imported_rotor(
    api: httpx.Client,
    store: SqlStore,
    science: Offsets,
    named: str,
    worker: Worker,
    diagnoser: Worker,
    tmp_path: Path,
) -> None:
    """The diagnosis itself did not travel; the command asked for its result, and ended there."""
    api.post(f"/v1/rotors/r1/diagnoses/{named}/adoption")
    worker.drain()
    export_rotor(store, "r1", tmp_path / "r1.zip", "test")
    import_rotor(store, science, tmp_path / "r1.zip", "copy")
    url = ("--url", str(api.base_url))
    done = command(worker, diagnoser, "adopt", "copy", named, "--back-out", *url)
    assert done.exit_code == 0, done.output
    assert "rotor copy: backed out with entry 14" in done.stdout
    assert f"{NAME}: 0.100 ± 0.010 mm added to elongation" in done.stdout
    done = command(worker, diagnoser, "adopt", "copy", "zz", "--back-out", *url)
    assert done.exit_code == 1, "never adopted"


def test_the_command_tells_of_a_discrepancy_that_was_adopted() -> None:
    """It has no amplitude: the command adopted it, and ended with a KeyError."""
    wide = {"quantity": "elongation", "share": 0.4, "time_h": 5e4, "borne_out": True}
    effects = told_effects({"verdict": "unattributed", "widened": wide, "effects": []})
    entry = {"what": "adoption", "seq": 13, "effects": effects, "readings_since": 0}
    assert [*lines_of("r1", entry, {"verdict": "unattributed"})] == [
        "rotor r1: adopted with entry 13",
        "  discrepancy (elongation): 40% of the variance at 50,000 h, without a cause",
    ]


@pytest.mark.parametrize("borne_out", [True, False])
def test_a_discrepancy_that_is_borne_out_is_not_adopted_unasked_and_told(borne_out: bool) -> None:
    """`--adopt` adopts what is named; what has no name but widens bands is somebody's decision."""
    result = {"verdict": "unattributed", "widened": {"borne_out": borne_out}}
    said = adopted_line({"rotor": "r1", "id": "d7", "result": result})
    if borne_out:
        assert "a discrepancy without a cause is borne out: bladetwin adopt r1 d7" in said
    else:
        assert said == "nothing to adopt: the verdict is unattributed"
