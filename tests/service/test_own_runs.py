"""A model that is no blade and no creep, from a table of runs to bands, over HTTP."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import zipfile
from collections.abc import Callable, Iterator
from contextlib import closing
from io import BytesIO
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from sqlalchemy import func, select, update

from core.archive import trial
from core.archive.table import convert_table
from core.errors import InputError, ModelError
from service.bootstrap import make_worker
from service.client import Client, ProblemError, transports
from service.fake import FakeScience
from service.handlers.models import (
    HDF5,
    find_job,
    find_model,
    register_builtins,
    register_trained,
    request_training,
)
from service.handlers.rotors import create_rotor, view_rotor
from service.handlers.transfer_in import import_rotor
from service.handlers.transfer_out import export_rotor
from service.packed import pack
from service.ports import BladeRecord
from service.science import CoreScience
from service.settings import Settings
from service.store import tables as t
from service.store.engine import now_s, open_engine, transaction
from service.store.unit_of_work import SqlStore
from service.worker.claiming import Role
from service.worker.supervise import Supervisor
from tests import exchanger
from tests.core.test_trial import endless
from tests.patience import until
from tests.service.conftest import RunningServer, served
from tests.service.test_api import refuse
from tests.service.test_processes import ROOT, Make, Post

ROUGH = {"E1": 2.6, "E2": 4.1, "E3": 6.2, "E4": 7.7}
RATE = 8.3e-5
TRUTH = {name: np.array([r, RATE]) for name, r in ROUGH.items()}
HOURS = (500.0, 2000.0, 5000.0, 9000.0)


@pytest.fixture
def own_store(settings: Settings) -> Iterator[SqlStore]:
    opened = SqlStore(open_engine(settings.database_url))
    yield opened
    opened.close()


@pytest.fixture
def real(own_store: SqlStore) -> CoreScience:
    science = CoreScience(files=own_store.blob)
    register_builtins(own_store, science)
    return science


@pytest.fixture
def http(
    own_store: SqlStore, real: CoreScience, settings: Settings, server: RunningServer
) -> Iterator[httpx.Client]:
    with served(own_store, real, settings, server) as client:  # type: ignore[arg-type]
        yield client


@pytest.fixture(scope="module")
def artefact(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The exchanger's model, trained once for those who ask for no training."""
    file = exchanger.stored(exchanger.dataset(), tmp_path_factory.mktemp("runs") / "runs.nc")
    given = (exchanger.network(), file.read_bytes(), (), {"archive": {"bytes": 1}})
    return CoreScience().train("exchanger", *given, lambda *told: None)[1]


def send(http: httpx.Client, file: Path, network: str = exchanger.NETWORK, **more: str) -> Any:
    files = {"runs": ("runs.nc", file.read_bytes()), "network": ("network.yaml", network)}
    return http.post("/v1/models", data={"id": "exchanger", **more}, files=files)


def trained(http: httpx.Client, store: SqlStore, science: CoreScience, settings: Settings) -> Any:
    """The last job, after a diagnosing worker had its turn."""
    make_worker(store, science, settings, role="diagnose").drain()
    with store.read() as tx:
        newest = select(t.job.c.id).order_by(t.job.c.created_at.desc()).limit(1)
        job = tx.connection.execute(newest).scalar()
    return http.get(f"/v1/jobs/{job}").json()


def blobs(store: SqlStore) -> int:
    with store.read() as tx:
        query = select(func.count(t.blob.c.sha256.distinct()))
        return int(tx.connection.execute(query).scalar() or 0)


