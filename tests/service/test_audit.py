"""The audit trail: no change without its row, no secret anywhere."""

from __future__ import annotations

import io
import json
import logging
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from copy import copy
from typing import Any

import httpx
import pytest
from sqlalchemy import inspect, text

from service import tokens
from service.api.routers import inspections as inspection_routes
from service.handlers.keys import create_key
from service.settings import Settings
from service.store.engine import transaction
from service.store.trail import SqlAudit
from service.store.unit_of_work import SqlStore
from service.telemetry import JsonLines
from service.worker.loop import Worker
from tests.patience import until

Json = dict[str, Any]
Headers = dict[str, str]
Key = Callable[..., Headers]
Serving = Callable[..., AbstractContextManager[httpx.Client]]
URL = "/v1/rotors/r1/inspections"
READING = {"id": "i1", "blade": "B1", "quantity": "elongation", "time_h": 8000.0, "value": 0.11}


@pytest.fixture
def locked(serving: Serving, rotor: str) -> Iterator[httpx.Client]:
    with serving(keys="always") as client:
        yield client


@pytest.fixture
def lines() -> Iterator[io.StringIO]:
    """Everything that the service logs, as it stands in the log."""
    out = io.StringIO()
    handler = logging.StreamHandler(out)
    handler.setFormatter(JsonLines())
    logger = logging.getLogger("bladetwin")
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel("DEBUG")
    yield out
    logger.removeHandler(handler)
    logger.setLevel(level)


def rows(store: SqlStore) -> list[Json]:
    """The whole trail, the oldest first."""
    with store.read() as tx:
        found = tx.audit.page(None, 1000)
    return [{name: getattr(row, name) for name in row.__slots__} for row in reversed(found)]


def test_every_state_changing_request_leaves_who_what_whence_and_how_it_ended(
    locked: httpx.Client, store: SqlStore, key: Key
) -> None:
    header = key("read", "ingest", "operate", name="plant gateway")
    key_id = tokens.id_of(header["Authorization"][7:])
    rotor = {"id": "r7", "model": "rotor-blade", "blades": [{"id": "B1"}]}
    reader = key("read", name="viewer")
    asked: list[tuple[str, Json | None, int, str | None]] = [
        ("/v1/rotors", rotor, 201, None),
        ("/v1/rotors", rotor | {"seed": 9}, 409, "conflict"),
        ("/v1/models", {"builtin": "rotor-blade"}, 202, None),
        (URL, READING, 202, None),
        (URL, READING, 202, None),
        (URL, READING | {"value": 0.2}, 409, "conflict"),
        (URL, READING | {"id": "i2", "blade": "B9"}, 422, "invalid-input"),
        (URL, {"inspections": [READING | {"id": "i3"}, READING | {"id": "i4"}]}, 202, None),
        ("/v1/rotors/zz/inspections", READING, 404, "not-found"),
        (f"{URL}/i3/retraction", None, 202, None),
        ("/v1/rotors/r1/blades", {"id": "B9"}, 202, None),
        ("/v1/rotors/r1/blades/B9/retirement", None, 202, None),
        ("/v1/rotors/r1/retry", None, 202, None),
        ("/v1/rotors/r1/policy", {"adopt": "effect"}, 200, None),
    ]
    for i, (path, body, status, problem) in enumerate(asked):
        sent = locked.post(path, json=body, headers=header | {"X-Request-Id": f"q{i}"})
        assert (sent.status_code, sent.headers["x-request-id"]) == (status, f"q{i}"), sent.text
        row = rows(store)[-1]
        assert (row["status"], row["problem"], row["path"]) == (status, problem, path)
        assert (row["key_id"], row["who"], row["request_id"]) == (key_id, "plant gateway", f"q{i}")
        assert row["address"] == "127.0.0.1"
        assert abs(row["at"] - store_now(store)) < 60
    assert len(rows(store)) == len(asked)
    told = [(row["first_seq"], row["last_seq"]) for row in rows(store)]
    none = (None, None)
    assert told[3:] == [(1, 1), none, none, none, (2, 3), none, (4, 4), (5, 5), (6, 6), none, none]
    assert rows(store)[3]["what"] == "POST /v1/rotors/{r}/inspections"
    assert [row["rotor_id"] for row in rows(store)[:4]] == [None, None, None, "r1"]
    locked.post(URL, json=READING, headers=reader)
    last = rows(store)[-1]
    assert (last["who"], last["status"], last["problem"]) == ("viewer", 403, "scope-missing")
    count = len(rows(store))
    for path in ("/v1/rotors", "/v1/rotors/r1", "/v1/audit", "/nowhere"):
        locked.get(path, headers=header)
    locked.post(URL, json=READING)
    assert len(rows(store)) == count, "reading leaves none, nor does who has no key"


