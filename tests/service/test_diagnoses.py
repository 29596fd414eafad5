"""Diagnoses over HTTP and through the worker, with the exact twin; once with the real science."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator, MutableMapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from copy import copy
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import Engine, select, true, update
from typer.testing import CliRunner

from core.family import Family
from core.observation import Inspection
from service.bootstrap import make_worker
from service.cli import app as commands
from service.client import Client, ProblemError
from service.errors import LostLeaseError, StoreAwayError
from service.fake import FakeScience
from service.handlers.diagnoses import cancel_diagnosis, find_diagnosis, request_diagnosis
from service.handlers.rotors import create_rotor
from service.ports import BladeRecord, Json, ModelCard, Progress, RotorSpec
from service.processes import worker_roles
from service.settings import Settings
from service.store import tables as t
from service.store.engine import now_s, transaction
from service.store.unit_of_work import SqlStore, SqlTransaction
from service.worker import heed, job_lease, jobs
from service.worker.heartbeat import heartbeats
from service.worker.job_lease import JobLease, beat_job, claim_job
from service.worker.jobs import Jobs
from service.worker.lease import release
from service.worker.loop import Worker
from tests.patience import AGES_S, until

Make = Callable[..., Inspection]
Post = Callable[..., int]
FAMILY = {
    "name": "sagging fixture",
    "sentence": "a fixture of the gauge gives way",
    "target": "reading",
    "of": "elongation",
    "how": "plus",
    "size": 0.01,
    "sign": 1,
    "shapes": ["linear"],
    "whom": ["instrument"],
    "clock": "rotor",
    "kind": "sensor",
}


class Stepped(FakeScience):
    """The twin; `at(done)` is called after each step was told."""

    at: Callable[[int], None]

    def diagnose(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        facts: Sequence[BladeRecord],
        readings: Sequence[Inspection],
        families: Sequence[Json],
        compare_h: float | None,
        progress: Progress,
        kept: MutableMapping[str, Any],
        heed: Callable[[], None],
    ) -> Json:
        def told(what: str, done: int, total: int) -> None:
            progress(what, done, total)
            self.at(done)

        asked = (card, rotor, facts, readings, families, compare_h)
        return super().diagnose(*asked, told, kept, heed)


def stepped(at: Callable[[int], None]) -> Stepped:
    science = Stepped()
    object.__setattr__(science, "at", at)
    return science


@pytest.fixture
def straight(rotor: str, post: Post, reading: Make) -> str:
    """A rotor whose blades elongate along lines."""
    rates = {"B1": 0.5, "B2": 0.6, "B3": 0.7}
    post(rotor, *_lines(reading, rates, {}))
    return rotor


def _lines(reading: Make, rates: dict[str, float], off: dict[float, float]) -> list[Inspection]:
    return [
        reading(f"{b}-{h:g}", blade=b, time_h=h, value=rate * h / 5e4 + off.get(h, 0.0))
        for b, rate in rates.items()
        for h in (8e3, 16e3, 24e3)
    ]


def test_a_diagnosis_is_queued_run_and_answered_with_what_it_rests_on(
    api: httpx.Client, straight: str, diagnoser: Worker, worker: Worker
) -> None:
    sent = api.post("/v1/rotors/r1/diagnoses", json={"families": [FAMILY], "horizon_h": 40_000})
    assert sent.status_code == 202, sent.text
    told = sent.json()["diagnosis"]
    where = f"/v1/rotors/r1/diagnoses/{told['id']}"
    assert sent.headers["location"] == where
    assert (told["status"], told["result"], told["progress"]) == ("queued", None, None)
    assert told["request"]["through_seq"] == 9
    diagnoser.drain()
    done = api.get(where).json()
    assert (done["status"], done["error"], done["attempts"]) == ("done", None, 1)
    found = done["result"]
    assert found["verdict"] == "adequate"
    assert found["readings"] == {"delivered": 9, "used": 9}
    rests = found["rests_on"]
    assert (rests["rotor"], rests["through_seq"], rests["particles"]) == ("r1", 9, 64)
    worker.drain()
    posterior = api.get("/v1/rotors/r1").json()["posterior"]
    assert rests["events_digest"] == posterior["events_digest"], "the same readings"
    assert rests["model_digest"] == found["models"]["before"]


def test_readings_off_their_line_are_not_adequate(
    api: httpx.Client, rotor: str, post: Post, reading: Make, diagnoser: Worker
) -> None:
    """The negative control of the straight rotor: the second visit reads 0.1 mm too much."""
    post(rotor, *_lines(reading, {"B1": 0.5, "B2": 0.6}, {16e3: 0.1}))
    told = api.post("/v1/rotors/r1/diagnoses").json()["diagnosis"]
    diagnoser.drain()
    found = api.get(f"/v1/rotors/r1/diagnoses/{told['id']}").json()["result"]
    assert found["verdict"] == "unattributed"
    assert found["p"] < 1e-3


def test_progress_is_told_step_by_step_with_the_time_left(
    store: SqlStore, settings: Settings, straight: str, science: FakeScience
) -> None:
    job, _ = request_diagnosis(store, science, "r1", (), compare=True, horizon_h=None)
    seen: list[Json | None] = []
    watching = stepped(lambda done: seen.append(find_diagnosis(store, "r1", job.id).progress))
    make_worker(store, watching, settings, "d", "diagnose").drain()
    assert [(one or {})["done"] for one in seen] == [0, 1, 2]
    assert seen[0] == {"what": "blade B1", "done": 0, "total": 3, "seconds_left": None}
    assert (seen[1] or {})["seconds_left"] >= 0
    assert find_diagnosis(store, "r1", job.id).progress is None, "a diagnosis that ended has none"


def test_the_same_question_about_the_same_log_is_one_diagnosis_while_it_is_under_way(
    api: httpx.Client, straight: str, diagnoser: Worker, post: Post, reading: Make
) -> None:
    def asked(body: Json | None = None) -> tuple[str, bool]:
        sent = api.post("/v1/rotors/r1/diagnoses", json=body)
        return sent.json()["diagnosis"]["id"], "idempotent-replayed" in sent.headers

    first, replayed = asked()
    assert not replayed
    assert asked({"compare": True, "families": [], "horizon_h": 50_000}) == (first, True)
    other, replayed = asked({"compare": False})
    assert (other != first, replayed) == (True, False)
    post("r1", reading("late", blade="B1", time_h=32e3, value=0.32))
    later, replayed = asked()
    assert (later not in (first, other), replayed) == (True, False)
    diagnoser.drain()
    again, replayed = asked()
    assert (again not in (first, other, later), replayed) == (True, False)


def test_pages_run_from_the_newest_to_the_oldest_without_results(
    api: httpx.Client, straight: str, diagnoser: Worker
) -> None:
    ids = []
    for k in range(5):
        sent = api.post("/v1/rotors/r1/diagnoses", json={"horizon_h": 1000.0 * (k + 1)})
        ids.append(sent.json()["diagnosis"]["id"])
    diagnoser.drain()
    page = api.get("/v1/rotors/r1/diagnoses", params={"limit": 2}).json()
    assert [one["id"] for one in page["items"]] == sorted(ids, reverse=True)[:2]
    assert "result" not in page["items"][0]
    assert page["items"][0]["verdict"] == "adequate"
    twin = Client(http=api)
    assert {one["id"] for one in twin.diagnoses("r1")} == set(ids)
    rest = api.get("/v1/rotors/r1/diagnoses", params={"limit": 9, "cursor": page["next"]}).json()
    assert ([one["id"] for one in rest["items"]], rest["next"]) == (
        sorted(ids, reverse=True)[2:],
        None,
    )


def test_a_running_diagnosis_that_is_cancelled_stops_at_its_next_step(
    api: httpx.Client, store: SqlStore, settings: Settings, straight: str
) -> None:
    twin = Client(http=api)
    told = twin.diagnose("r1")
    steps: list[int] = []

    def at(done: int) -> None:
        steps.append(done)
        if done == 1:
            assert twin.cancel_diagnosis("r1", told["id"])["status"] == "cancelled"

    make_worker(store, stepped(at), settings, "d", "diagnose").drain()
    assert steps == [0, 1], "the third step was not begun"
    ended = twin.diagnosis("r1", told["id"])
    assert (ended["status"], ended["result"]) == ("cancelled", None)
    assert twin.cancel_diagnosis("r1", told["id"]) == ended, "again: as it is"
    with store.read() as tx:
        heard = [(n.kind, n.payload) for n in tx.outbox.after("r1", 0, 100) if "diagnos" in n.kind]
    assert heard == [("diagnosis-cancelled", {"diagnosis": told["id"]})], "once"


class Long(FakeScience):
    """A diagnosis of one step, which ends when `heed` says so; `at` is called within it."""

    at: Callable[[], None]
    ended: list[str]

    def diagnose(self, *given: Any) -> Json:
        *_, progress, _, heed = given
        progress("a long step", 0, 1)
        self.at()
        try:
            until("the end of a step that nobody waits for", lambda: heed() and False)
        except Exception as error:
            self.ended.append(type(error).__name__)
            raise
        return super().diagnose(*given)


@pytest.mark.parametrize("why", ["cancelled", "its worker ends", "another worker has it"])
def test_a_diagnosis_that_is_no_more_wanted_ends_within_its_step(
    api: httpx.Client, store: SqlStore, settings: Settings, straight: str, why: str
) -> None:
    told = Client(http=api).diagnose("r1")

    def at() -> None:
        if why == "cancelled":
            Client(http=api).cancel_diagnosis("r1", told["id"])
        elif why == "its worker ends":
            own.stop()
        else:
            with transaction(store.engine, write=True) as connection:
                here = t.job.c.id == told["id"]
                connection.execute(update(t.job).where(here).values(fence=t.job.c.fence + 1))

    science = Long()
    object.__setattr__(science, "at", at)
    object.__setattr__(science, "ended", [])
    own = make_worker(store, science, settings, "d", "diagnose")
    own.run_once()
    assert science.ended == ["StoppedError" if why == "its worker ends" else "LostLeaseError"]
    ended = find_diagnosis(store, "r1", told["id"])
    status = {"cancelled": "cancelled", "its worker ends": "queued"}.get(why, "running")
    assert (ended.status, ended.result) == (status, None)
    assert ended.attempts == (0 if status == "queued" else 1)


def test_a_database_that_is_away_within_a_step_ends_no_diagnosis(
    store: SqlStore,
    settings: Settings,
    straight: str,
    science: FakeScience,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It is asked again, not before its time, and tells of a job that was cancelled."""
    job, _ = request_diagnosis(store, science, "r1", (), compare=True, horizon_h=None)
    lease = claim_job(store.engine, "d", settings.lease_s, "diagnose")
    assert lease is not None
    asked: list[str] = []

    def away(engine: Engine, lease: JobLease) -> None:
        asked.append(lease.id)
        raise StoreAwayError("cannot be reached")

    monkeypatch.setattr(heed, "ASK_S", 0.0)
    monkeypatch.setattr(heed, "still_holds", away)
    own = heed.Heed(store.engine, lease, lambda: False)
    own()
    assert asked == [job.id]
    monkeypatch.undo()
    cancel_diagnosis(store, "r1", job.id)
    monkeypatch.setattr(heed, "ASK_S", AGES_S)
    own()  # not so soon
    monkeypatch.setattr(heed, "ASK_S", 0.0)
    with pytest.raises(LostLeaseError):
        own()