def covered(twin: Client, truth: dict[str, np.ndarray[Any, Any]]) -> dict[str, float]:
    """|mean − truth| / sd of the shared rate and of each exchanger's roughness."""
    found = twin.posterior("station")["parameters"]["fouling_rate"]
    off = {"fouling_rate": abs(found["mean"] - RATE) / found["sd"]}
    for name, x in truth.items():
        own = twin.posterior("station", name)["parameters"]["roughness"]
        off[name] = abs(own["mean"] - x[0]) / own["sd"]
    return off


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
def test_a_table_of_runs_becomes_a_model_whose_posterior_covers_the_truth_and_predicts(
    http: httpx.Client,
    own_store: SqlStore,
    real: CoreScience,
    settings: Settings,
    tmp_path: Path,
) -> None:
    table = exchanger.write_table(tmp_path / "runs.csv", exchanger.points())
    told = convert_table(table, tmp_path / "runs.nc")
    assert told == {"runs": 24, "inputs": ["roughness", "fouling_rate"], "quantities": ["drop"]}
    answer = send(http, tmp_path / "runs.nc")
    assert answer.status_code == 202, answer.text
    assert answer.json()["job"]["status"] == "queued"
    assert blobs(own_store) == 1, "the runs are stored before the answer"
    job = trained(http, own_store, real, settings)
    assert job["status"] == "done", job
    assert job["result"]["quality"]["drop"]["verdict"] == "good"
    assert blobs(own_store) == 1, "the artefact is kept, the runs are not"

    card = http.get("/v1/models/exchanger").json()
    assert card["version"] == job["result"]["version"]
    assert card["outputs"] == {"drop": {"unit": "kPa", "kind": "scalar"}}
    assert card["node_count"] == 0
    quality = card["summary"]["quality"]["drop"]
    assert quality["rms"] < 0.05 * quality["noise"] + 0.1
    assert card["summary"]["archive"]["bytes"] == (tmp_path / "runs.nc").stat().st_size

    twin = Client(http=http)
    twin.create_rotor("station", model="exchanger", blades=[*ROUGH], particles=1024)
    twin.post_inspections("station", exchanger.readings(TRUTH, HOURS, 0.3, seed=5))
    make_worker(own_store, real, settings).drain()
    assert twin.rotor("station")["posterior"]["sealed"]
    off = covered(twin, TRUTH)
    assert max(off.values()) < 3.0, off
    for name, x in TRUTH.items():
        band = twin.prediction("station", name, "drop", times=[16_000.0], probability=0.99)
        assert band["unit"] == "kPa"
        true = float(exchanger.drop(x, np.array(16_000.0)))
        assert band["lower"][0] < true < band["upper"][0], name

    # negative control: readings of a station with other water are not covered by this truth
    other = {name: np.array([x[0], 2 * RATE]) for name, x in TRUTH.items()}
    twin.create_rotor("elsewhere", model="exchanger", blades=[*ROUGH], particles=1024)
    twin.post_inspections("elsewhere", exchanger.readings(other, HOURS, 0.3, seed=5))
    make_worker(own_store, real, settings).drain()
    found = twin.posterior("elsewhere")["parameters"]["fouling_rate"]
    assert abs(found["mean"] - RATE) > 6 * found["sd"]
    assert abs(found["mean"] - 2 * RATE) < 3 * found["sd"]

    # another process finds the model in the database alone
    again = SqlStore(open_engine(settings.database_url))
    fresh = CoreScience(files=again.blob)
    late = {"id": "late", "blade": "E1", "quantity": "drop", "time_h": 15_000.0}
    value = float(exchanger.drop(TRUTH["E1"], np.array(15_000.0)))
    twin.post_inspections("station", [late | {"value": value}])
    make_worker(again, fresh, settings).drain()
    again.close()
    assert twin.rotor("station")["applied_seq"] == 17


CLOGGED = {
    "name": "clogged gauge",
    "sentence": "The gauge of one exchanger reads too much.",
    "target": "reading",
    "of": "drop",
    "how": "plus",
    "size": 1.0,
    "sign": 0,
    "shapes": ["constant"],
    "whom": ["blade"],
    "clock": "blade",
    "kind": "sensor",
}


