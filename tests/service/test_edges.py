"""Requests at the edge: long, cut off, repeated late, or beside a change that is being made."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import httpx
import pytest
from sqlalchemy import delete, event

from core.observation import Inspection
from service.api.problems import MOST_FAULTS, bounded
from service.api.refusals import LastResort
from service.api.repeats import Repeats
from service.errors import ConflictError, FaultsError, GoneError, StoreAwayError
from service.fake import FakeScience
from service.handlers import rows
from service.handlers.inspections import Item, post_inspections
from service.handlers.listing import FEW
from service.store import tables as t
from service.store.engine import transaction
from service.store.log import CHUNK
from service.store.named import digests
from service.store.trail import LONGEST_NAME
from service.store.unit_of_work import SqlStore
from service.store.versions import thin
from service.telemetry import JsonLines
from service.worker.loop import Worker

Post = Callable[..., int]
Reading = Callable[..., Inspection]
Serving = Callable[..., AbstractContextManager[httpx.Client]]
ROTOR = "/v1/rotors/r1"


def test_readings_of_a_version_are_those_that_it_knew(
    api: httpx.Client, rotor: str, post: Post, reading: Reading, worker: Worker
) -> None:
    post(rotor, reading("a"))
    worker.drain()
    version = api.get(ROTOR).json()["posterior"]["version"]
    post(rotor, reading("b", time_h=9000.0), reading("c", replaces="a", value=0.12))
    worker.drain()

    def first(**which: int) -> dict[str, Any]:
        told: dict[str, Any] = api.get(f"{ROTOR}/blades", params=which).json()["items"][0]
        return told["readings"]

    then, now = first(version=version), first()
    assert (then["counting"], then["overruled"], then["last"]["id"]) == (1, 0, "a")
    assert (now["counting"], now["overruled"], now["last"]["id"]) == (2, 1, "c")
    post(rotor, reading("d", time_h=9500.0))
    assert first()["counting"] == 3, "of the newest those that wait are told as well"


def test_rows_of_all_blades_at_all_hours_are_bounded_and_say_how_to_go_on(
    api: httpx.Client, rotor: str, worker: Worker, monkeypatch: pytest.MonkeyPatch
) -> None:
    worker.drain()
    monkeypatch.setattr(rows, "MOST_ROWS", 5)
    asked = {"times": "1000,2000", "limit": 3}
    told = api.get(f"{ROTOR}/series", params=asked)
    assert told.status_code == 422
    fault = told.json()["faults"][0]
    assert "6 rows, more than 5" in fault["problem"]
    assert "limit=2" in fault["remedy"]
    page = api.get(f"{ROTOR}/series", params=asked | {"limit": 2}).json()
    assert len(page["items"]) == 4
    assert page["next"] == "B2"


@pytest.mark.parametrize(
    "path",
    [
        "/blades/B1/prediction?times=1000",
        "/blades/B1/life?limit=0.2",
        "/life?limit=0.2",
        "/series?times=1000",
        "/blades/B1/field?time_h=1000",
    ],
)
def test_what_computes_holds_no_transaction(
    api: httpx.Client,
    store: SqlStore,
    science: FakeScience,
    rotor: str,
    worker: Worker,
    path: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """While the science computes, no connection is out but the one that watches for commits."""
    worker.drain()
    pool: Any = store.engine.pool
    idle, held = pool.checkedout(), list[int]()
    for name in ("predict", "life", "rotor_life", "field"):
        own = getattr(FakeScience, name)

        def seen(*args: Any, own: Any = own, **given: Any) -> Any:
            held.append(pool.checkedout())
            return own(*args, **given)

        monkeypatch.setattr(FakeScience, name, seen)
    assert api.get(f"{ROTOR}{path}").status_code == 200
    assert held
    assert set(held) == {idle}


def test_a_version_that_is_thinned_out_under_a_read_is_gone_not_unfit(
    store: SqlStore, rotor: str, worker: Worker, post: Post, reading: Reading
) -> None:
    post(rotor, reading("a"))
    worker.drain()
    with store.read() as tx:
        old = tx.states.get(rotor)
    for number in range(3):
        post(rotor, reading(f"n{number}", time_h=9000.0 + number))
        worker.drain()
    fresh = SqlStore(store.engine)
    with fresh.read() as tx:
        tx.states.get(rotor, old.version)
        names = digests(tx.connection, rotor, old.version)
        get = fresh.arrays(rotor, old.version)
    thin(store.engine, rotor, keep=1, every=10_000)
    with transaction(store.engine, write=True) as connection:
        connection.execute(delete(t.state_array).where(t.state_array.c.version <= old.version))
    with pytest.raises(GoneError):
        get(next(iter(names)))


def test_a_hundred_thousand_wrong_readings_are_refused_in_part(
    store: SqlStore, rotor: str, reading: Reading
) -> None:
    items = [Item(f"inspections[{i}].", reading(f"i{i}", blade="B9")) for i in range(20_000)]
    with pytest.raises(FaultsError) as caught:
        post_inspections(store, rotor, items)
    assert len(caught.value.faults) == MOST_FAULTS + 1
    assert len(bounded([{}] * len(caught.value.faults))) == MOST_FAULTS + 1


def test_many_conflicts_are_told_in_part(
    api: httpx.Client, rotor: str, post: Post, reading: Reading
) -> None:
    many = [reading(f"i{i}") for i in range(MOST_FAULTS + 50)]
    post(rotor, *many)
    body = [
        {"id": one.id, "blade": "B1", "quantity": "elongation", "time_h": 8000, "value": 0.2}
        for one in many
    ]
    told = api.post(f"{ROTOR}/inspections", json={"inspections": body})
    assert told.status_code == 409
    assert len(told.json()["faults"]) == MOST_FAULTS + 1
    assert len(told.json()["detail"]) < 400
    assert "and 1045 more" in told.json()["detail"]
    few = api.post(f"{ROTOR}/inspections", json=body[0])
    assert few.json()["detail"] == str(
        ConflictError("inspection", "i0", few.json()["faults"][0]["remedy"])
    )


def test_a_correction_that_closes_a_circle_is_refused(api: httpx.Client, rotor: str) -> None:
    """Also in one batch, and through others; one that names what is not there yet is none."""

    def sent(*pairs: tuple[str, str | None]) -> httpx.Response:
        body = [
            {"id": own, "blade": "B1", "quantity": "elongation", "time_h": 8000, "value": 0.1}
            | ({} if above is None else {"replaces": above})
            for own, above in pairs
        ]
        return api.post(f"{ROTOR}/inspections", json={"inspections": body})

    assert sent(("a", "b")).status_code == 202, "b may come later"
    told = sent(("b", "a"))
    assert told.status_code == 422
    assert told.json()["faults"][0]["field"] == "inspections[0].replaces"
    assert "b → a → b" in told.json()["faults"][0]["problem"]
    assert sent(("c", "b"), ("d", "c")).status_code == 202
    assert sent(("b", "d")).status_code == 422, "through c and d"
    assert len(sent(("x", "y"), ("y", "z"), ("z", "x")).json()["faults"]) == 3
    assert sent(("b", None)).status_code == 202, "negative control: it corrects nothing"
    assert sent(("a", "b")).status_code == 202, "again"
    assert api.get(ROTOR).json()["head_seq"] == 4


def test_a_batch_of_corrections_asks_the_log_by_chunks_and_reads_no_body(
    store: SqlStore, rotor: str, post: Post, reading: Reading
) -> None:
    """It is asked while the rotor is locked, and on SQLite every writer waits."""
    count, levels = 1200, 3
    chunks = -(-count // CHUNK)
    for level in range(levels):
        above = [f"{level - 1}-{i}" if level else None for i in range(count)]
        post(rotor, *(reading(f"{level}-{i}", replaces=a) for i, a in enumerate(above)))
    said: list[str] = []

    def note(connection: Any, cursor: Any, statement: str, *rest: Any) -> None:
        said.append(statement)

    last = [reading(f"last-{i}", replaces=f"{levels - 1}-{i}") for i in range(count)]
    event.listen(store.engine, "before_cursor_execute", note)
    try:
        assert post(rotor, *last) == (levels + 1) * count
    finally:
        event.remove(store.engine, "before_cursor_execute", note)
    asked = [s for s in said if s.startswith("SELECT") and "FROM event" in s]
    assert len(asked) == (levels + 1) * chunks, "each level of the chains, and what is known"
    assert not [s for s in asked if "event.body" in s]
    with pytest.raises(FaultsError, match="0-7 → last-7 → 2-7 → 1-7 → 0-7"):
        post(rotor, reading("0-7", replaces="last-7"))


def test_a_long_address_of_a_proxy_is_cut_in_the_audit_trail(
    api: httpx.Client, rotor: str, key: Callable[..., dict[str, str]], store: SqlStore
) -> None:
    sent = api.post(
        f"{ROTOR}/inspections",
        json={"id": "a", "blade": "B1", "quantity": "elongation", "time_h": 8000, "value": 0.1},
        headers=key("ingest") | {"X-Forwarded-For": "1" * 900},
    )
    assert sent.status_code == 202, sent.text
    with store.read() as tx:
        (row,) = tx.audit.page(None, 1)
    assert row.address == "1" * LONGEST_NAME


def test_a_client_that_hangs_up_in_its_body_is_no_failure_of_the_service(
    api: httpx.Client, rotor: str, caplog: pytest.LogCaptureFixture, server: Any
) -> None:
    app = server.switch.app
    sent: list[dict[str, Any]] = []
    parts = [
        {"type": "http.request", "body": b'{"inspections": [', "more_body": True},
        {"type": "http.disconnect"},
    ]

    async def receive() -> Any:
        return parts.pop(0) if parts else {"type": "http.disconnect"}

    async def send(message: Any) -> None:
        sent.append(message)

    scope = {
        "type": "http", "http_version": "1.1", "method": "POST", "scheme": "http",
        "path": f"{ROTOR}/inspections", "raw_path": b"", "query_string": b"", "root_path": "",
        "headers": [(b"content-type", b"application/json"), (b"host", b"127.0.0.1")],
        "client": ("127.0.0.1", 1), "server": ("127.0.0.1", 80), "state": {},
    }  # fmt: skip
    with caplog.at_level(logging.INFO):
        server.do(app(scope, receive, send))
    assert [m["status"] for m in sent if m["type"] == "http.response.start"] == [400]
    assert not [r for r in caplog.records if r.levelno >= logging.ERROR], caplog.text
    assert api.get(ROTOR).json()["head_seq"] == 0


def test_another_error_is_a_failure_still(caplog: pytest.LogCaptureFixture) -> None:
    """Negative control of the one above."""

    async def broken(scope: Any, receive: Any, send: Any) -> None:
        raise RuntimeError("odd")

    sent: list[Any] = []

    async def send(message: Any) -> None:
        sent.append(message)

    scope = {"type": "http", "method": "GET", "path": "/", "headers": [], "query_string": b""}
    asyncio.run(LastResort(broken)(scope, None, send))  # type: ignore[arg-type]
    assert sent[0]["status"] == 500
    assert [r for r in caplog.records if r.levelno >= logging.ERROR]


@pytest.mark.parametrize("charset", ["undefined", "no-such-thing", "utf-7"])
def test_a_form_in_a_charset_that_nobody_knows_is_refused(api: httpx.Client, charset: str) -> None:
    kind = f"multipart/form-data; boundary=x; charset={charset}"
    part = '--x\r\nContent-Disposition: form-data; name="id"\r\n\r\n+2AA-\r\n--x--\r\n'
    told = api.post("/v1/models", content=part.encode(), headers={"content-type": kind})
    assert told.status_code in (400, 422), told.text


def test_what_was_done_is_answered_though_its_answer_could_not_be_kept(
    api: httpx.Client, rotor: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    body = {"id": "a", "blade": "B1", "quantity": "elongation", "time_h": 8000, "value": 0.1}

    def away(*args: Any) -> None:
        raise StoreAwayError("gone for a moment")

    monkeypatch.setattr(Repeats, "_end", away)
    sent = api.post(f"{ROTOR}/inspections", json=body, headers={"Idempotency-Key": "k"})
    assert sent.status_code == 202
    assert api.get(ROTOR).json()["head_seq"] == 1


def test_a_rotor_asked_for_again_is_the_one_that_is_there_whatever_came_since(
    serving: Serving, science: FakeScience, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Other settings, or a model that would refuse it now, do not make it another request."""
    body = {"id": "r9", "model": "rotor-blade", "blades": [{"id": "B2"}, {"id": "B1"}]}
    with serving(particles=64) as api:
        first = api.post("/v1/rotors", json=body)
    assert first.status_code == 201, first.text

    def refuse(*args: Any) -> None:
        raise FaultsError([])

    monkeypatch.setattr(FakeScience, "vary", refuse)
    with serving(particles=128) as api:
        again = api.post("/v1/rotors", json=body)
        assert (again.status_code, again.json()) == (201, first.json())
        assert again.headers["idempotent-replayed"] == "true"
        other = api.post("/v1/rotors", json=body | {"seed": 3})
        assert other.status_code in (409, 422), "negative control: another request is judged"


