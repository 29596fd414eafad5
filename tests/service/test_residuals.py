"""Residuals as they are computed by workers, kept, and served; with the exact twin."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import numpy as np
import pytest
from sqlalchemy import select, update

from core.observation import Inspection
from service.bootstrap import make_worker
from service.client import Client
from service.errors import StoreAwayError
from service.fake import HORIZON_H, FakeScience
from service.handlers.inspections import retract
from service.handlers.rotors import create_rotor, view_rotor
from service.ports import BladeRecord, Json
from service.settings import Settings
from service.store import tables as t
from service.store.engine import now_s, transaction
from service.store.unit_of_work import SqlStore
from service.worker import residuals as work
from service.worker.lease import release
from service.worker.loop import Worker
from service.worker.residuals import Residuals, claim_residuals

Make = Callable[..., Inspection]
Post = Callable[..., int]
PATH = "/v1/rotors/r1/residuals"


def visits(reading: Make, off: dict[int, float]) -> list[Inspection]:
    """Three blades along lines with noise, four campaigns; some of them are off."""
    rng = np.random.default_rng(20310504)
    rates = {"B1": 0.45, "B2": 0.5, "B3": 0.55}
    return [
        reading(
            f"{b}-{k}",
            blade=b,
            time_h=8e3 * k,
            value=rate * 8e3 * k / HORIZON_H + 0.02 * rng.normal() + off.get(k, 0.0),
            campaign=f"c{k}",
        )
        for b, rate in rates.items()
        for k in (1, 2, 3, 4)
    ]


@pytest.fixture
def read(rotor: str, post: Post, reading: Make, worker: Worker) -> str:
    post(rotor, *visits(reading, {}))
    worker.drain()
    return rotor


def test_a_rotor_without_any_entry_waits_for_no_residuals(
    api: httpx.Client, rotor: str, worker: Worker, diagnoser: Worker
) -> None:
    for wait in (lambda: None, worker.drain, diagnoser.drain):
        wait()
        told = api.get(PATH).json()
        assert (told["items"], told["as_of"], told["error"]) == ([], None, None)
        assert told["pending"] is False


def test_residuals_are_pending_until_a_worker_has_computed_them_and_say_what_they_rest_on(
    api: httpx.Client, store: SqlStore, read: str, diagnoser: Worker
) -> None:
    empty = api.get(PATH).json()
    assert (empty["items"], empty["as_of"], empty["pending"]) == ([], None, True)
    diagnoser.drain()
    told = api.get(PATH).json()
    rotor = view_rotor(store, "r1")
    assert rotor.state is not None
    assert told["pending"] is False
    assert told["as_of"]["version"] == rotor.rotor.version
    assert told["as_of"]["events_digest"] == rotor.state.events_digest
    assert (len(told["items"]), told["next"], told["family_wise_error"]) == (12, None, 0.05)
    assert [v["readings"] for v in told["visits"]] == [3, 3, 3, 3]
    assert told["alarms"] == sum(one["alarm"] for one in told["tests"]) == 0


def test_the_twin_s_residuals_are_those_of_its_own_predictions_from_before(
    api: httpx.Client, read: str, diagnoser: Worker, post: Post, reading: Make, worker: Worker
) -> None:
    """The second rotor has the first visit alone: its bands predict the second visit's readings."""
    diagnoser.drain()
    told = api.get(PATH, params={"blade": "B2"}).json()["items"]
    for name in ("B1-2", "B2-2", "B3-2", *(f"{b}-{k}" for b in ("B1", "B2", "B3") for k in (3, 4))):
        api.post(f"/v1/rotors/r1/inspections/{name}/retraction")
    worker.drain()
    band = api.get("/v1/rotors/r1/blades/B2/prediction", params={"times": "16000"}).json()
    assert told[1]["inspection"] == "B2-2"
    assert told[1]["mean"] == pytest.approx(band["mean"][0], rel=1e-12)
    assert told[1]["sd"] == pytest.approx(band["sd"]["total"][0], rel=1e-12)
    assert told[1]["z"] == pytest.approx((told[1]["y"] - told[1]["mean"]) / told[1]["sd"])


def test_a_campaign_that_is_off_alarms_is_counted_and_told_to_listeners(
    api: httpx.Client,
    store: SqlStore,
    rotor: str,
    post: Post,
    reading: Make,
    worker: Worker,
    diagnoser: Worker,
) -> None:
    post(rotor, *visits(reading, {3: 0.2}))
    worker.drain()
    diagnoser.drain()
    told = api.get(PATH).json()
    first = told["tests"][0]
    loud = [(t["grouping"], t["value"], t["statistic"]) for t in told["tests"] if t["alarm"]]
    assert ("campaign", "c3", "mean") in loud
    assert len(loud) == told["alarms"]
    page = api.get("/metrics").text
    assert f"bladetwin_residual_alarms {told['alarms']}\n" in page
    with store.read() as tx:
        notes = tx.outbox.after("r1", 0, 100)
    assert notes[-1].kind == "residuals"
    assert notes[-1].payload["tests"][0] == {
        k: first[k] for k in ("grouping", "value", "statistic")
    }
    for name in ("B1-3", "B2-3", "B3-3"):
        retract(store, "r1", name)
    worker.drain()
    diagnoser.drain()
    assert api.get(PATH).json()["alarms"] == 0
    with store.read() as tx:
        last = tx.outbox.after("r1", 0, 100)[-1]
    assert (last.kind, last.payload["alarms"]) == ("residuals", 0), "that it is over is told, too"