ROUGHER = CLOGGED | {
    "name": "rougher tubes",
    "sentence": "The tubes are rougher than they were declared.",
    "target": "input",
    "of": "roughness",
    "how": "times",
    "size": 0.1,
    "shapes": ["constant", "linear"],
    "whom": ["all"],
    "kind": "physics",
}


def test_a_diagnosis_of_other_physics_asks_for_families_and_looks_for_those_it_gets(
    http: httpx.Client,
    own_store: SqlStore,
    real: CoreScience,
    settings: Settings,
    artefact: bytes,
) -> None:
    register_trained(own_store, real, "exchanger", artefact)
    twin = Client(http=http)
    twin.create_rotor("station", model="exchanger", blades=[*ROUGH], particles=512)
    twin.post_inspections("station", exchanger.readings(TRUTH, HOURS, 0.3, seed=5))
    make_worker(own_store, real, settings).drain()
    asked = [twin.diagnose("station", families=own) for own in ([], [CLOGGED], [ROUGHER])]
    make_worker(own_store, real, settings, role="diagnose").drain()
    without, with_one, of_an_input = (twin.diagnosis("station", one["id"]) for one in asked)
    assert (without["status"], without["attempts"]) == ("failed", 1)
    assert "give families of this physics" in without["error"]
    assert (with_one["status"], with_one["result"]["verdict"]) == ("done", "adequate")
    assert of_an_input["error"] is None, "it has no rule in time: its constant course alone is one"
    assert of_an_input["result"]["verdict"] == "adequate"
    (told,) = (f for f in of_an_input["result"]["noticed"]["families"] if f["of"] != "drop")
    assert told["hardest"] == "constant"
    with pytest.raises(ProblemError, match="no simulation run of this model has the creep strain"):
        twin.diagnose("station", families=[ROUGHER | {"shapes": ["linear", "step"]}])
    residuals = twin.residuals("station")
    assert residuals["error"] is None
    assert len(residuals["items"]) == 16