def test_a_diagnosis_that_is_done_is_not_cancelled(
    api: httpx.Client, straight: str, diagnoser: Worker
) -> None:
    twin = Client(http=api)
    told = twin.diagnose("r1")
    diagnoser.drain()
    assert twin.cancel_diagnosis("r1", told["id"])["status"] == "done"


def taken_over(store: SqlStore, settings: Settings, science: FakeScience) -> tuple[str, list[str]]:
    """A diagnosis whose worker loses its lease after its last step, and who finished it."""
    job, _ = request_diagnosis(store, science, "r1", (), compare=True, horizon_h=None)
    finished: list[str] = []

    def at(done: int) -> None:
        if done == 2 and not finished:
            with transaction(store.engine, write=True) as connection:
                over = update(t.job).where(t.job.c.id == job.id).values(lease_until=now_s() - 0.01)
                connection.execute(over)
            second = stepped(lambda done: None)
            make_worker(store, second, settings, "second", "diagnose").drain()
            finished.append(str(find_diagnosis(store, "r1", job.id).finished_at))

    make_worker(store, stepped(at), settings, "first", "diagnose").drain()
    return job.id, finished


def test_a_lost_diagnosis_is_taken_over_and_the_first_workers_result_is_refused(
    store: SqlStore, settings: Settings, straight: str, science: FakeScience, long_there: None
) -> None:
    name, finished = taken_over(store, settings, science)
    ended = find_diagnosis(store, "r1", name)
    assert (ended.status, ended.attempts) == ("done", 2)
    assert [str(ended.finished_at)] == finished, "written once, by the second worker"


