"""What a rotor does by itself is decided anew while it is in service; with the exact twin."""

from __future__ import annotations

import threading
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import text
from typer.testing import CliRunner

from core.observation import Inspection
from service import bundle
from service.bundle import BundleError
from service.cli import app
from service.client import Client, ProblemError
from service.errors import DamagedRotorError
from service.handlers.policy import decide
from service.handlers.rotors import view_rotor
from service.handlers.transfer_in import import_rotor
from service.handlers.transfer_out import export_rotor
from service.ports import RotorRecord
from service.settings import Settings
from service.store.engine import transaction
from service.store.log import SqlLog
from service.store.records import SqlRecords
from service.store.unit_of_work import SqlStore
from tests.patience import PATIENCE_S
from tests.service.adopting import Offsets
from tests.service.conftest import RunningServer, served
from tests.service.test_asking import (
    BLADES,
    NAME,
    alarms,
    diagnoses,
    made,
    visit,
)

Make = Callable[..., Inspection]
Post = Callable[..., int]
Follow = Callable[[], None]
POLICY = "/v1/rotors/r1/policy"


@pytest.fixture
def science() -> Offsets:
    return Offsets()


def rotor_of(store: SqlStore) -> RotorRecord:
    return view_rotor(store, "r1").rotor


def off(reading: Make) -> list[Inspection]:
    """Four visits; all that was read in the second is off."""
    return [one for k in range(1, 5) for one in visit(reading, k, 0.2 if k == 2 else 0.0)]


def test_a_rotor_that_was_silent_is_told_to_ask_and_does_so_without_another_reading(
    store: SqlStore, post: Post, reading: Make, follow: Follow
) -> None:
    made(store, "never")
    post("r1", *off(reading))
    follow()
    assert alarms(store) > 0
    assert diagnoses(store) == []
    decide(store, "r1", None, "alarm")
    follow()
    (one,) = diagnoses(store)
    assert (one.status, (one.result or {})["names"]) == ("done", [NAME])
    assert rotor_of(store).adopts == "never", "what was left out stays"
    assert view_rotor(store, "r1").adopted.effects == []
    decide(store, "r1", "effect", None)
    follow()
    assert len(diagnoses(store)) == 1, "what was asked for once is not asked for again"