def test_a_list_leaves_what_a_scan_says_in_the_database(
    api: httpx.Client, store: SqlStore, rotor: str
) -> None:
    """Of a scan a list shows how many values it has; all else, to the last digit, as it stands."""
    scan = {
        "blade": "B1",
        "quantity": "deformation",
        "time_h": 8000.1,
        "sigma": 1e-7,
        "campaign": "März",
        "replaces": "few",
    }
    for name, count in (("few", FEW), ("many", FEW + 1)):
        own = {k: v for k, v in scan.items() if name == "many" or k != "replaces"}
        body = own | {"id": name, "nodes": list(range(count)), "values": count * [[0.1, 0.2, 0.3]]}
        assert api.post(f"{ROTOR}/inspections", json=body).status_code == 202
    few, many = api.get(f"{ROTOR}/inspections").json()["items"]
    assert few == api.get(f"{ROTOR}/inspections/few").json()
    assert len(few["values"]) == FEW
    assert few["status"] == "replaced"
    assert "count" not in few
    whole = api.get(f"{ROTOR}/inspections/many").json()
    assert len(whole["values"]) == FEW + 1
    assert many == whole | {"values": None, "nodes": None, "count": FEW + 1}
    with store.read() as tx:
        read = tx.log.page(rotor, "inspection", None, 10, most_values=FEW)
        assert "values" not in read[1].body, "it is not taken out of the database"
        assert read[0] == tx.log.page(rotor, "inspection", None, 10)[0]
        assert [event.body for event in tx.log.overruled(rotor, ["few"])] == [""]