@pytest.mark.parametrize(("fenced", "status"), [(True, "running"), (False, "done")])
def test_the_fence_alone_keeps_the_first_worker_from_ending_what_the_second_one_does(
    store: SqlStore,
    settings: Settings,
    straight: str,
    science: FakeScience,
    monkeypatch: pytest.MonkeyPatch,
    fenced: bool,
    status: str,
) -> None:
    """Without the fence, the mutant, it does."""
    if not fenced:
        monkeypatch.setattr(job_lease, "holds", lambda lease: t.job.c.id == lease.id)
    job, _ = request_diagnosis(store, science, "r1", (), compare=True, horizon_h=None)

    def at(done: int) -> None:
        if done == 2:
            with transaction(store.engine, write=True) as connection:
                connection.execute(update(t.job).values(lease_until=now_s() - 0.01))
            assert claim_job(store.engine, "second", 30.0, "diagnose") is not None

    assert make_worker(store, stepped(at), settings, "first", "diagnose").run_once()
    assert find_diagnosis(store, "r1", job.id).status == status


def test_without_the_fence_the_first_worker_would_write_over_it(
    store: SqlStore,
    settings: Settings,
    straight: str,
    science: FakeScience,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The mutant: neither who holds a job is asked nor whether it has ended."""
    monkeypatch.setattr(job_lease, "holds", lambda lease: t.job.c.id == lease.id)
    monkeypatch.setattr(job_lease, "runs", true)
    name, finished = taken_over(store, settings, science)
    assert [str(find_diagnosis(store, "r1", name).finished_at)] != finished


def test_a_heartbeat_prolongs_the_lease_of_its_own_claim_alone(
    store: SqlStore, straight: str, science: FakeScience
) -> None:
    request_diagnosis(store, science, "r1", (), compare=True, horizon_h=None)
    first = claim_job(store.engine, "first", 1e-3, "diagnose")
    assert first is not None
    assert beat_job(store.engine, first, 30.0)
    assert claim_job(store.engine, "second", 30.0, "diagnose") is None, "the lease runs"
    assert release(store.engine, "first") == 0, "no rotor of its own"
    second = claim_job(store.engine, "second", 30.0, "diagnose")
    assert second is not None, "the supervisor ends a dead worker's lease at once"
    assert not beat_job(store.engine, first, 30.0)


def test_a_long_step_keeps_its_lease_by_the_heartbeat(
    store: SqlStore,
    settings: Settings,
    straight: str,
    science: FakeScience,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The lease is over, and a beat prolongs it."""
    often = lambda beat, lease_s, *more: heartbeats(beat, 0.03, *more)  # noqa: E731
    monkeypatch.setattr(jobs, "heartbeats", often)
    request_diagnosis(store, science, "r1", (), compare=True, horizon_h=None)
    claims: list[object] = []

    def lease_runs() -> bool:
        with store.read() as tx:
            return bool(tx.connection.execute(select(t.job.c.lease_until > 1.0)).scalar_one())

    def at(done: int) -> None:
        if done == 0:
            with transaction(store.engine, write=True) as connection:
                connection.execute(update(t.job).values(lease_until=1.0))
            until("a beat", lease_runs)
            claims.append(claim_job(store.engine, "second", 30.0, "diagnose"))

    make_worker(store, stepped(at), settings, "first", "diagnose").drain()
    assert claims == [None]


def test_a_diagnosis_that_kills_its_workers_fails_in_the_end(
    store: SqlStore, settings: Settings, straight: str, science: FakeScience
) -> None:
    job, _ = request_diagnosis(store, science, "r1", (), compare=True, horizon_h=None)
    few = settings.model_copy(update={"max_attempts": 2})
    for _ in range(2):
        assert claim_job(store.engine, "dies", 30.0, "diagnose") is not None
        release(store.engine, "dies")
    make_worker(store, science, few, "d", "diagnose").drain()
    ended = find_diagnosis(store, "r1", job.id)
    assert ended.status == "failed"
    assert "survives" in str(ended.error)
    with store.read() as tx:
        *_, told = tx.outbox.after("r1", 0, 100)
    assert told.kind == "diagnosis-failed"
    assert told.payload == {"diagnosis": job.id, "error": ended.error}


def test_a_diagnosis_whose_end_was_committed_unheard_stays_done(
    store: SqlStore, settings: Settings, straight: str, science: FakeScience
) -> None:
    """The connection breaks between the commit and its answer."""
    job, _ = request_diagnosis(store, science, "r1", (), compare=True, horizon_h=None)
    own = copy(store)

    @contextmanager
    def unheard() -> Iterator[SqlTransaction]:
        with store.write() as tx:
            yield tx
        raise StoreAwayError("ConnectionReset")

    own.write = unheard  # type: ignore[method-assign]
    with pytest.raises(StoreAwayError):
        make_worker(own, science, settings, "d", "diagnose").run_once()
    ended = find_diagnosis(store, "r1", job.id)
    assert (ended.status, ended.attempts) == ("done", 1)
    assert ended.result is not None


def test_a_worker_that_is_stopped_gives_its_diagnosis_back_uncounted(
    store: SqlStore, settings: Settings, straight: str, science: FakeScience
) -> None:
    job, _ = request_diagnosis(store, science, "r1", (), compare=True, horizon_h=None)
    own: list[Worker] = []
    own.append(make_worker(store, stepped(lambda done: own[0].stop()), settings, "d", "diagnose"))
    own[0].drain()
    back = find_diagnosis(store, "r1", job.id)
    assert (back.status, back.attempts, back.progress) == ("queued", 0, None)
    make_worker(store, science, settings, "e", "diagnose").drain()
    assert find_diagnosis(store, "r1", job.id).status == "done"


def stored(store: SqlStore, job: str) -> Any:
    """What the database keeps of a job for whoever has to go on."""
    with transaction(store.engine, write=False) as connection:
        return connection.execute(select(t.job.c.kept).where(t.job.c.id == job)).scalar()


class Noted(FakeScience):
    """The twin; `met` is what it was given of earlier attempts."""

    met: list[Json]

    def diagnose(self, *given: Any) -> Json:
        self.met.append(dict(given[-2]))
        return super().diagnose(*given)


@pytest.mark.parametrize("way", ["killed", "stopped"])
def test_a_diagnosis_goes_on_where_its_worker_was(
    store: SqlStore, settings: Settings, straight: str, science: FakeScience, way: str
) -> None:
    """Of three blades two were looked at when the worker was killed, or asked to stop."""
    job, _ = request_diagnosis(store, science, "r1", (), compare=True, horizon_h=None)
    first: list[Worker] = []

    def at(done: int) -> None:
        if done == 2 and way == "killed":
            raise SystemExit  # nothing is given back
        if done == 1 and way == "stopped":
            first[0].stop()  # before the next step

    first.append(make_worker(store, stepped(at), settings, "first", "diagnose"))
    if way == "killed":
        with pytest.raises(SystemExit):
            first[0].drain()
        release(store.engine, "first")
    else:
        first[0].drain()
    looked_at = {"B1": True, "B2": True}
    assert json.loads(stored(store, job.id)) == looked_at
    second = Noted()
    object.__setattr__(second, "met", [])
    make_worker(store, second, settings, "second", "diagnose").drain()
    assert second.met == [looked_at]
    ended = find_diagnosis(store, "r1", job.id)
    assert (ended.status, ended.attempts) == ("done", 2 if way == "killed" else 1)
    assert stored(store, job.id) is None, "of no use any more"


@pytest.mark.parametrize("role", ["all", "apply", "seal"])
def test_diagnoses_are_left_to_their_own_workers_and_those_do_nothing_else(
    store: SqlStore, settings: Settings, straight: str, science: FakeScience, role: Any
) -> None:
    job, _ = request_diagnosis(store, science, "r1", (), compare=True, horizon_h=None)
    with store.write() as tx:
        tx.records.put_job("short", "register-model", {"builtin": "rotor-blade"})
    diagnoser = Jobs(store, science, settings, "d", "diagnose")
    other = Jobs(store, science, settings, "w", role)
    assert other.run_once()
    assert not other.run_once()
    assert find_diagnosis(store, "r1", job.id).status == "queued"
    make_worker(store, science, settings, "e", "diagnose").drain()
    with store.read() as tx:
        assert tx.records.rotor("r1").version == 0, "a diagnoser applies nothing"
    assert not diagnoser.run_once()
    assert find_diagnosis(store, "r1", job.id).status == "done"


def test_serve_starts_one_diagnoser_unless_told_otherwise() -> None:
    assert worker_roles(Settings()) == ["apply", "seal", "diagnose"]
    assert worker_roles(Settings(sealers=0, diagnosers=2)) == ["all", "diagnose", "diagnose"]
    assert worker_roles(Settings(diagnosers=0)) == ["apply", "seal"]
    assert worker_roles(Settings(workers=0)) == []


def test_a_rotor_without_readings_fails_at_once_and_says_what_to_do(
    api: httpx.Client, rotor: str, diagnoser: Worker
) -> None:
    told = api.post("/v1/rotors/r1/diagnoses").json()["diagnosis"]
    diagnoser.drain()
    ended = api.get(f"/v1/rotors/r1/diagnoses/{told['id']}").json()
    assert (ended["status"], ended["attempts"]) == ("failed", 1)
    assert "post inspections" in ended["error"]


def test_retracted_readings_and_those_that_come_later_do_not_count(
    api: httpx.Client, straight: str, post: Post, reading: Make, diagnoser: Worker
) -> None:
    api.post("/v1/rotors/r1/inspections/B1-8000/retraction")
    told = api.post("/v1/rotors/r1/diagnoses").json()["diagnosis"]
    post("r1", reading("wild", blade="B1", time_h=32e3, value=3.0))
    diagnoser.drain()
    found = api.get(f"/v1/rotors/r1/diagnoses/{told['id']}").json()["result"]
    assert (found["verdict"], found["readings"]["used"]) == ("adequate", 8)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"shapes": ["sudden"]}, "shapes"),
        ({"whom": []}, "whom"),
        ({"size": -1.0}, "size"),
        ({"size": None, "how": "times"}, "size"),
        ({"target": "input"}, "whom"),
        ({"of": "colour"}, "of"),
        ({"name": "fouling"}, "name"),
        ({"shapes": ["linear", "step", "linear"]}, "shapes"),
        ({"whom": ["instrument", "instrument"]}, "whom"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_a_family_that_is_none_is_refused_by_its_field(
    api: httpx.Client, straight: str, change: Json, field: str
) -> None:
    sent = api.post("/v1/rotors/r1/diagnoses", json={"families": [FAMILY | change]})
    assert sent.status_code == 422, sent.text
    assert field in sent.json()["faults"][0]["field"]
    assert api.get("/v1/rotors/r1/diagnoses").json()["items"] == []


def test_a_family_is_told_which_cause_it_shares_and_how_it_may_be_called(
    api: httpx.Client, straight: str
) -> None:
    families = [FAMILY | {"cause": "wrong zero"}, FAMILY | {"name": "sag 2"}]
    sent = api.post("/v1/rotors/r1/diagnoses", json={"families": families})
    assert sent.status_code == 202, sent.text
    assert sent.json()["diagnosis"]["request"]["families"] == families
    [of_cause, bare] = [Family.from_json(one) for one in families]
    assert (of_cause.to_json(), bare.cause) == (families[0], "")
    refused = api.post("/v1/rotors/r1/diagnoses", json={"families": [FAMILY | {"name": "sag.2"}]})
    [fault] = refused.json()["faults"]
    assert fault["remedy"] == "use letters, digits, blanks and _ + -, a letter or a digit first"


def test_an_hour_beyond_the_model_is_refused_with_the_hours_it_covers(
    api: httpx.Client, straight: str
) -> None:
    for hour in (0.0, -1.0, 60_000.0):
        sent = api.post("/v1/rotors/r1/diagnoses", json={"horizon_h": hour})
        assert sent.status_code == 422
        assert "0 … 50000 h" in sent.json()["detail"]


def test_an_unknown_rotor_and_anothers_diagnosis_are_not_there(
    api: httpx.Client, straight: str, store: SqlStore
) -> None:
    told = api.post("/v1/rotors/r1/diagnoses").json()["diagnosis"]
    create_rotor(store, "r2", "rotor-blade", [BladeRecord("B1")], 64, 7)
    for method, path in (
        ("POST", "/v1/rotors/zz/diagnoses"),
        ("GET", "/v1/rotors/zz/diagnoses"),
        ("GET", "/v1/rotors/r1/diagnoses/zz"),
        ("GET", f"/v1/rotors/r2/diagnoses/{told['id']}"),
        ("DELETE", f"/v1/rotors/r2/diagnoses/{told['id']}"),
        ("DELETE", "/v1/rotors/r1/diagnoses/zz"),
        ("GET", f"/v1/jobs/{told['id']}"),
    ):
        assert api.request(method, path).status_code == 404, (method, path)
    assert api.get(f"/v1/rotors/r1/diagnoses/{told['id']}").json()["status"] == "queued"


def test_a_key_for_one_rotor_sees_no_diagnosis_of_another_by_any_path(
    serving: Callable[..., AbstractContextManager[httpx.Client]],
    straight: str,
    store: SqlStore,
    science: FakeScience,
    key: Callable[..., dict[str, str]],
) -> None:
    create_rotor(store, "r2", "rotor-blade", [BladeRecord("B1")], 64, 7)
    job, _ = request_diagnosis(store, science, "r1", (), compare=True, horizon_h=None)
    with serving(keys="always") as client:
        own, other = (key("read", "operate", rotors=[name]) for name in ("r1", "r2"))
        path = f"/v1/rotors/r1/diagnoses/{job.id}"
        assert client.get(path, headers=own).status_code == 200
        assert client.get(path, headers=other).status_code == 404
        assert client.get(f"/v1/jobs/{job.id}", headers=other).status_code == 404
        assert client.delete(path, headers=other).status_code == 404
        assert client.delete(path, headers=key("read")).status_code == 403
        assert client.delete(path, headers=own).json()["status"] == "cancelled"


def command(api: httpx.Client, diagnoser: Worker, *words: str) -> Any:
    """Run `bladetwin diagnose` against the test's server while a diagnoser works beside it."""
    ended = threading.Event()

    def run() -> None:
        while not ended.wait(0.05):
            diagnoser.drain()

    beside = threading.Thread(target=run)
    beside.start()
    try:
        return CliRunner().invoke(commands, ["diagnose", "r1", "--url", str(api.base_url), *words])
    finally:
        ended.set()
        beside.join()


def test_the_command_ends_with_0_where_the_model_is_adequate(
    api: httpx.Client, straight: str, diagnoser: Worker, tmp_path: Path
) -> None:
    file = tmp_path / "families.json"
    file.write_text(json.dumps([FAMILY]))
    done = command(api, diagnoser, "--families", str(file), "--no-compare")
    assert done.exit_code == 0, done.output
    assert "rotor r1: adequate" in done.stdout
    assert "rests on 9 of 9 readings through entry 9" in done.stdout
    (told,) = Client(http=api).diagnoses("r1")
    assert (told["request"]["compare"], told["request"]["families"]) == (False, [FAMILY])


def test_the_command_ends_with_3_where_something_is_missing_and_prints_it_as_json(
    api: httpx.Client, rotor: str, post: Post, reading: Make, diagnoser: Worker
) -> None:
    post(rotor, *_lines(reading, {"B1": 0.5, "B2": 0.6}, {16e3: 0.1}))
    done = command(api, diagnoser, "--json")
    assert done.exit_code == 3, done.output
    assert json.loads(done.stdout)["result"]["verdict"] == "unattributed"


def test_an_interrupted_command_says_that_its_diagnosis_goes_on(
    api: httpx.Client, straight: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It ended without a word, and looked as if it had ended the diagnosis as well."""

    def interrupted(seconds: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("service.diagnose_command.time.sleep", interrupted)
    done = CliRunner().invoke(commands, ["diagnose", "r1", "--url", str(api.base_url)])
    assert done.exit_code == 130
    (left,) = Client(http=api).diagnoses("r1")
    assert left["status"] == "queued"
    said = f"bladetwin: diagnosis {left['id']} of r1 goes on; the same command finds it again.\n"
    assert said in done.stderr


def test_the_command_says_why_a_diagnosis_failed(
    api: httpx.Client, rotor: str, diagnoser: Worker
) -> None:
    done = command(api, diagnoser)
    assert "post inspections" in str(done.exception)
    with pytest.raises(ProblemError, match="404"):
        Client(http=api).diagnose("zz")
