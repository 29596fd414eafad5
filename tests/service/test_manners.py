"""HTTP manners: repeats, tags, preconditions, rates, headers, compression, other origins."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import httpx
import pytest
from hypothesis import example, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from sqlalchemy import text
from starlette.requests import Request

from service.api import repeats
from service.api.rate import MOST_BUCKETS, Buckets
from service.api.repeats import fingerprint
from service.api.scopes import RULES
from service.bootstrap import make_worker
from service.client import Client
from service.fake import FakeScience
from service.handlers import models
from service.handlers.inspections import _event as event_of
from service.store.engine import transaction
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker
from tests.patience import PATIENCE_S

Headers = dict[str, str]
Key = Callable[..., Headers]
Serving = Callable[..., AbstractContextManager[httpx.Client]]
URL = "/v1/rotors/r1/inspections"
READING = {"id": "i1", "blade": "B1", "quantity": "elongation", "time_h": 8000.0, "value": 0.11}
BUILTIN = {"builtin": "rotor-blade"}


def repeat(name: str) -> Headers:
    return {"Idempotency-Key": name}


def test_the_same_request_with_the_same_key_is_done_once(api: httpx.Client) -> None:
    first = api.post("/v1/models", json=BUILTIN, headers=repeat("k1"))
    again = api.post("/v1/models", json=BUILTIN, headers=repeat("k1"))
    assert (first.status_code, again.status_code) == (202, 202)
    assert again.content == first.content
    assert again.headers["location"] == first.headers["location"]
    assert again.headers["content-type"] == first.headers["content-type"]
    assert again.headers["idempotent-replayed"] == "true"
    assert "idempotent-replayed" not in first.headers
    jobs = {
        api.post("/v1/models", json=BUILTIN, headers=h).json()["job"]["id"]
        for h in (repeat("k2"), {}, {})
    }
    assert len(jobs | {first.json()["job"]["id"]}) == 4, "negative control: else a new job each"


def test_the_same_key_with_another_request_is_refused(api: httpx.Client, rotor: str) -> None:
    assert api.post(URL, json=READING, headers=repeat("k1")).status_code == 202
    others = [
        (URL, {"json": READING | {"value": 0.12}}),
        ("/v1/rotors/r1/blades", {"json": READING}),
        (URL + "?x=1", {"json": READING}),
        (URL, {"content": b"id", "headers": {"content-type": "text/csv"}}),
    ]
    for path, body in others:
        body["headers"] = repeat("k1") | dict(body.get("headers", {}))  # type: ignore[arg-type]
        refused = api.post(path, **body)  # type: ignore[arg-type]
        assert refused.status_code == 422
        assert refused.json()["type"].endswith(":idempotency-key-reused")
    assert api.get("/v1/rotors/r1").json()["head_seq"] == 1
    for bad in ("", "x" * 256, "a b"):
        refused = api.post(URL, json=READING, headers=repeat(bad))
        assert refused.json()["faults"][0]["field"] == "Idempotency-Key", bad


def test_a_form_sent_again_has_another_boundary_and_is_the_same(api: httpx.Client) -> None:
    """Clients choose it at random; parts of a form that differ are another request."""
    parts = {"network": ("network.yaml", b"name: n"), "runs": ("runs.nc", b"no runs")}
    url, fields = "http://twin/v1/models", {"id": "mine"}
    one, other = (httpx.Request("POST", url, data=fields, files=parts) for _ in range(2))
    assert one.headers["content-type"] != other.headers["content-type"]

    def mark(request: httpx.Request) -> str:
        scope = {
            "type": "http", "method": "POST", "path": "/v1/models", "query_string": b"",
            "headers": [(k.lower().encode(), v.encode()) for k, v in request.headers.items()],
            "server": ("twin", 80), "scheme": "http",
        }  # fmt: skip
        return fingerprint(Request(scope), request.read())

    assert mark(one) == mark(other)
    changed = parts | {"runs": ("runs.nc", b"other runs")}
    assert mark(one) != mark(httpx.Request("POST", url, data=fields, files=changed))
    assert mark(one) != mark(httpx.Request("POST", url, data=fields | {"id": "b"}, files=parts))


def test_a_refused_request_frees_its_key(api: httpx.Client, rotor: str) -> None:
    assert api.post(URL, json=READING | {"blade": "B9"}, headers=repeat("k")).status_code == 422
    assert api.post(URL, json=READING, headers=repeat("k")).status_code == 202


def test_a_failed_request_frees_its_key(
    api: httpx.Client, rotor: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(models, "request_builtin", lambda *args: 1 / 0)
        assert api.post("/v1/models", json=BUILTIN, headers=repeat("k")).status_code == 500
    done = api.post("/v1/models", json=BUILTIN, headers=repeat("k"))
    assert (done.status_code, "idempotent-replayed" in done.headers) == (202, False)


def test_of_two_at_once_one_is_done_and_one_is_told_to_wait(
    api: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    entered, leave = threading.Event(), threading.Event()
    true = models.request_builtin
    done: list[str] = []

    def slow(*args: Any) -> Any:
        entered.set()
        assert leave.wait(PATIENCE_S)
        job = true(*args)
        done.append(job.id)
        return job

    monkeypatch.setattr(models, "request_builtin", slow)
    answers: list[httpx.Response] = []

    def first() -> None:
        with httpx.Client(base_url=api.base_url, timeout=60) as client:
            answers.append(client.post("/v1/models", json=BUILTIN, headers=repeat("k")))

    thread = threading.Thread(target=first)
    thread.start()
    assert entered.wait(PATIENCE_S)
    second = api.post("/v1/models", json=BUILTIN, headers=repeat("k"))
    other = api.post("/v1/models", json={"builtin": "other"}, headers=repeat("k"))
    leave.set()
    thread.join()
    assert (second.status_code, second.headers["retry-after"]) == (409, "1")
    assert second.json()["type"].endswith(":in-progress")
    assert other.status_code == 422
    third = api.post("/v1/models", json=BUILTIN, headers=repeat("k"))
    assert third.json()["job"]["id"] == answers[0].json()["job"]["id"]
    assert len(done) == 1


def test_an_answer_is_kept_for_its_time_and_a_request_that_died_is_done_again(
    serving: Serving, store: SqlStore
) -> None:
    def shift(column: str, seconds: float) -> None:
        with transaction(store.engine, write=True) as connection:
            connection.execute(
                text(f"UPDATE first_answer SET {column} = {column} - :s"), {"s": seconds}
            )

    def ask(client: httpx.Client) -> tuple[int, bool]:
        answer = client.post("/v1/models", json=BUILTIN, headers=repeat("k"))
        return answer.status_code, "idempotent-replayed" in answer.headers

    with serving(idempotency_h=2.0) as client:
        assert ask(client) == (202, False)
        shift("expires_at", 7000)
        assert ask(client) == (202, True)
        shift("expires_at", 300)
        assert ask(client) == (202, False)
        with transaction(store.engine, write=True) as connection:
            connection.execute(text("UPDATE first_answer SET status = NULL"))
        shift("begun_at", repeats.STALE_S - 60)
        assert ask(client)[0] == 409
        shift("begun_at", 61)
        assert ask(client) == (202, False)


@pytest.mark.parametrize(("ahead_s", "status"), [(60.0, 409), (3600.0, 202)])
def test_a_request_that_died_before_the_clock_was_set_back_is_done_again(
    serving: Serving, store: SqlStore, ahead_s: float, status: int
) -> None:
    """It was told to be in progress until the clock had caught up."""
    with serving() as client:
        client.post("/v1/models", json=BUILTIN, headers=repeat("k"))
        ahead = "UPDATE first_answer SET status = NULL, begun_at = begun_at + :s"
        with transaction(store.engine, write=True) as connection:
            connection.execute(text(ahead), {"s": ahead_s})
        answer = client.post("/v1/models", json=BUILTIN, headers=repeat("k"))
        assert answer.status_code == status


def test_keys_of_one_client_mean_nothing_for_another(serving: Serving, key: Key) -> None:
    with serving(keys="always") as client:
        jobs = {
            client.post("/v1/models", json=BUILTIN, headers=key("operate") | repeat("k")).json()[
                "job"
            ]["id"]
            for _ in range(2)
        }
    assert len(jobs) == 2


READS = {
    "/openapi.json": None,
    "/v1/models": None,
    "/v1/models/rotor-blade": None,
    "/v1/jobs/{job}": "job",
    "/v1/rotors": "reading",
    "/v1/rotors/r1": "reading",
    "/v1/rotors/r1/inspections": "reading",
    "/v1/rotors/r1/inspections/i1": "retraction",
    "/v1/rotors/r1/posterior": "reading",
    "/v1/rotors/r1/blades/B1/posterior": "reading",
    "/v1/rotors/r1/blades/B1/prediction": "reading",
    "/v1/rotors/r1/blades": "reading",
    "/v1/rotors/r1/draws": "reading",
    "/v1/rotors/r1/blades/B1/draws": "reading",
    "/v1/rotors/r1/blades/B1/field": "reading",
    "/v1/rotors/r1/field": "reading",
    "/v1/rotors/r1/versions": "reading",
    "/v1/models/rotor-blade/surface": None,
    "/v1/rotors/r1/diagnoses": "diagnosis",
    "/v1/rotors/r1/diagnoses/{diagnosis}": "diagnosis",
    "/v1/rotors/r1/adoptions": None,
    "/v1/rotors/r1/residuals": "reading",
    "/v1/rotors/r1/plan": "reading",
    "/v1/rotors/r1/blades/B1/life?limit=0.3": "reading",
    "/v1/rotors/r1/life?limit=0.3": "reading",
    "/v1/rotors/r1/series?times=8000": "reading",
    "/v1/audit": "reading",
}
APART = {
    "GET /metrics", "GET /v1/operations", "GET /v1/rotors/{r}/events",  # a moment, a stream
    "GET /v1/rotors/{r}/diagnoses/{d}/report",  # of what has ended: test_report
    "GET /v1/webhooks", "GET /v1/webhooks/{w}", "GET /v1/webhooks/{w}/deliveries",  # by key file
}  # fmt: skip


def test_everything_that_is_stored_is_read_with_a_tag(
    api: httpx.Client, rotor: str, worker: Worker
) -> None:
    gets = {name for name, rule in RULES.items() if name[:3] == "GET" and rule.scope != "open"}
    assert gets > APART
    assert len(READS) == len(gets - APART), "every route is read here"
    api.headers["Accept-Encoding"] = "identity"
    api.post(URL, json=READING)
    worker.drain()
    job = api.post("/v1/models", json=BUILTIN).json()["job"]["id"]
    asked = api.post("/v1/rotors/r1/diagnoses").json()["diagnosis"]["id"]
    paths = {path.format(job=job, diagnosis=asked): change for path, change in READS.items()}
    tags = {path: api.get(path).headers["etag"] for path in paths}
    for path, tag in tags.items():
        assert api.get(path).headers["etag"] == tag, path
        for header in (tag, f"W/{tag}", f'"x", {tag}', "*"):
            same = api.get(path, headers={"If-None-Match": header})
            assert (same.status_code, same.content, same.headers["etag"]) == (304, b"", tag), path
            assert "content-type" not in same.headers
        other = api.get(path, headers={"If-None-Match": '"x"'})
        assert (other.status_code, len(other.content) > 2) == (200, True)
        kept = "no-store" if path == "/v1/audit" else "private, no-cache"
        assert other.headers["cache-control"] == kept
    api.post(URL, json=READING | {"id": "i2", "value": 0.13})
    api.post(f"{URL}/i1/retraction")
    worker.drain()
    make_worker(worker.store, worker.science, worker.settings, "d", "diagnose").drain()
    changed = {path for path, tag in tags.items() if api.get(path).headers["etag"] != tag}
    assert changed == {path for path, change in paths.items() if change is not None}
    assert "etag" not in api.get("/readyz").headers
    assert "etag" not in api.get("/v1/rotors/zz").headers


def test_a_change_is_made_only_while_the_rotor_stands_as_it_was_seen(
    api: httpx.Client, rotor: str, worker: Worker
) -> None:
    worker.drain()
    seen = api.get("/v1/rotors/r1").headers["etag"]
    waited = api.get("/v1/rotors/r1?wait_for=0&timeout=1").headers["etag"]
    assert waited == seen, "however it was asked for"
    for form in ("{}", '"x", {}', "*", "{gz}"):
        seen = api.get("/v1/rotors/r1").headers["etag"]
        header = form.format(seen, gz=seen[:-1] + '-gz"')
        sent = api.post(URL, json=READING | {"id": f"i{len(form)}"}, headers={"If-Match": header})
        assert sent.status_code == 202, header
        worker.drain()
    seen = api.get("/v1/rotors/r1").headers["etag"]
    old = waited
    head = api.get("/v1/rotors/r1").json()["head_seq"]
    for path, body in (
        (URL, READING | {"id": "late"}),
        (f"{URL}/i1/retraction", None),
        ("/v1/rotors/r1/blades", {"id": "B9"}),
        ("/v1/rotors/r1/blades/B1/retirement", None),
        ("/v1/rotors/r1/retry", None),
        ("/v1/rotors/r1/policy", {"adopt": "effect"}),
    ):
        for header in (old, f"W/{seen}", '"x"', "nonsense"):
            refused = api.post(path, json=body, headers={"If-Match": header})
            assert refused.status_code == 412, (path, header)
            assert refused.json()["faults"][0]["field"] == "If-Match"
    assert api.post("/v1/models", json=BUILTIN, headers={"If-Match": "*"}).status_code == 412
    new = {"id": "r2", "model": "rotor-blade", "blades": [{"id": "B1"}], "particles": 64}
    for status in (404, 201):  # a creation, then its repetition
        for header in (seen, "*", '"x"'):
            refused = api.post("/v1/rotors", json=new, headers={"If-Match": header})
            assert refused.status_code == 412, (status, header)
            assert "leave If-Match out" in refused.json()["faults"][0]["remedy"]
        assert api.get("/v1/rotors/r2").status_code == (404 if status == 404 else 200)
        assert api.post("/v1/rotors", json=new).status_code == 201
    rows = api.get("/v1/audit", params={"limit": 8}).json()["items"]
    assert [row["status"] for row in rows] == [201, 412, 412, 412, 201, 412, 412, 412]
    missing = api.post("/v1/rotors/zz/retry", headers={"If-Match": "*"})
    assert missing.status_code == 404
    assert api.get("/v1/rotors/r1").json()["head_seq"] == head
    assert api.get("/v1/rotors/r1").headers["etag"] == seen


@contextmanager
def judged_before(store: SqlStore) -> Iterator[Any]:
    """A mutant of `SqlStore.write` that judges the precondition in a transaction before."""
    if store._guard is not None:
        with store.read() as tx:
            tx.log.lock = tx.records.rotor  # type: ignore[method-assign, assignment]
            store._guard(tx)
            JUDGED.set()
    with TRUE_WRITE(copy_without_guard(store)) as tx:
        yield tx


TRUE_WRITE, JUDGED = SqlStore.write, threading.Event()


def copy_without_guard(store: SqlStore) -> SqlStore:
    return store if store._act is None else store.acting_for(store._act)  # type: ignore[return-value]


@pytest.mark.parametrize(("mutant", "status", "head"), [(False, 412, 1), (True, 202, 2)])
def test_a_precondition_is_judged_inside_the_transaction(
    api: httpx.Client,
    store: SqlStore,
    rotor: str,
    reading: Any,
    monkeypatch: pytest.MonkeyPatch,
    mutant: bool,
    status: int,
    head: int,
) -> None:
    """A reading that is being committed while the request comes counts against it."""
    if mutant:
        monkeypatch.setattr(SqlStore, "write", judged_before)
        JUDGED.clear()
    tag = api.get("/v1/rotors/r1").headers["etag"]
    answers: list[httpx.Response] = []

    def retire() -> None:
        with httpx.Client(base_url=api.base_url, timeout=60) as client:
            url = "/v1/rotors/r1/blades/B1/retirement"
            answers.append(client.post(url, headers={"If-Match": tag}))

    thread = threading.Thread(target=retire)
    with store.write() as tx:
        tx.log.append("r1", [event_of(reading("i1"))])
        thread.start()
        if mutant:
            assert JUDGED.wait(PATIENCE_S), "before the reading is there"
        time.sleep(0.5)
        assert answers == [], "it waits for the rotor"
    thread.join(PATIENCE_S)
    assert answers[0].status_code == status
    assert api.get("/v1/rotors/r1").json()["head_seq"] == head


def test_a_bucket_is_emptied_per_key_and_per_address(serving: Serving, key: Key) -> None:
    one, other = key("read"), key("read")
    with serving(keys="always", rate_per_s=0.02, rate_burst=3) as client:
        left = [client.get("/v1/models", headers=one).headers["ratelimit"] for _ in range(3)]
        assert [text.split(";")[1] for text in left] == ["r=2", "r=1", "r=0"]
        refused = client.get("/v1/models", headers=one)
        assert refused.status_code == 429
        assert refused.json()["type"].endswith(":too-many-requests")
        assert 40 <= int(refused.headers["retry-after"]) <= 50
        assert refused.headers["ratelimit-policy"] == '"key";q=3;w=150'
        assert refused.headers["ratelimit"].startswith('"key";r=0;t=1')
        assert client.get("/v1/models", headers=other).status_code == 200, "another key goes on"
        strangers = [client.get("/v1/models").status_code for _ in range(4)]
        assert strangers == [401, 401, 401, 429]
        wrong = {"Authorization": "Bearer btk_0123456789ab_" + 43 * "A"}
        assert client.get("/v1/models", headers=wrong).status_code == 429
        assert client.get("/v1/models", headers=other).status_code == 200
        assert client.get("/healthz").status_code == 200
    with serving() as client:
        answers = [client.get("/v1/models") for _ in range(250)]
        assert {answer.status_code for answer in answers} == {200}, "none on the loopback"
        assert "ratelimit" not in answers[0].headers
    with serving(rate_per_s=0.02, rate_burst=1) as client:
        assert [client.get("/v1/models").status_code for _ in range(2)] == [200, 429]
    with serving(keys="always") as client:
        policy = client.get("/v1/models", headers=one).headers["ratelimit-policy"]
        assert policy == '"key";q=200;w=4', "50 a second where keys are needed"


@hypothesis_settings(max_examples=100, deadline=None, derandomize=True)
@given(
    rate=st.floats(0.1, 100),
    burst=st.integers(1, 20),
    pauses=st.lists(st.just(0.0) | st.floats(0, 3), min_size=1, max_size=80),
)
@example(rate=100.0, burst=1, pauses=[0.0, 3.0, 0.0, 0.0])
def test_in_no_stretch_of_time_more_pass_than_burst_and_rate_allow(
    rate: float, burst: int, pauses: list[float]
) -> None:
    now = [0.0]
    buckets = Buckets(rate, burst, lambda: now[0])
    passed: list[float] = []
    for pause in pauses:
        now[0] += pause
        taken = buckets.take("key a")
        if taken.allowed:
            passed.append(now[0])
        else:
            assert 0 < taken.wait_s <= 1 / rate * (1 + 1e-9)
    for i, begin in enumerate(passed):
        for j, end in enumerate(passed[i:], 1):
            assert j <= burst + rate * (end - begin) + 1e-6
    assert passed[:1] == [pauses[0]]


def test_buckets_of_many_addresses_do_not_fill_the_memory() -> None:
    buckets = Buckets(1.0, 1)
    for i in range(MOST_BUCKETS + 50):
        buckets.take(f"address {i}")
    assert len(buckets._levels) == MOST_BUCKETS


def test_every_answer_tells_browsers_to_mind(serving: Serving, key: Key, rotor: str) -> None:
    header = key("read")
    with serving(keys="always") as client:
        tag = client.get("/v1/rotors/r1", headers=header).headers["etag"]
        answers = [
            client.get("/v1/rotors/r1", headers=header),
            client.get("/v1/rotors/r1", headers=header | {"If-None-Match": tag}),
            client.get("/v1/rotors/zz", headers=header),
            client.get("/v1/rotors/r1"),
            client.get("/healthz"),
            client.post(URL, headers=header, json=READING),
        ]
    assert [a.status_code for a in answers] == [200, 304, 404, 401, 200, 403]
    for answer in answers:
        assert answer.headers["x-content-type-options"] == "nosniff"
        policy = answer.headers["content-security-policy"]
        assert "default-src 'self'" in policy
        assert "frame-ancestors 'none'" in policy
        assert answer.headers["referrer-policy"] == "no-referrer"
        assert answer.headers["x-request-id"]
    kept = [a.headers["cache-control"] for a in answers]
    assert kept == 2 * ["private, no-cache"] + 4 * ["no-store"]


def test_a_large_answer_is_compressed_for_those_who_accept_it(
    api: httpx.Client, rotor: str, worker: Worker
) -> None:
    worker.drain()
    batch = [READING | {"id": f"i{i}"} for i in range(40)]
    api.post(URL, json={"inspections": batch})
    plain = api.get(URL, headers={"Accept-Encoding": "identity"})
    packed = api.get(URL, headers={"Accept-Encoding": "gzip"})
    assert "content-encoding" not in plain.headers
    assert packed.headers["content-encoding"] == "gzip"
    assert int(packed.headers["content-length"]) < len(plain.content) / 3
    assert packed.json() == plain.json()
    assert "Accept-Encoding" in plain.headers["vary"]
    assert packed.headers["etag"] == plain.headers["etag"][:-1] + '-gz"'
    for tag in (plain.headers["etag"], packed.headers["etag"]):
        same = api.get(URL, headers={"Accept-Encoding": "gzip", "If-None-Match": tag})
        assert (same.status_code, same.headers["etag"]) == (304, tag)
    assert "content-encoding" not in api.get("/v1/rotors").headers, "small ones are not"


def test_pages_of_other_origins_may_call_only_where_they_are_named(
    serving: Serving, key: Key
) -> None:
    page = {"Origin": "https://plant.example"}
    asked = page | {
        "Access-Control-Request-Method": "POST",
        "Access-Control-Request-Headers": "authorization, idempotency-key",
    }
    header = key("read")
    with serving(keys="always") as client:
        answer = client.get("/v1/models", headers=header | page)
        assert not [name for name in answer.headers if name.startswith("access-control")]
        assert client.options("/v1/models", headers=asked).status_code == 401
    with serving(keys="always", cors_origins="https://other.example, https://plant.example") as c:
        answer = c.get("/v1/models", headers=header | page)
        assert answer.headers["access-control-allow-origin"] == "https://plant.example"
        assert "ETag" in answer.headers["access-control-expose-headers"]
        assert c.options("/v1/models", headers=asked).status_code == 200
        evil = {"Origin": "https://evil.example"}
        answer = c.get("/v1/models", headers=header | evil)
        assert "access-control-allow-origin" not in answer.headers
        assert c.options("/v1/models", headers=asked | evil).status_code == 400
        assert c.get("/v1/models", headers=page).status_code == 401, "a key all the same"


def test_the_client_sends_its_key(serving: Serving, key: Key, rotor: str) -> None:
    token = key("read")["Authorization"].removeprefix("Bearer ")
    with serving(keys="always") as http, Client(str(http.base_url), key=token) as twin:
        assert twin.rotor("r1")["id"] == "r1"


def test_an_unforeseen_error_has_the_same_manners(
    api: httpx.Client, rotor: str, worker: Worker, monkeypatch: pytest.MonkeyPatch
) -> None:
    worker.drain()
    monkeypatch.setattr(FakeScience, "predict", lambda *args, **kw: 1 / 0)
    failed = api.get("/v1/rotors/r1/blades/B1/prediction", headers={"X-Request-Id": "q"})
    assert (failed.status_code, failed.headers["x-request-id"]) == (500, "q")
    assert failed.headers["x-content-type-options"] == "nosniff"
    assert json.loads(failed.content)["detail"].startswith("the service failed")
