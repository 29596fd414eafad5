"""One trace from the POST to the sealed state, and nothing secret in it."""

from __future__ import annotations

import gzip
import json
import logging
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
import pytest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from opentelemetry.sdk.trace.export import SimpleSpanProcessor
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter

from core.errors import InputError
from core.observation import Inspection
from service import tracing
from service.client import Client
from service.errors import NotInstalledError
from service.fake import FakeScience
from service.free_port import free_port
from service.otel import OtelTracer
from service.settings import Settings
from service.store.unit_of_work import SqlStore
from service.telemetry import JsonLines
from service.worker.loop import Worker
from service.worker.supervise import same_code
from tests.patience import PATIENCE_S, until
from tests.service.test_contract import READING

Post = Callable[..., int]
Make = Callable[..., Inspection]
MINE = "4bf92f3577b34da6a3ce929d0e0e4736"
PARENT = f"00-{MINE}-00f067aa0ba902b7-01"
ROUTE = "/v1/rotors/{rotor_id}/inspections"


@pytest.fixture
def spans() -> Iterator[InMemorySpanExporter]:
    """What has ended, in memory."""
    exporter = InMemorySpanExporter()
    tracing.use(OtelTracer(SimpleSpanProcessor(exporter), "tests", "one"))
    yield exporter
    tracing.end()


def named(spans: InMemorySpanExporter, name: str, count: int = 0) -> list[Any]:
    """Spans by the beginning of their name; one of a request ends right after its answer."""
    end = time.monotonic() + PATIENCE_S
    while True:
        found = [one for one in spans.get_finished_spans() if one.name.startswith(name)]
        if len(found) >= count or time.monotonic() > end:
            return found
        time.sleep(0.01)


def trace_of(span: Any) -> str:
    return f"{span.context.trace_id:032x}"


def readings(*names: str) -> dict[str, Any]:
    return {"inspections": [READING | {"id": name, "blade": "B1"} for name in names]}


def test_a_trace_leads_from_the_clients_post_to_the_sealed_version(
    api: httpx.Client, rotor: str, store: SqlStore, settings: Settings, spans: InMemorySpanExporter
) -> None:
    from service.bootstrap import make_worker

    worker = make_worker(store, FakeScience(provisional=True), settings, "w")
    answer = api.post(
        "/v1/rotors/r1/inspections",
        json=readings("i1", "i2"),
        headers={"traceparent": PARENT, "tracestate": "plant=7"},
    )
    assert answer.status_code == 202
    worker.drain()
    (posted,) = named(spans, "POST ", 1)
    (update,), (seal,) = named(spans, "update"), named(spans, "seal")
    applied, sealed = named(spans, "entry applied"), named(spans, "entry sealed")
    assert {trace_of(one) for one in (posted, update, seal, *applied, *sealed)} == {MINE}
    assert f"{posted.parent.span_id:016x}" == "00f067aa0ba902b7"
    assert update.parent.span_id == seal.parent.span_id == posted.context.span_id
    assert [one.attributes["bladetwin.entry"] for one in applied] == ["i1", "i2"]
    assert [one.attributes["bladetwin.seq"] for one in sealed] == [1, 2]
    assert [link.context.span_id for link in sealed[1].links] == [seal.context.span_id]
    assert update.attributes["bladetwin.version"] == 1
    assert update.attributes["bladetwin.sealed"] is False
    assert seal.attributes["bladetwin.version"] == 2
    assert seal.attributes["bladetwin.sealed"] is True
    inner = {one.name: one.parent.span_id for one in spans.get_finished_spans() if one.parent}
    assert inner["commit"] == inner["compute"] == seal.context.span_id
    assert posted.attributes["http.route"] in posted.name
    assert posted.attributes["http.response.status_code"] == 202
    assert posted.attributes["bladetwin.request_id"] == answer.headers["x-request-id"]
    assert answer.headers["traceresponse"] == f"00-{MINE}-{posted.context.span_id:016x}-01"
    assert posted.context.trace_state.get("plant") == "7"