def test_pages_and_filters_go_through_every_row_once(
    api: httpx.Client, read: str, diagnoser: Worker
) -> None:
    diagnoser.drain()
    twin = Client(http=api)
    every = twin.residuals("r1")["items"]
    seen: list[Json] = []
    cursor: dict[str, str] = {}
    while True:
        page = twin.residuals("r1", limit="5", **cursor)
        seen += page["items"]
        assert len(page["tests"]) > 0
        if page["next"] is None:
            break
        cursor = {"cursor": page["next"]}
    assert seen == every
    assert {one["blade"] for one in twin.residuals("r1", blade="B3")["items"]} == {"B3"}
    both = twin.residuals("r1", blade="B3", campaign="c2", quantity="elongation")["items"]
    assert [one["inspection"] for one in both] == ["B3-2"]
    assert twin.residuals("r1", quantity="ceeq")["items"] == []
    assert api.get(PATH, params={"limit": 100_000}).status_code == 422
    assert api.get("/v1/rotors/zz/residuals").status_code == 404


def test_pages_go_on_where_they_were_though_residuals_are_computed_anew_between_them(
    api: httpx.Client, read: str, diagnoser: Worker, worker: Worker, post: Post, reading: Make
) -> None:
    """A reading that came late, of an hour before the page's end, neither repeats nor skips one."""
    diagnoser.drain()
    every = [one["inspection"] for one in api.get(PATH).json()["items"]]
    first = api.get(PATH, params={"limit": 5}).json()
    post(read, reading("late", blade="B1", time_h=900.0, value=0.02))
    worker.drain()
    diagnoser.drain()
    second = api.get(PATH, params={"limit": 100, "cursor": first["next"]}).json()
    pages = [one["inspection"] for page in (first, second) for one in page["items"]]
    assert pages == every
    now = [one["inspection"] for one in api.get(PATH).json()["items"]]
    assert now == ["late", *every], "negative control: by numbers the sixth would come twice"
    for bad in ("5", "x:0:a", "1.0:y:a", "1.0"):
        assert api.get(PATH, params={"cursor": bad}).status_code == 422, bad


def test_the_order_of_arrival_leaves_no_trace(
    api: httpx.Client,
    store: SqlStore,
    rotor: str,
    post: Post,
    reading: Make,
    worker: Worker,
    diagnoser: Worker,
) -> None:
    for one in reversed(visits(reading, {3: 0.2})):
        post(rotor, one)
    worker.drain()
    diagnoser.drain()
    backwards = api.get(PATH).json()
    blades = [{"id": b} for b in ("B1", "B2", "B3")]
    body = {"id": "r2", "model": "rotor-blade", "blades": blades, "seed": 7, "particles": 64}
    assert api.post("/v1/rotors", json=body).status_code == 201
    post("r2", *visits(reading, {3: 0.2}))
    worker.drain()
    diagnoser.drain()
    forwards = api.get("/v1/rotors/r2/residuals").json()
    assert forwards["items"] == backwards["items"]
    assert forwards["tests"] == backwards["tests"]


def test_only_the_newest_version_is_computed_and_only_by_the_diagnosing_role(
    store: SqlStore,
    science: FakeScience,
    settings: Settings,
    read: str,
    post: Post,
    reading: Make,
    worker: Worker,
    diagnoser: Worker,
) -> None:
    for k in range(3):
        post("r1", reading(f"more-{k}", time_h=1000.0 * (k + 1), value=0.01 * (k + 1)))
        worker.drain()
    make_worker(store, science, settings, "s", "seal").drain()
    with store.read() as tx:
        assert tx.records.residuals("r1").version == 0
    assert diagnoser.run_once()
    assert not diagnoser.run_once()
    with store.read() as tx:
        assert tx.records.residuals("r1").version == tx.records.rotor("r1").version == 4


def taken_over(store: SqlStore, science: FakeScience, settings: Settings) -> list[str | None]:
    """Whose residuals are kept where the first worker loses its lease at the end."""
    first = Residuals(store, science, settings, "first")
    claim = claim_residuals(store.engine, "first", 30.0)
    assert claim is not None
    body = first.compute(claim)
    assert claim_residuals(store.engine, "second", 30.0) is None, "the lease runs"
    with transaction(store.engine, write=True) as connection:
        connection.execute(update(t.residual).values(lease_until=now_s() - 0.01))
    assert Residuals(store, science, settings, "second").run_once()
    try:
        first.keep(claim, body | {"draws": -1}, None)
    except work.LostLeaseError as error:
        return [str(error)]
    return [None]