def test_without_judging_what_stands_it_would_wait(
    store: SqlStore,
    post: Post,
    reading: Make,
    follow: Follow,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The mutant: residuals stay judged by the policy of before."""
    real = SqlRecords.put_policy

    def put_policy(self: SqlRecords, *given: Any) -> None:
        real(self, *given)
        self._connection.execute(text("UPDATE residual SET judged = version"))

    monkeypatch.setattr(SqlRecords, "put_policy", put_policy)
    made(store, "never")
    post("r1", *off(reading))
    follow()
    decide(store, "r1", None, "alarm")
    follow()
    assert diagnoses(store) == []


@pytest.mark.parametrize(("before", "then"), [("effect", "never"), ("never", "effect")])
def test_a_diagnosis_under_way_is_judged_by_what_is_decided_when_it_ends(
    store: SqlStore,
    post: Post,
    reading: Make,
    follow: Follow,
    monkeypatch: pytest.MonkeyPatch,
    before: Any,
    then: Any,
) -> None:
    """Whoever operates a rotor can stop it up to the end."""
    made(store, "alarm", before)
    post("r1", *off(reading))
    real = Offsets.diagnose

    def diagnose(self: Offsets, *given: Any, **more: Any) -> Any:
        found = real(self, *given, **more)
        decide(store, "r1", then, None)
        return found

    monkeypatch.setattr(Offsets, "diagnose", diagnose)
    follow()
    assert [job.status for job in diagnoses(store)] == ["done"]
    names = [effect["name"] for effect in view_rotor(store, "r1").adopted.effects]
    assert names == ([NAME] if then == "effect" else [])


def test_a_rotor_that_is_told_to_stop_asks_for_nothing_more(
    store: SqlStore, post: Post, reading: Make, follow: Follow
) -> None:
    made(store, "readings", "effect")
    decide(store, "r1", None, "never")
    post("r1", *off(reading))
    follow()
    assert alarms(store) > 0
    assert diagnoses(store) == []


def test_over_http(api: httpx.Client, store: SqlStore) -> None:
    body = {"id": "r1", "model": "rotor-blade", "blades": [{"id": b} for b in BLADES]}
    first = api.post("/v1/rotors", json=body | {"adopt": "effect"})
    told = api.get("/v1/rotors/r1").json()
    assert (told["adopt"], told["diagnose"], told["policy_since"]) == ("effect", "never", None)
    answer = api.post(POLICY, json={"diagnose": "readings"})
    assert answer.status_code == 200
    now = answer.json()
    assert (now["adopt"], now["diagnose"]) == ("effect", "readings")
    assert now["policy_since"] >= told["created_at"]
    assert api.get("/v1/rotors/r1").json()["policy_since"] == now["policy_since"]
    (listed,) = api.get("/v1/rotors").json()["items"]
    assert listed == now | {"sealed": None, "health": None}, "no state was made yet"
    assert api.post(POLICY, json={"adopt": "effect"}).json() == now, "nothing new is decided"
    again = api.post("/v1/rotors", json=body | {"adopt": "effect"})
    assert again.json() == first.json(), "the same creation, whatever was decided since"
    assert api.post("/v1/rotors", json=body | {"diagnose": "readings"}).status_code == 409
    head = told["head_seq"], told["version"]
    assert (now["head_seq"], now["version"]) == head, "no posterior rests on it"
    for wrong in ({}, {"adopt": None}, {"adopt": "always"}, {"diagnose": 1}, {"x": "never"}):
        assert api.post(POLICY, json=wrong).status_code == 422, wrong
    assert "nothing is decided" in api.post(POLICY, json={}).text
    assert api.post("/v1/rotors/zz/policy", json={"adopt": "never"}).status_code == 404
    assert rotor_of(store).asks == "readings"


def test_by_client_and_command(store: SqlStore, science: Offsets, settings: Settings) -> None:
    made(store, "alarm")
    server = RunningServer()
    with served(store, science, settings, server) as http:
        twin = Client(http=http)
        assert twin.set_policy("r1", adopt="effect")["diagnose"] == "alarm"
        with pytest.raises(ProblemError, match="adopt"):
            twin.set_policy("r1", adopt="always")
        url = ["--url", str(http.base_url)]

        def said(*given: str) -> str:
            done = CliRunner().invoke(app, ["policy", "r1", *given, *url])
            assert done.exit_code == 0, done.output
            return done.output

        since = str(twin.rotor("r1")["policy_since"])
        assert since in said()
        assert "where its residuals alarm\n" in said()
        assert "adopts an effect" in said()
        assert "adopts nothing by itself" in said("--adopt", "never", "--diagnose", "readings")
        assert '"diagnose": "readings"' in said("--json")
        refused = CliRunner().invoke(app, ["policy", "r1", "--diagnose", "daily", *url])
        assert refused.exit_code == 1
        assert "diagnose = 'daily'" in str(refused.exception)
    server.stop()


def test_it_leaves_with_the_rotor_and_comes_back_under_any_name(
    store: SqlStore,
    science: Offsets,
    tmp_path: Path,
) -> None:
    made(store, "alarm", "effect")
    decide(store, "r1", "never", "readings")
    was, file = rotor_of(store), tmp_path / "r1.zip"
    export_rotor(store, "r1", file, "test")
    copy = import_rotor(store, science, file, "copy").rotor
    assert (copy.adopt, copy.diagnose, copy.adopts, copy.asks) == (
        *("effect", "alarm"),
        *("never", "readings"),
    )
    assert copy.policy is not None
    assert was.policy is not None
    assert copy.policy.at == was.policy.at
    assert copy.policy.digest != was.policy.digest, "it has the rotor's name in it"
    view_rotor(store, "copy")  # is sound
    again = tmp_path / "again.zip"
    export_rotor(store, "copy", again, "test")
    assert not import_rotor(store, science, again).new


def test_a_file_whose_policy_was_changed_is_refused(
    store: SqlStore,
    science: Offsets,
    tmp_path: Path,
) -> None:
    made(store, "alarm", "never")
    decide(store, "r1", None, "readings")
    good, bad = tmp_path / "good.zip", tmp_path / "bad.zip"
    export_rotor(store, "r1", good, "test")
    with zipfile.ZipFile(good) as there:
        assert b'"policy"' in there.read("rotor.json")
    with open(good, "rb") as handle:
        file = bundle.opened(good, handle)
        rotor = next(iter(file.rows("rotor.json")))
        blades, log = list(file.rows("blades.jsonl")), list(file.rows("log.jsonl"))
        rotor["policy"]["adopt"] = "effect"
        keep = ("release", "rotor", "model", "head_seq", "state")
        facts = {name: file.manifest[name] for name in keep}
        bundle.write(bad, facts, rotor, iter(blades), iter(log))
    with pytest.raises(BundleError, match=r"the policy in rotor\.json does not have its digest"):
        import_rotor(store, science, bad, "copy")


@pytest.mark.parametrize(
    "change",
    [
        "adopt_now = 'effect'",
        "diagnose_now = 'never'",
        "policy_at = policy_at + 1",
        "policy_digest = 'x'",
        "policy_digest = NULL",
    ],
)
def test_one_that_is_not_as_it_was_written_is_refused_until_it_is_decided_anew(
    store: SqlStore, tmp_path: Path, change: str
) -> None:
    made(store, "never", "never")
    decide(store, "r1", None, "alarm")
    with transaction(store.engine, write=True) as connection:
        connection.execute(text(f"UPDATE rotor SET {change}"))
    with pytest.raises(DamagedRotorError, match="what it does by itself"):
        view_rotor(store, "r1")
    with pytest.raises(DamagedRotorError, match="what it does by itself"):
        export_rotor(store, "r1", tmp_path / "x.zip", "test")
    with pytest.raises(DamagedRotorError, match="both options"):
        decide(store, "r1", None, "alarm")
    decide(store, "r1", "never", "alarm")
    assert (rotor_of(store).adopts, rotor_of(store).asks) == ("never", "alarm")


def test_a_row_with_half_a_policy_ends_no_list(api: httpx.Client, store: SqlStore) -> None:
    made(store, "never", "never")
    with transaction(store.engine, write=True) as connection:
        connection.execute(text("UPDATE rotor SET diagnose_now = 'alarm'"))
    assert api.get("/v1/rotors").status_code == 200
    assert api.get("/v1/rotors/r1").status_code == 503
    told = api.post(POLICY, json={"adopt": "never", "diagnose": "alarm"})
    assert told.status_code == 200, told.text
    assert api.get("/v1/rotors/r1").json()["diagnose"] == "alarm"


def at_once(
    store: SqlStore, monkeypatch: pytest.MonkeyPatch, patience_s: float = 0.5
) -> tuple[str, str]:
    """Two decide at the same time, each of one option; what is in force then.

    Each waits so long for the other, if it is let in beside it.
    """
    made(store, "never", "never")
    both, real = threading.Barrier(2), SqlRecords.put_policy

    def put_policy(self: SqlRecords, *given: Any) -> None:
        with suppress(threading.BrokenBarrierError):
            both.wait(patience_s)
        real(self, *given)

    monkeypatch.setattr(SqlRecords, "put_policy", put_policy)
    asked: tuple[tuple[Any, Any], ...] = (("effect", None), (None, "alarm"))
    threads = [threading.Thread(target=decide, args=(store, "r1", *one)) for one in asked]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    now = rotor_of(store)
    return now.adopts, now.asks


def test_two_who_decide_at_once_lose_nothing(
    store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert at_once(store, monkeypatch) == ("effect", "alarm")


def test_without_the_rotor_s_lock_one_of_them_is_lost(
    store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mutant; on SQLite nothing is lost without it, for it has one writer at a time."""
    monkeypatch.setattr(SqlLog, "lock", lambda self, rotor_id: 0)
    one_writer = store.engine.dialect.name == "sqlite"
    kept = at_once(store, monkeypatch, 0.5 if one_writer else PATIENCE_S) == ("effect", "alarm")
    assert kept == one_writer