def test_readings_of_two_posts_each_find_the_version_in_their_own_trace(
    api: httpx.Client, rotor: str, worker: Worker, spans: InMemorySpanExporter
) -> None:
    for name in ("i1", "i2"):
        api.post("/v1/rotors/r1/inspections", json=readings(name))
    worker.drain()
    first, second = named(spans, "POST ", 2)
    (update,) = named(spans, "update")
    told = named(spans, "entry ")
    assert trace_of(first) != trace_of(second)
    assert trace_of(update) == trace_of(first), "the oldest entry's"
    assert [f"{link.context.trace_id:032x}" for link in update.links] == [trace_of(second)]
    assert [trace_of(one) for one in told] == [trace_of(first), trace_of(second)]


@pytest.mark.parametrize(
    "header",
    ["", "00-zz", PARENT.replace(MINE, 32 * "0"), PARENT + "-more", "ff" + PARENT[2:], 600 * "0"],
)
def test_what_is_no_traceparent_begins_a_new_trace(
    api: httpx.Client, header: str, spans: InMemorySpanExporter
) -> None:
    api.get("/v1/rotors", headers={"traceparent": header})
    api.get("/v1/rotors", headers=[("traceparent", PARENT), ("traceparent", PARENT)])
    one, two = named(spans, "GET /v1/rotors", 2)
    assert one.parent is two.parent is None
    assert MINE not in (trace_of(one), trace_of(two))


def test_what_was_not_sampled_by_the_client_is_not_written_down(
    api: httpx.Client, rotor: str, worker: Worker, spans: InMemorySpanExporter
) -> None:
    header = {"traceparent": PARENT[:-2] + "00"}
    api.post("/v1/rotors/r1/inspections", json=readings("i1"), headers=header)
    worker.drain()
    api.get("/v1/rotors")
    assert named(spans, "GET /v1/rotors", 1), "the control"
    assert not [name for name in ("POST ", "entry ", "update", "seal") if named(spans, name)]


def test_probes_and_scrapes_leave_no_span(api: httpx.Client, spans: InMemorySpanExporter) -> None:
    for path in ("/healthz", "/readyz", "/metrics"):
        assert api.get(path).status_code == 200
    assert spans.get_finished_spans() == ()


def test_no_key_no_query_and_no_value_stands_in_a_span(
    serving: Callable[..., AbstractContextManager[httpx.Client]],
    key: Callable[..., dict[str, str]],
    rotor: str,
    worker: Worker,
    spans: InMemorySpanExporter,
) -> None:
    header = key("read", "ingest", "operate")
    token = header["Authorization"].removeprefix("Bearer ")
    secret = token.split("_", 2)[2]  # which may hold further underscores
    pieces = [piece for piece in re.split("[_-]", secret) if len(piece) > 5]
    body = readings("i1") | {}
    body["inspections"][0] |= {"value": 0.123454321, "campaign": f"outage {token}"}
    with serving(keys="always") as client:
        ids = {"X-Request-Id": token, "Idempotency-Key": f"again-{token}"}
        sent = client.post("/v1/rotors/r1/inspections", json=body, headers=header | ids)
        assert sent.status_code == 202
        client.get(f"/v1/rotors/{token}", headers=header)
        client.get(f"/v1/rotors?cursor={token}", headers=header)
        client.get(f"/v1/{token}", headers=header)
        client.get("/v1/rotors", headers={"Authorization": f"Bearer {token}x"})
        client.post("/v1/rotors/r1/inspections", json=readings(token), headers=header)
    worker.drain()
    assert len(named(spans, "", 10)) >= 10
    told = "".join(one.to_json() for one in spans.get_finished_spans())
    assert pieces
    assert not [piece for piece in pieces if piece in told]
    assert "0.123454321" not in told
    assert "cursor" not in told
    hidden = json.dumps(f"btk_{token.split('_')[1]}_…").strip('"')
    assert hidden in told, "the control: a key was there to be hidden"


def test_a_failed_update_is_told_by_the_kind_of_its_error_alone(
    store: SqlStore,
    settings: Settings,
    rotor: str,
    post: Post,
    reading: Make,
    spans: InMemorySpanExporter,
) -> None:
    from service.bootstrap import make_worker

    class Failing(FakeScience):
        def update(self, *given: Any, **more: Any) -> Any:
            raise RuntimeError("a secret of the plant")

    post(rotor, reading("i1"))
    make_worker(store, Failing(), settings, "w").updater.run_once()
    (update,) = named(spans, "update")
    assert update.status.status_code.name == "ERROR"
    assert update.attributes["error.type"] == "RuntimeError"
    assert "secret" not in update.to_json()
    assert not named(spans, "entry ")