def test_a_worker_that_lost_its_lease_writes_nothing(
    api: httpx.Client, store: SqlStore, science: FakeScience, settings: Settings, read: str
) -> None:
    assert taken_over(store, science, settings) != [None]
    assert api.get(PATH).json()["draws"] > 0


def test_without_the_fence_it_would(
    api: httpx.Client,
    store: SqlStore,
    science: FakeScience,
    settings: Settings,
    read: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The mutant: who holds the rotor's residuals is not asked."""
    monkeypatch.setattr(work, "holds", lambda claim: t.residual.c.rotor_id == claim.rotor_id)
    assert taken_over(store, science, settings) == [None]
    assert api.get(PATH).json()["draws"] == -1


def test_what_cannot_be_computed_is_an_error_until_another_version_comes(
    api: httpx.Client,
    store: SqlStore,
    rotor: str,
    post: Post,
    reading: Make,
    worker: Worker,
    diagnoser: Worker,
) -> None:
    post(rotor, reading("a"))
    worker.drain()
    retract(store, "r1", "a")
    worker.drain()
    diagnoser.drain()
    told = api.get(PATH).json()
    assert (told["items"], told["pending"]) == ([], False)
    assert "post inspections" in told["error"]
    post(rotor, reading("b"))
    worker.drain()
    assert api.get(PATH).json()["pending"] is True
    diagnoser.drain()
    again = api.get(PATH).json()
    assert (len(again["items"]), again["error"]) == (1, None)


def test_a_failing_computation_pauses_and_is_given_up_after_so_many_attempts(
    store: SqlStore, settings: Settings, read: str
) -> None:
    class Broken(FakeScience):
        def residuals(self, *given: Any) -> Json:
            raise RuntimeError("broken")

    few = settings.model_copy(update={"max_attempts": 3})
    broken = Residuals(store, Broken(), few, "b")
    assert [broken.run_once() for _ in range(4)] == [True, True, True, False]
    with store.read() as tx:
        kept = tx.records.residuals("r1")
    assert (kept.version, kept.error) == (1, "RuntimeError: broken")


def test_a_worker_that_is_stopped_gives_them_back_uncounted(
    store: SqlStore, science: FakeScience, settings: Settings, read: str
) -> None:
    assert Residuals(store, science, settings, "s", lambda: True).run_once()
    with transaction(store.engine, write=False) as connection:
        row = connection.execute(select(t.residual)).one()
    assert (row.version, row.attempts, row.owner) == (0, 0, None)
    assert Residuals(store, science, settings, "t").run_once()


def test_residuals_that_kill_their_workers_are_given_up_with_an_error(
    store: SqlStore, science: FakeScience, settings: Settings, read: str
) -> None:
    few = settings.model_copy(update={"max_attempts": 2})
    for _ in range(2):
        assert claim_residuals(store.engine, "dies", 30.0) is not None
        release(store.engine, "dies")
    assert Residuals(store, science, few, "d").run_once()
    with store.read() as tx:
        kept = tx.records.residuals("r1")
    assert (kept.version, kept.body) == (1, None)
    assert "2 workers died" in str(kept.error)
    assert not Residuals(store, science, few, "d").run_once()


def test_the_oldest_residuals_go_first(
    store: SqlStore,
    science: FakeScience,
    settings: Settings,
    worker: Worker,
    reading: Make,
    post: Post,
) -> None:
    """The first rotor gets versions without a pause; the others have their turn all the same."""
    names = ("r1", "r2", "r3")
    for name in names:
        create_rotor(store, name, "rotor-blade", [BladeRecord("B1")], 64, 7)
        post(name, reading("a"))
    taken = []
    for k in range(4):
        post("r1", reading(f"more-{k}", time_h=1000.0 * (k + 1)))
        worker.drain()
        claim = claim_residuals(store.engine, "d", 30.0)
        assert claim is not None
        taken.append(claim.rotor_id)
        one = Residuals(store, science, settings, "d")
        one.keep(claim, None, "looked at")
    assert taken == ["r1", "r2", "r3", "r1"]


def test_a_commit_that_was_not_heard_of_stays(
    store: SqlStore,
    science: FakeScience,
    settings: Settings,
    read: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    one, real = Residuals(store, science, settings, "d"), Residuals.keep

    def unheard(self: Residuals, *given: Any) -> None:
        real(self, *given)
        raise StoreAwayError("ConnectionReset")

    monkeypatch.setattr(Residuals, "keep", unheard)
    with pytest.raises(StoreAwayError):
        one.run_once()
    with transaction(store.engine, write=False) as connection:
        row = connection.execute(select(t.residual)).one()
    assert (row.version, row.attempts) == (1, 0)