@pytest.mark.parametrize("database_url", ["postgresql"], indirect=True)
def test_every_fault_of_an_archive_is_in_the_job_that_failed_and_nothing_is_left_of_it(
    http: httpx.Client,
    own_store: SqlStore,
    real: CoreScience,
    settings: Settings,
    tmp_path: Path,
) -> None:
    data = exchanger.dataset()
    data["drop"][7, 3] = np.nan
    data["roughness"][2] = 11.0
    data["roughness"].attrs |= {"low": 1.0, "high": 9.0}
    data["fouling_rate"].attrs["units"] = "furlong"
    assert send(http, exchanger.stored(data, tmp_path / "runs.nc")).status_code == 202
    job = trained(http, own_store, real, settings)
    assert (job["status"], job["attempts"]) == ("failed", 1)
    assert [one["field"] for one in job["result"]["faults"]] == [
        "units of fouling_rate", "run 2: roughness", "run 7: drop"
    ]  # fmt: skip
    data["fouling_rate"].attrs["units"] = "1/h"
    assert send(http, exchanger.stored(data, tmp_path / "runs.nc")).status_code == 202
    job = trained(http, own_store, real, settings)
    assert [one["field"] for one in job["result"]["faults"]] == ["run 2: roughness", "run 7: drop"]
    assert blobs(own_store) == 0
    refuse(http.get("/v1/models/exchanger"), 404, "model")
    assert send(http, tmp_path / "runs.nc", leave_out="2, 7").status_code == 202
    job = trained(http, own_store, real, settings)
    assert job["status"] == "done", job
    assert "2, 7" in str(job["result"]["warnings"])


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
def test_a_run_whose_label_holds_a_comma_is_left_out_by_the_client(
    http: httpx.Client,
    own_store: SqlStore,
    real: CoreScience,
    settings: Settings,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It was two labels, and neither was a run's."""
    labels = ["load 1,2", 'bore 5"', *map(str, range(2, 24))]
    data = exchanger.dataset().assign_coords(run=labels)
    file = exchanger.stored(data, tmp_path / "runs.nc")
    monkeypatch.setattr(
        transports.time, "sleep", lambda s: trained(http, own_store, real, settings)
    )
    twin = Client(http=http)
    job = twin.upload_model("exchanger", file, exchanger.NETWORK, leave_out=labels[:2])
    assert job["status"] == "done", job
    (told,) = (one for one in job["result"]["warnings"] if "are left out" in one["problem"])
    assert told["value"] == 'load 1,2, bore 5"'
    long = send(http, file, leave_out="x" * 200_000)
    assert refuse(long, 422)["faults"][0]["field"] == "leave_out"


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
def test_runs_that_would_hang_their_reader_fail_their_job_and_no_worker(
    http: httpx.Client,
    own_store: SqlStore,
    real: CoreScience,
    settings: Settings,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(trial, "LEAST_S", 2.0)
    file = endless(exchanger.stored(exchanger.dataset(), tmp_path / "runs.nc"))
    assert send(http, file).status_code == 202
    job = trained(http, own_store, real, settings)
    assert (job["status"], job["attempts"]) == ("failed", 1)
    (fault,) = job["result"]["faults"]
    assert "is damaged: the HDF5 library did not come to its end" in fault["problem"]
    assert blobs(own_store) == 0


def test_what_is_no_upload_is_refused_at_once_with_every_fault(
    http: httpx.Client, own_store: SqlStore, tmp_path: Path
) -> None:
    text = tmp_path / "runs.nc"
    text.write_text("run,time")
    answer = send(http, text, id="rotor-blade")
    assert answer.status_code == 422
    assert [one["field"] for one in answer.json()["faults"]] == ["id", "runs"]
    refuse(http.post("/v1/models", data={"id": "x y"}, files={"odd": b"1"}), 422, "odd")
    broken = send(http, text, network="{name: n, parameters: [], quantities: [{name: q}]}")
    assert {one["field"] for one in broken.json()["faults"]} > {
        "network.quantities[0].unit",
        "network.parameters",
    }
    refuse(http.post("/v1/models", content=b"x", headers={"content-type": "text/csv"}), 415)
    form = {"content-type": "multipart/form-data; boundary=x"}
    answer = http.post("/v1/models", content=b"--y\r\n", headers=form)
    assert answer.status_code in (400, 422)
    refuse(http.post("/v1/models", content=b"{", headers={"content-type": "application/json"}), 400)
    assert blobs(own_store) == 0


def test_a_body_above_the_limit_names_the_way_for_large_archives(
    serving: Callable[..., Any], tmp_path: Path
) -> None:
    file = exchanger.stored(exchanger.dataset(), tmp_path / "runs.nc")
    with serving(max_body_mb=0.001) as client:
        answer = send(client, file)
    assert answer.status_code == 413
    assert "bladetwin model register" in answer.json()["faults"][0]["remedy"]


@pytest.mark.parametrize("database_url", ["postgresql"], indirect=True)
def test_runs_outlive_a_worker_that_died_and_another_job_keeps_what_both_name(
    http: httpx.Client,
    own_store: SqlStore,
    real: CoreScience,
    settings: Settings,
    tmp_path: Path,
    long_there: None,
) -> None:
    file = exchanger.stored(exchanger.dataset(), tmp_path / "runs.nc")
    first, second = (send(http, file).json()["job"]["id"] for _ in range(2))
    assert blobs(own_store) == 1, "the same file is kept once"
    with transaction(own_store.engine, write=True) as connection:  # as a killed worker leaves it
        dead = {
            "status": "running",
            "owner": "dead",
            "lease_until": now_s() - 0.01,
            "attempts": 1,
            "fence": 1,
        }
        connection.execute(update(t.job).where(t.job.c.id == first).values(dead))
    worker = make_worker(own_store, real, settings, role="diagnose")
    assert worker.jobs.run_once()
    done = http.get(f"/v1/jobs/{first}").json()
    assert (done["status"], done["attempts"]) == ("done", 2)
    assert blobs(own_store) == 2, "the other job still needs the runs"
    assert worker.jobs.run_once()
    other = http.get(f"/v1/jobs/{second}").json()
    assert other["result"]["version"] == done["result"]["version"]
    assert blobs(own_store) == 1
    assert not make_worker(own_store, real, settings).jobs.run_once(), "trainings are not for all"


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
def test_a_new_upload_is_a_new_version_and_rotors_keep_theirs(
    http: httpx.Client,
    own_store: SqlStore,
    real: CoreScience,
    settings: Settings,
    tmp_path: Path,
) -> None:
    versions = []
    for count in (24, 30, 24):
        file = exchanger.stored(exchanger.dataset(count), tmp_path / f"{count}.nc")
        send(http, file)
        trained(http, own_store, real, settings)
        versions.append(http.get("/v1/models/exchanger").json()["version"])
        body = {"id": f"r{len(versions)}", "model": "exchanger", "blades": [{"id": "E1"}]}
        http.post("/v1/rotors", json=body)
    assert versions[0] == versions[2] != versions[1]
    kept = [http.get(f"/v1/rotors/r{n}").json()["model_version"] for n in (1, 2, 3)]
    assert kept == versions


def test_a_model_that_differs_in_its_families_alone_is_refused_under_the_same_name(
    own_store: SqlStore, real: CoreScience, artefact: bytes, tmp_path: Path
) -> None:
    """They are no part of a version: the new ones were dropped, and nothing said so."""
    with zipfile.ZipFile(BytesIO(artefact)) as packed:
        packed.extractall(tmp_path)
    network = json.loads((tmp_path / "network.json").read_text())
    more = network | {"families": [CLOGGED]}
    (tmp_path / "network.json").write_text(json.dumps(more))
    card = register_trained(own_store, real, "exchanger", artefact)
    with pytest.raises(InputError, match="give the model another id"):
        register_trained(own_store, real, "exchanger", pack(tmp_path))
    assert find_model(own_store, "exchanger") == card
    assert register_trained(own_store, real, "exchanger", artefact) == card
    other = register_trained(own_store, real, "other", pack(tmp_path))
    assert [f.name for f in other.network.families] == [CLOGGED["name"]]


def test_a_rotor_of_another_version_of_a_model_that_is_here_is_told_which_are(
    own_store: SqlStore, real: CoreScience, artefact: bytes, tmp_path: Path, sqlite_template: Path
) -> None:
    """It was told that none of that id is registered."""
    card = register_trained(own_store, real, "exchanger", artefact)
    create_rotor(own_store, "station", "exchanger", [BladeRecord("E1")], 64, 7)
    export_rotor(own_store, "station", tmp_path / "station.zip", "test")
    with zipfile.ZipFile(BytesIO(artefact)) as packed:
        packed.extractall(tmp_path)
    network = json.loads((tmp_path / "network.json").read_text())
    (tmp_path / "network.json").write_text(json.dumps(network | {"name": "another"}))
    shutil.copy(sqlite_template, tmp_path / "elsewhere.db")
    with closing(SqlStore(open_engine(f"sqlite:///{tmp_path / 'elsewhere.db'}"))) as store:
        with pytest.raises(InputError, match="none that is registered here"):
            import_rotor(store, real, tmp_path / "station.zip")
        here = register_trained(store, real, "exchanger", pack(tmp_path)).version
        with pytest.raises(InputError) as caught:
            import_rotor(store, real, tmp_path / "station.zip")
    assert caught.value.value == f"exchanger {card.version}"
    assert caught.value.problem.endswith(f"here; the newest of that id is {here}")


def test_an_artefact_whose_bytes_changed_is_named_and_never_used(
    own_store: SqlStore, real: CoreScience, settings: Settings, artefact: bytes
) -> None:
    from service.commands.replay import _models

    card = register_trained(own_store, real, "exchanger", artefact)
    create_rotor(own_store, "mine", "exchanger", [BladeRecord("B1")], 64, 1)
    create_rotor(own_store, "other", "rotor-blade", [BladeRecord("B1")], 64, 1)
    assert _models(own_store, real) == []
    assert own_store.blob(card.summary["artefact"]) == artefact
    with pytest.raises(ModelError, match="stored model cannot be read"):
        register_trained(own_store, real, "copy", artefact.replace(b'"digest": "', b'"digest": "0'))
    with transaction(own_store.engine, write=True) as connection:
        spoilt = artefact[:-5000] + b"?" + artefact[-4999:]
        connection.execute(update(t.blob).values(data=spoilt))
    (finding,) = _models(own_store, real)
    assert "SHA-256" in finding.problem
    assert _models(own_store, real, "mine") == [finding], "as `verify mine` tells"
    assert _models(own_store, real, "other") == []
    fresh = CoreScience(files=own_store.blob)
    with pytest.raises(ModelError, match="upload the model again"):
        fresh.warm(card)
    make_worker(own_store, fresh, settings).warm()  # others are warmed all the same
    register_trained(own_store, real, "exchanger", artefact)  # the same again mends it
    assert own_store.blob(card.summary["artefact"]) == artefact
    fresh.warm(card)
    assert _models(own_store, real) == []


@pytest.mark.parametrize("database_url", ["postgresql"], indirect=True)
def test_a_training_outlives_its_killed_worker_and_holds_nothing_up(
    store: SqlStore, settings: Settings, reading: Make, post: Post, rotor: str, tmp_path: Path
) -> None:
    twin = FakeScience()
    job = request_training(store, twin, "mine", exchanger.network(), HDF5 + b"runs")

    go_on = tmp_path / "go on"

    def command(owner: str, role: Role) -> list[str]:
        words = ["-m", "tests.service.slow_worker", owner, role, "0.0", str(go_on)]
        return [sys.executable, *words]

    environ = {**settings.environ(), "PYTHONPATH": str(ROOT)}
    trainer = Supervisor(store.engine, ["diagnose"], command, environ)
    others = Supervisor(store.engine, ["apply", "seal"], command, environ)
    trainer.start()
    others.start()
    try:
        until("a step", lambda: (find_job(store, job.id).progress or {}).get("done", 0) >= 1)
        os.kill(trainer.pids()[0], signal.SIGKILL)
        until("a second worker", lambda: find_job(store, job.id).attempts == 2)
        seq = post("r1", reading("i1"))
        until("applying beside it", lambda: view_rotor(store, "r1").rotor.applied_seq == seq)
        assert find_job(store, job.id).status == "running"
        go_on.touch()
        until("its end", lambda: find_job(store, job.id).status == "done")
    finally:
        trainer.stop()
        others.stop()
    ended = find_job(store, job.id)
    assert ended.attempts == 2
    assert (ended.result or {})["model"] == "mine"
    assert find_model(store, "mine").version == (ended.result or {})["version"]
    assert blobs(store) == 1


def test_a_job_that_kills_every_worker_fails_and_leaves_no_runs(
    store: SqlStore, settings: Settings
) -> None:
    twin = FakeScience()
    job = request_training(store, twin, "mine", exchanger.network(), HDF5 + b"runs")
    with transaction(store.engine, write=True) as connection:
        tried = update(t.job).where(t.job.c.id == job.id)
        connection.execute(tried.values(attempts=settings.max_attempts))
    assert make_worker(store, twin, settings, role="diagnose").jobs.run_once()
    assert find_job(store, job.id).status == "failed"
    assert blobs(store) == 0