def test_a_diagnosis_goes_on_with_the_trace_of_its_request(
    api: httpx.Client,
    rotor: str,
    post: Post,
    reading: Make,
    store: SqlStore,
    settings: Settings,
    spans: InMemorySpanExporter,
) -> None:
    from service.bootstrap import make_worker

    post(rotor, reading("i1"), reading("i2", time_h=16_000.0))
    asked = api.post("/v1/rotors/r1/diagnoses", json={}, headers={"traceparent": PARENT})
    make_worker(store, FakeScience(), settings, "d", "diagnose").jobs.run_once()
    (diagnosis,) = named(spans, "diagnose")
    assert trace_of(diagnosis) == MINE
    assert diagnosis.attributes["bladetwin.job"] == asked.json()["diagnosis"]["id"]
    assert diagnosis.events, "its steps"


def test_lines_of_the_log_name_the_trace(api: httpx.Client, spans: InMemorySpanExporter) -> None:
    lines: list[dict[str, Any]] = []

    class Kept(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            lines.append(json.loads(JsonLines().format(record)))

    handler, logger = Kept(), logging.getLogger("bladetwin.http")
    logger.addHandler(handler)
    logger.setLevel("INFO")
    try:
        api.get("/v1/rotors", headers={"traceparent": PARENT})
        named(spans, "GET /v1/rotors", 1)
        until("its line", lambda: lines)
    finally:
        logger.removeHandler(handler)
    assert [line["trace_id"] for line in lines] == [MINE]


def test_without_traces_nothing_is_answered_or_kept(
    api: httpx.Client, rotor: str, store: SqlStore
) -> None:
    from sqlalchemy import text

    answer = api.post(
        "/v1/rotors/r1/inspections", json=readings("i1"), headers={"traceparent": PARENT}
    )
    assert "traceresponse" not in answer.headers
    with store.read() as tx:
        assert tx.connection.execute(text("SELECT traceparent FROM event")).scalars().all() == [
            None
        ]


class Collector(BaseHTTPRequestHandler):
    """Takes OTLP over HTTP; what came is kept by the server."""

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["content-length"]))
        if self.headers.get("content-encoding") == "gzip":
            body = gzip.decompress(body)
        self.server.got.append((self.path, dict(self.headers), body))  # type: ignore[attr-defined]
        self.send_response(200)
        self.send_header("content-length", "0")
        self.end_headers()

    def log_message(self, *given: Any) -> None:
        """Nothing on the terminal."""


@pytest.fixture
def collector() -> Iterator[ThreadingHTTPServer]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Collector)
    server.got = []  # type: ignore[attr-defined]
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield server
    server.shutdown()
    server.server_close()
    thread.join()


def sent_to(collector: ThreadingHTTPServer) -> list[tuple[str, str, Any]]:
    """(role, name, span) of every span that came."""
    found = []
    for _, _, body in collector.got:  # type: ignore[attr-defined]
        request = ExportTraceServiceRequest.FromString(body)
        for resource in request.resource_spans:
            facts = {one.key: one.value.string_value for one in resource.resource.attributes}
            assert facts["service.name"] == "bladetwin"
            for scope in resource.scope_spans:
                found += [(facts["bladetwin.role"], one.name, one) for one in scope.spans]
    return found