def store_now(store: SqlStore) -> float:
    with store.read() as tx:
        return tx.keys.all()[1]


TRUE_WRITE = SqlStore.write


@contextmanager
def noted_after(store: SqlStore) -> Iterator[Any]:
    """A mutant of `SqlStore.write` that writes the row in a transaction of its own."""
    plain = copy(store)
    plain._act = None
    with TRUE_WRITE(plain) as tx:
        yield tx
    if store._act is not None:
        with TRUE_WRITE(plain) as tx:
            tx.audit.note(store._act, 202)


@pytest.mark.parametrize(("mutant", "head"), [(False, 0), (True, 1)])
def test_a_change_without_its_row_is_not_made(
    api: httpx.Client,
    store: SqlStore,
    rotor: str,
    monkeypatch: pytest.MonkeyPatch,
    mutant: bool,
    head: int,
) -> None:
    if mutant:
        monkeypatch.setattr(SqlStore, "write", noted_after)

    def broken(*args: Any, **kw: Any) -> int:
        raise RuntimeError("no row")

    with monkeypatch.context() as patch:
        patch.setattr(SqlAudit, "note", broken)
        assert api.post(URL, json=READING).status_code == 500
    assert api.get("/v1/rotors/r1").json()["head_seq"] == head
    assert api.post(URL, json=READING).status_code == 202, "negative control"
    assert api.get("/v1/rotors/r1").json()["head_seq"] == 1


