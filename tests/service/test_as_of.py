"""Reads as of a calendar moment: what was received by then, and nothing that came later."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import httpx
import pytest
from sqlalchemy import Connection, select, text

from core.observation import Inspection
from service.client import Client
from service.handlers.blades import add_blade, retire_blade
from service.moments import moment
from service.ports import BladeRecord, NewEvent
from service.settings import Settings
from service.store.engine import now_s, open_engine, transaction
from service.store.log import SqlLog
from service.store.records import SqlRecords
from service.store.settled import end_of, settled
from service.store.unit_of_work import SqlStore
from service.store.versions import thin
from service.worker.loop import Worker

Make = Callable[..., Inspection]
Post = Callable[..., int]
DAY = 86_400.0
T0 = 1_900_000_000.0 - 10_000 * DAY  # in the past of any run
KINDS = (
    *("", "/posterior", "/blades/B1/posterior", "/blades/B1/prediction?times=25000"),
    "/life?limit=0.3",
)


def received(store: SqlStore, seq: int, at: float) -> None:
    with transaction(store.engine, write=True) as connection:
        statement = text("UPDATE event SET received_at = :at WHERE seq = :seq")
        assert connection.execute(statement, {"at": at, "seq": seq}).rowcount == 1


@pytest.fixture
def aged(store: SqlStore, worker: Worker, rotor: str, reading: Make, post: Post) -> str:
    """Entries 1, 2, 3+4, 5 on days 1, 2, 3, 4; each day one version: 2 … 5 (1 is the prior)."""
    worker.drain()
    post(rotor, reading("a", value=0.11))
    worker.drain()
    add_blade(store, rotor, BladeRecord("B4"))
    worker.drain()
    post(rotor, reading("c", value=0.3, time_h=20_000.0), reading("d", blade="B4", value=0.2))
    worker.drain()
    retire_blade(store, rotor, "B2")
    worker.drain()
    with transaction(store.engine, write=True) as connection:
        connection.execute(text("UPDATE rotor SET created_at = :at"), {"at": T0})
    for seq, day in enumerate((1, 2, 3, 3, 4), 1):
        received(store, seq, T0 + day * DAY + 0.2507)
    return rotor


def ask(api: httpx.Client, path: str, **given: Any) -> httpx.Response:
    at = given.pop("at", None)
    if at is not None:
        given["at"] = moment(at)
    url, _, query = f"/v1/rotors/r1{path}".partition("?")
    return api.get(url, params=dict(httpx.QueryParams(query)) | given)


@pytest.mark.parametrize("path", KINDS)
def test_a_read_as_of_a_moment_is_the_read_of_the_version_of_that_time(
    api: httpx.Client, aged: str, path: str
) -> None:
    for day, version in ((0.5, 1), (1.5, 2), (2.5, 3), (3.5, 4), (4.5, 5), (400.0, 5)):
        then = ask(api, path, at=T0 + day * DAY)
        assert then.status_code == 200, then.text
        by_number = ask(api, path, version=version).json()
        assert then.json() == by_number, day
        basis = then.json().get("rests_on") or then.json()["posterior"]
        assert (basis["version"], basis["through_seq"]) == (version, (0, 1, 2, 4, 5)[version - 1])


def test_the_moment_that_the_log_tells_of_an_entry_includes_it_and_the_millisecond_before_not(
    api: httpx.Client, aged: str
) -> None:
    told = api.get("/v1/rotors/r1/inspections/a").json()["received_at"]
    at = api.get("/v1/rotors/r1", params={"at": told}).json()
    assert at["posterior"]["through_seq"] == 1
    before = ask(api, "", at=T0 + DAY + 0.249).json()
    assert before["posterior"]["through_seq"] == 0


def test_a_rotor_as_of_then_has_the_blades_of_then(api: httpx.Client, aged: str) -> None:
    blades = {
        day: {b["id"]: b["retired"] for b in ask(api, "", at=T0 + day * DAY).json()["blades"]}
        for day in (1.5, 2.5, 4.5)
    }
    first = {"B1": False, "B2": False, "B3": False}
    assert blades == {
        1.5: first,
        2.5: first | {"B4": False},
        4.5: first | {"B2": True, "B4": False},
    }
    body = ask(api, "/blades/B4/posterior", at=T0 + 1.5 * DAY)
    assert body.status_code == 404
    assert "entry 2" in body.json()["faults"][0]["remedy"]


def test_a_thinned_version_is_a_problem_that_names_the_nearest_kept_ones(
    api: httpx.Client, store: SqlStore, settings: Settings, aged: str
) -> None:
    thin(store.engine, aged, keep=1, every=2)  # leaves 2, 4 and 5
    for given in ({"at": T0 + 2.5 * DAY}, {"version": 3}):
        for path in KINDS:
            answer = ask(api, path, **given)
            assert answer.status_code == 410
            body = answer.json()
            first, *near = body["faults"]
            assert (first["field"], first["problem"]) == (next(iter(given)), "is no longer kept")
            assert [one["value"] for one in near] == [2, 4]
            assert "version 2 (through entry 1) or version 4 (through entry 4)" in body["detail"]
    first = ask(api, "/posterior", at=T0 + 0.5 * DAY).json()
    assert [one["value"] for one in first["faults"][1:]] == [2], "nothing is kept before it"


def test_entries_that_were_applied_together_have_no_version_between_them(
    api: httpx.Client, store: SqlStore, aged: str
) -> None:
    received(store, 4, T0 + 3.5 * DAY)
    answer = ask(api, "/posterior", at=T0 + 3.2 * DAY)
    assert answer.status_code == 410
    assert [one["value"] for one in answer.json()["faults"][1:]] == [3, 4]


def test_a_clock_that_stepped_back_hides_nothing_and_shows_nothing_early(
    api: httpx.Client, store: SqlStore, aged: str
) -> None:
    """Entry 2 says it came after 3 and 4: until then, only what came before it counts."""
    received(store, 2, T0 + 3.7 * DAY)
    assert ask(api, "", at=T0 + 3.2 * DAY).json()["posterior"]["through_seq"] == 1
    assert ask(api, "", at=T0 + 3.8 * DAY).json()["posterior"]["through_seq"] == 4


def test_what_is_not_computed_yet_says_what_to_wait_for(
    api: httpx.Client, aged: str, reading: Make, post: Post
) -> None:
    post(aged, reading("new"))
    now = api.get("/v1/rotors/r1/inspections/new").json()["received_at"]
    answer = api.get("/v1/rotors/r1/posterior", params={"at": now})
    assert answer.status_code == 409
    assert "wait_for=6" in answer.json()["detail"]


@pytest.mark.parametrize("path", KINDS)
def test_of_a_rotor_without_any_version_nothing_is_gone(
    api: httpx.Client, rotor: str, path: str
) -> None:
    now = api.get("/v1/rotors/r1").json()["created_at"]
    url, _, query = f"/v1/rotors/r1{path}".partition("?")
    answer = api.get(url, params=dict(httpx.QueryParams(query)) | {"at": now})
    assert answer.status_code == 409
    assert "wait_for=0" in answer.json()["detail"]


@pytest.mark.parametrize(
    "given",
    [
        {"at": moment(T0 - DAY)},
        {"at": "2999-01-01T00:00:00Z"},
        {"at": "2001-05-04T10:00:00"},
        {"at": "yesterday"},
        {"at": "2001-05-04T10:00:00Z", "version": "2"},
        {"at": "0001-01-01T00:00:00+14:00"},
        {"at": "9999-12-31T23:59:59-14:00"},
    ],
)
@pytest.mark.parametrize("path", KINDS)
def test_a_moment_that_is_none_of_the_rotor_s_is_refused(
    api: httpx.Client, aged: str, given: dict[str, str], path: str
) -> None:
    url, _, query = f"/v1/rotors/r1{path}".partition("?")
    answer = api.get(url, params=dict(httpx.QueryParams(query)) | given)
    assert answer.status_code == 422
    assert answer.json()["faults"][0]["field"] == "at"


def test_a_refused_moment_is_told_between_which_it_has_to_be(api: httpx.Client, aged: str) -> None:
    """Also where it lies before the rotor; one before 1970 is a moment all the same."""
    now = api.get("/v1/rotors/r1", params={"at": "2999-01-01T00:00:00Z"}).json()["detail"]
    early = api.get("/v1/rotors/r1", params={"at": moment(T0 - DAY)}).json()["detail"]
    (last, begun), (till, since) = [
        re.search(r"outside (\S+) … (\S+),", one).group(2, 1)  # type: ignore[union-attr]
        for one in (now, early)
    ]
    assert begun == since < last <= till
    first = api.get("/v1/rotors/r1", params={"at": "1969-05-04T10:00:00Z"}).json()["faults"][0]
    assert first["problem"] == "lies before 1970, when no log had begun"
    assert "offset" not in first["remedy"]


def test_waiting_is_not_mixed_with_a_version(api: httpx.Client, aged: str) -> None:
    answer = api.get("/v1/rotors/r1", params={"version": 2, "wait_for": 1})
    assert answer.status_code == 422
    assert answer.json()["faults"][0]["field"] == "wait_for"


def clock(connection: Connection) -> float:
    return float(connection.execute(select(now_s())).scalar_one())


@contextmanager
def under_way(settings: Settings, rotor: str) -> Iterator[float]:
    """An entry of another process that has its time and is not committed; a moment after it."""
    engine = open_engine(settings.database_url)
    with transaction(engine, write=True) as connection:
        event = NewEvent("late", "retirement", "{}", "digest", blade="B2")
        (entry,) = SqlLog(connection).append(rotor, [event])
        SqlRecords(connection).retire_blade(rotor, "B2", entry.seq)
        got = text("SELECT received_at FROM event WHERE event_id = 'late'")
        received = connection.execute(got).scalar_one()
        while (now := clock(connection)) < received + 0.01:
            pass
        yield now
    engine.dispose()


@pytest.mark.parametrize("path", KINDS)
def test_a_read_as_of_just_now_waits_for_the_entry_that_is_under_way(
    api: httpx.Client, worker: Worker, rotor: str, settings: Settings, path: str
) -> None:
    """It came by then: whoever asks before its commit is told what is told after it."""
    worker.drain()
    told: list[httpx.Response] = []
    with under_way(settings, rotor) as at:
        asking = threading.Thread(target=lambda: told.append(ask(api, path, at=at)))
        asking.start()
        asking.join(0.5)
    asking.join()
    again = ask(api, path, at=at)
    assert (told[0].status_code, told[0].text) == (again.status_code, again.text)
    assert told[0].status_code == 409
    assert "wait_for=1" in told[0].json()["detail"]


def test_a_moment_before_the_newest_entry_waits_for_nobody(
    api: httpx.Client, aged: str, settings: Settings
) -> None:
    with under_way(settings, aged):
        for day, version in ((0.5, 1), (1.5, 2), (2.5, 3), (3.5, 4)):
            then = ask(api, "", at=T0 + day * DAY)
            assert then.json()["posterior"]["version"] == version


def test_a_moment_is_asked_for_when_its_millisecond_is_over(store: SqlStore, rotor: str) -> None:
    """What is received later in the same millisecond counts as well."""
    for _ in range(20):
        with store.read() as tx:
            at = clock(tx.connection)
        assert settled(store.engine, rotor, at) >= end_of(at)


def test_the_wait_for_what_is_under_way_holds_nobody_up(
    store: SqlStore, rotor: str, settings: Settings
) -> None:
    """Neither the rotor's row nor the database's one writer is kept while the read goes on."""
    with store.read() as tx:
        at = clock(tx.connection)
    with store.read_as_of(rotor, at), under_way(settings, rotor):
        pass


def test_the_client_asks_as_of_a_moment(api: httpx.Client, aged: str) -> None:
    twin = Client(http=api)
    at = moment(T0 + 1.5 * DAY)
    assert twin.rotor("r1", at=at)["posterior"]["version"] == 2
    assert twin.posterior("r1", "B1", at=at)["rests_on"]["version"] == 2
    assert twin.prediction("r1", "B1", times=[25_000], at=at)["rests_on"]["version"] == 2
    assert twin.rotor("r1", version=3)["posterior"]["version"] == 3