def serve_once(folder: Path, **environ: str) -> str:
    """`bladetwin serve` until a posted reading is sealed; what it wrote on standard error."""
    port = free_port()
    settings = {
        "BLADETWIN_DATABASE_URL": f"sqlite:///{folder / 'traced.db'}",
        "BLADETWIN_SCIENCE": "fake",
        "BLADETWIN_PORT": str(port),
        "BLADETWIN_DIAGNOSERS": "0",
        "BLADETWIN_SEAL_AFTER_S": "0",
    }
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("BLADETWIN_", "OTEL_"))}
    child = subprocess.Popen(
        [sys.executable, "-P", "-m", "service.cli", "serve"],
        env=same_code(kept | settings | environ),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        with Client(f"http://127.0.0.1:{port}") as client:
            client.ready(PATIENCE_S)
            client.create_rotor("r1", blades=["B1"])
            told = httpx.post(
                f"http://127.0.0.1:{port}/v1/rotors/r1/inspections",
                json=readings("i1"),
                headers={"traceparent": PARENT},
                timeout=PATIENCE_S,
            )
            assert told.status_code == 202
            client.wait_for("r1", 1)
            client.wait_sealed("r1")
    finally:
        child.send_signal(signal.SIGTERM)
        _, errors = child.communicate(timeout=PATIENCE_S)
    assert child.returncode == 0, errors
    return errors


def test_processes_send_one_trace_to_a_collector(
    collector: ThreadingHTTPServer, tmp_path: Path
) -> None:
    """At its end a process waits three seconds for what it still sends, which may be too short for
    a machine that stands still just then: it is asked again."""
    port = collector.server_address[1]
    wanted = {("api", "POST"), ("apply", "update"), "entry sealed"}
    for number in range(3):
        (folder := tmp_path / str(number)).mkdir()
        serve_once(folder, BLADETWIN_OTEL_ENDPOINT=f"http://127.0.0.1:{port}")
        mine = [one for one in sent_to(collector) if one[2].trace_id.hex() == MINE]
        names = {(role, name.split(" ")[0]) for role, name, _ in mine} | {one[1] for one in mine}
        if wanted <= names:
            break
    assert wanted <= names
    assert {path for path, _, _ in collector.got} == {"/v1/traces"}  # type: ignore[attr-defined]


def test_a_collector_that_is_away_holds_up_nothing(tmp_path: Path) -> None:
    errors = serve_once(
        tmp_path,
        OTEL_EXPORTER_OTLP_ENDPOINT=f"http://127.0.0.1:{free_port()}",
        OTEL_BSP_SCHEDULE_DELAY="100",
    )
    assert "export" in errors.lower()


def settings_with(url: str) -> Settings:
    return Settings(otel_endpoint=url)


def test_the_endpoint_is_ours_or_the_standard_one() -> None:
    base, traces = "OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT"
    none = Settings()
    found = tracing.endpoint
    assert found(none, {}) is None
    assert found(settings_with("http://a:4318"), {}) == "http://a:4318/v1/traces"
    assert found(settings_with("http://a/v1/traces"), {}) == "http://a/v1/traces"
    assert found(settings_with("http://a:1"), {base: "http://b"}) == "http://a:1/v1/traces"
    assert found(none, {base: "https://b/otlp/"}) == "https://b/otlp/v1/traces"
    assert found(none, {base: "http://b", traces: "http://c/in"}) == "http://c/in"
    assert found(none, {base: "http://b", "OTEL_SDK_DISABLED": "true"}) is None
    assert found(settings_with("http://a"), {"OTEL_TRACES_EXPORTER": "none"}) is None


@pytest.mark.parametrize(
    ("url", "environ", "named"),
    [
        ("collector:4318", {}, "BLADETWIN_OTEL_ENDPOINT"),
        ("http://user:geheim@collector:4318", {}, "BLADETWIN_OTEL_ENDPOINT"),
        ("", {"OTEL_EXPORTER_OTLP_ENDPOINT": "grpc://b"}, "OTEL_EXPORTER_OTLP_ENDPOINT"),
        ("http://a", {"OTEL_TRACES_EXPORTER": "zipkin"}, "OTEL_TRACES_EXPORTER"),
        ("http://a", {"OTEL_EXPORTER_OTLP_PROTOCOL": "grpc"}, "OTEL_EXPORTER_OTLP_PROTOCOL"),
    ],
)
def test_what_is_not_spoken_is_refused_by_name(
    url: str, environ: dict[str, str], named: str
) -> None:
    with pytest.raises(InputError) as refused:
        tracing.endpoint(settings_with(url), environ)
    assert named in str(refused.value)
    assert "geheim" not in str(refused.value)


def test_without_the_extra_a_set_endpoint_is_an_error_at_the_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "opentelemetry.sdk.trace", None)
    monkeypatch.delitem(sys.modules, "service.otel", raising=False)
    with pytest.raises(NotInstalledError, match=r"bladetwin\[otel\]"):
        tracing.begin(settings_with("http://127.0.0.1:4318"), "api", "x")
    assert not tracing.on()
    tracing.begin(Settings(), "api", "x")
    assert not tracing.on()