def test_a_change_that_was_made_is_told_even_where_its_answer_failed(
    api: httpx.Client, store: SqlStore, rotor: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(inspection_routes, "accepted", lambda answers: 1 / 0)
    assert api.post(URL, json=READING).status_code == 500
    row = rows(store)[-1]
    assert (row["status"], row["problem"], row["first_seq"]) == (500, "internal-error", 1)
    assert len(rows(store)) == 1


def test_a_reading_names_the_key_that_it_came_with(
    locked: httpx.Client, serving: Serving, key: Key, worker: Worker
) -> None:
    one, other = key("ingest", "read"), key("ingest", "read")
    locked.post(URL, json=READING, headers=one)
    again = locked.post(URL, json=READING, headers=other)
    assert again.headers["idempotent-replayed"] == "true", "another key, the same reading"
    locked.post(URL, json=READING | {"id": "i2"}, headers=other)
    ids = [tokens.id_of(header["Authorization"][7:]) for header in (one, other)]
    listed = locked.get(URL, headers=one).json()["items"]
    assert [item["posted_by"] for item in listed] == ids
    assert locked.get(f"{URL}/i2", headers=one).json()["posted_by"] == ids[1]
    with serving() as client:
        client.post(URL, json=READING | {"id": "i3"})
        assert client.get(f"{URL}/i3").json()["posted_by"] == "loopback"
    worker.drain()


def test_the_trail_is_read_page_by_page_of_a_rotor_or_a_key(locked: httpx.Client, key: Key) -> None:
    chief, other = key("operate", name="chief"), key("operate", "ingest", name="other")
    for i in range(3):
        locked.post("/v1/rotors/r1/blades", json={"id": f"X{i}"}, headers=other)
    locked.post("/v1/models", json={"builtin": "rotor-blade"}, headers=chief)
    whole = locked.get("/v1/audit", headers=chief).json()["items"]
    assert [row["who"] for row in whole] == ["chief", "other", "other", "other"]
    assert whole[1]["entries"] == {"first_seq": 3, "last_seq": 3}
    seen: list[int] = []
    params: Headers = {"limit": "3"}
    while True:
        page = locked.get("/v1/audit", params=params, headers=chief).json()
        seen += [row["id"] for row in page["items"]]
        if page["next"] is None:
            break
        params["cursor"] = page["next"]
    assert seen == [row["id"] for row in whole]
    by_key = locked.get("/v1/audit", params={"key": whole[0]["key"]}, headers=chief).json()
    assert [row["who"] for row in by_key["items"]] == ["chief"]
    by_rotor = locked.get("/v1/audit?rotor=r1", headers=chief).json()["items"]
    assert len(by_rotor) == 3
    assert locked.get("/v1/audit?limit=201", headers=chief).status_code == 422


def everything_stored(store: SqlStore) -> str:
    """Every row of every table as text."""
    told = []
    with transaction(store.engine, write=False) as connection:
        for table in inspect(connection).get_table_names():
            found = connection.execute(text(f'SELECT * FROM "{table}"')).mappings()
            told += [f"{table}: {dict(row)}" for row in found]
    return "\n".join(told)


def test_no_secret_stands_in_a_log_an_error_or_the_database(
    locked: httpx.Client, store: SqlStore, lines: io.StringIO, settings: Settings
) -> None:
    """Keys where they belong, and in every place where a client may put one by mistake."""
    secrets = []
    for i in range(2):
        _, token = create_key(store, f"user {i}", ["read", "ingest", "operate"])
        secrets.append(token)
    good, lost = secrets
    header = {"Authorization": f"Bearer {good}"}
    told = [
        locked.get("/v1/rotors/r1", headers=header),
        locked.get("/v1/rotors/r1", headers={"Authorization": f"Bearer {lost[:-1]}"}),
        locked.get("/v1/rotors/r1", headers={"Authorization": f"Basic {lost}"}),
        locked.get(f"/v1/rotors/{lost}", headers=header),
        locked.get(f"/nowhere/{lost}", headers=header),
        locked.get("/v1/rotors/r1", params={"key": lost}, headers=header),
        locked.get("/v1/rotors", params={"limit": lost}, headers=header),
        locked.get("/v1/rotors", params={"cursor": lost + "/"}, headers=header),
        locked.get("/v1/rotors/r1/blades/B1/prediction", params={"times": lost}, headers=header),
        locked.post(f"/v1/rotors/{lost}/retry", headers=header),
        locked.post(f"{URL}/{lost}/retraction", headers=header),
        locked.post(URL, json=READING, headers=header | {"Idempotency-Key": lost}),
        locked.post(URL, json=READING | {lost: 1}, headers=header),
        locked.post(URL, json=READING | {"time_h": lost}, headers=header),
        locked.post(URL, json=READING | {"blade": lost[:90]}, headers=header),
        locked.post("/v1/models", json={"builtin": lost}, headers=header),
        locked.post(URL, content=lost, headers=header | {"content-type": lost}),
        locked.post(URL, json=READING, headers=header | {"X-Request-Id": lost}),
        locked.post(URL, json=READING, headers=header | {"If-Match": lost}),
    ]
    assert {answer.status_code for answer in told} >= {200, 202, 401, 404, 412, 415, 422}
    places = {
        "answers": "\n".join(answer.text for answer in told),
        "log": lines.getvalue(),
        "database": everything_stored(store),
    }
    for name, place in places.items():
        for token in secrets:
            secret = token.split("_", 2)[2]
            assert secret[:20] not in place, name
        shown = lost if name == "answers" else good
        assert shown.split("_")[1] in place, f"negative control: the id stands in the {name}"
    assert secrets[0] not in repr(settings)


def test_lines_of_a_request_carry_its_id_and_its_key(
    locked: httpx.Client, key: Key, lines: io.StringIO
) -> None:
    header = key("read")
    locked.get("/v1/rotors/r1", headers=header | {"X-Request-Id": "plant-7:42"})
    made = locked.get("/v1/rotors/r1", headers=header | {"X-Request-Id": "no id, 7"})
    until("a line just after its answer", lambda: lines.getvalue().count("\n") >= 2)
    found = [json.loads(line) for line in lines.getvalue().splitlines()]
    (line,) = [line for line in found if line.get("request_id") == "plant-7:42"]
    assert line["message"].startswith("GET /v1/rotors/r1 200 ")
    assert line["who"] == tokens.id_of(header["Authorization"][7:])
    assert len(made.headers["x-request-id"]) == 16
    assert made.headers["x-request-id"] in {line.get("request_id") for line in found}