def test_a_service_that_lets_nobody_wait_long_answers_plain_reads(
    serving: Serving, rotor: str
) -> None:
    """Of a request that waits for nothing nobody asks how long it would."""
    for most in (0.0, 10.0):
        with serving(wait_max_s=most) as client:
            assert client.get(ROTOR).status_code == 200
            assert client.get(ROTOR, params={"wait_for": 0}).status_code == 200
            long = client.get(ROTOR, params={"wait_for": 0, "timeout": most + 1})
            assert long.status_code == 422
            assert long.json()["faults"][0]["field"] == "timeout"


def test_the_line_of_a_request_names_the_entries_that_it_appended(
    api: httpx.Client, rotor: str, caplog: pytest.LogCaptureFixture
) -> None:
    told: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: told.append(JsonLines().format(record))  # type: ignore[method-assign]
    logger = logging.getLogger("bladetwin")
    logger.addHandler(handler)
    caplog.set_level(logging.INFO, "bladetwin")
    try:
        one = {"blade": "B1", "quantity": "elongation", "time_h": 8000.0, "value": 0.11}
        many = {"inspections": [one | {"id": name} for name in "ab"]}
        assert api.post(f"{ROTOR}/inspections", json=many).status_code == 202
        assert api.post(f"{ROTOR}/inspections", json=one | {"id": "c"}).status_code == 202
        assert api.post(f"{ROTOR}/inspections", json=one | {"id": "c"}).status_code == 202
        assert api.get(ROTOR).status_code == 200
    finally:
        logger.removeHandler(handler)
    lines = [json.loads(line) for line in told]
    posts = [line for line in lines if line["message"].startswith("POST")]
    assert [line.get("entries") for line in posts] == ["1-2", "3-3", None]
    assert all("request_id" in line for line in posts)
