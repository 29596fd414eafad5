"""The OpenAPI document holds, with and without keys.

Requests are made from the document by schemathesis, such as fit it and such as do not, from a fixed
seed, and sent over a real connection; what comes back is held against the document.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import cache
from typing import Any

import httpx
import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, seed
from hypothesis import settings as hypothesis_settings
from schemathesis import GenerationMode
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
)
from sqlalchemy import update

from service.api.routers import rotors
from service.bootstrap import make_worker
from service.handlers.models import HDF5
from service.handlers.webhooks import create_webhook
from service.store import hook_tables as t
from service.store.outbox import post as note
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker
from tests.exchanger import NETWORK
from tests.service.adopting import Offsets
from tests.service.test_adoption import OFF, visits

Json = dict[str, Any]
Serving = Callable[..., AbstractContextManager[httpx.Client]]
CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
]
READING = {"id": "i1", "blade": "B1", "quantity": "elongation", "time_h": 8000.0, "value": 0.11}
NAMES = {"r": "r1", "b": "B1", "i": "i1", "m": "rotor-blade", "id": "none", "d": "d1", "w": "w1"}
DOOMED = {"DELETE /v1/webhooks/{w}": {"w": "w2"}}  # others still need the first one
FOR_OPERATORS = {
    *("GET /v1/audit", "GET /v1/webhooks", "GET /v1/webhooks/{w}"),
    "GET /v1/webhooks/{w}/deliveries",
}


@pytest.fixture
def database_url(sqlite_url: str) -> str:
    """The document is the same on both databases; SQLite is the quicker one."""
    return sqlite_url


@pytest.fixture
def science() -> Offsets:
    """The twin that names effects, so that some can be adopted."""
    return Offsets()


@pytest.fixture
def hooks(tmp_path: Any, store: SqlStore, rotor: str) -> Json:
    """Settings with which webhooks are in use; two are there, and a delivery of the first."""
    file = tmp_path / "webhook_key"
    file.write_text("7d" * 32)
    for name in ("w1", "w2"):
        create_webhook(store, str(file), "", name, "https://plant.example/x", None, None)
    with store.write() as tx:
        note(tx.connection, rotor, "blocked", {"error": "e", "event": None})
        first = update(t.delivery).where(t.delivery.c.webhook_id == "w1")
        tx.connection.execute(first.values(message_id="d1"))
    return {"webhook_key_file": str(file)}


def fitted(label: str, body: Any) -> Any:
    """A body whose names are those of things that are there, so that some requests are done."""
    if not isinstance(body, dict):
        return body
    if label == "POST /v1/rotors":
        return body | {"model": "rotor-blade", "network": None, "blades": [{"id": "B1"}]}
    if label == "POST /v1/models" and "builtin" in body:
        return {"builtin": "rotor-blade"}
    if label == "POST /v1/models" and {"network", "runs"} <= body.keys():
        return {"id": "mine", "network": NETWORK, "runs": HDF5 + b"runs"}
    if label == "POST /v1/webhooks":
        return body | {"url": "https://plant.example/x"}
    if label.endswith("/inspections"):
        known = {"blade": "B1", "quantity": "elongation", "time_h": 8000.0, "values": [0.1]}
        known |= {"value": None, "nodes": None, "unit": "mm"}
        rows = body.get("inspections")
        if isinstance(rows, list):
            fit = [one | known if isinstance(one, dict) else one for one in rows]
            return body | {"inspections": fit}
        return body | known
    return body


@cache
def requests_of(document: str) -> list[tuple[Any, GenerationMode, Any]]:
    """Each operation of a document with what makes its requests, such as fit it and such as do not.

    To make that takes longer than to send some: it is the same for everybody who asks.
    """
    made = []
    for found in schemathesis.openapi.from_dict(json.loads(document)).get_all_operations():
        operation = found.ok()
        if operation.label in ("GET /v1/rotors/{r}/events", "GET /metrics"):
            continue  # a stream does not end, and neither is JSON: see test_events, test_metrics
        takes = any(operation.iter_parameters()) or operation.body
        for mode in [GenerationMode.POSITIVE] + [GenerationMode.NEGATIVE] * bool(takes):
            made.append((operation, mode, operation.as_strategy(generation_mode=mode)))
    return made


def answered(
    client: httpx.Client, document: Json, headers: dict[str, str], examples: int
) -> dict[str, dict[int, int]]:
    """How often each operation was answered with each status; a breach of the document raises."""
    seen: dict[str, dict[int, int]] = {}
    for operation, mode, strategy in requests_of(json.dumps(document)):
        told = seen.setdefault(operation.label, {})
        for known in (False, True):
            send(operation, mode, strategy, known, told, client, headers, examples)
    return seen


def send(
    operation: Any,
    mode: GenerationMode,
    strategy: Any,
    known: bool,
    told: dict[int, int],
    client: httpx.Client,
    headers: dict[str, str],
    examples: int,
) -> None:
    """Send some requests of one operation; `known`: with names of things that are there."""

    @seed(20310504)
    @hypothesis_settings(
        max_examples=examples,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(case=strategy)
    def one(case: Any) -> None:
        if known:
            names = NAMES | DOOMED.get(operation.label, {})
            case.path_parameters = {name: names[name] for name in case.path_parameters or {}}
            case.body = fitted(operation.label, case.body)
        if mode is GenerationMode.POSITIVE and "wait_for" in (case.query or {}):
            case.query["timeout"] = 0.0  # else it waits for half a minute, as it should
        answer = case.call_and_validate(
            base_url=str(client.base_url), headers=headers, checks=CHECKS, timeout=90.0
        )
        told[answer.status_code] = told.get(answer.status_code, 0) + 1

    one()


def test_the_document_is_kept_where_no_key_is_needed(
    serving: Serving,
    rotor: str,
    worker: Worker,
    store: SqlStore,
    hooks: Json,
    post: Callable[..., int],
    reading: Callable[..., Any],
) -> None:
    through = post(rotor, *visits(reading, OFF))
    worker.drain()
    with serving(**hooks) as client:
        client.post("/v1/rotors/r1/inspections", json=READING)
        worker.drain()
        request = {"families": [], "compare": True, "horizon_h": 5e4, "through_seq": through}
        with store.write() as tx:
            tx.records.put_job("d1", "diagnose", request, "r1")
        make_worker(store, worker.science, worker.settings, "d", "diagnose").drain()
        seen = answered(client, client.get("/openapi.json").json(), {}, 3)
    done = {label for label, told in seen.items() if {200, 201, 202} & set(told)}
    assert done | {"GET /v1/jobs/{id}"} == set(seen), "every operation was done, not only refused"
    refused = {label for label, told in seen.items() if {404, 412, 422} & set(told)}
    assert len(refused) == len(seen) - 2, "all but healthz and readyz"
    assert not {401, 403, 405, 429} & {status for told in seen.values() for status in told}


def test_the_document_is_kept_where_keys_are_needed(
    serving: Serving, rotor: str, worker: Worker, key: Callable[..., dict[str, str]], hooks: Json
) -> None:
    worker.drain()
    everything = key("read", "ingest", "operate")
    with serving(keys="always", rate_per_s=0.0, **hooks) as client:
        document = client.get("/openapi.json", headers=everything).json()
        without = answered(client, document, {}, 1)
        reader = answered(client, document, key("read"), 1)
        chief = answered(client, document, everything, 1)
    guarded = set(without) - {"GET /healthz", "GET /readyz"}
    assert {label for label, told in without.items() if set(told) == {401}} == guarded
    # Among requests that do not fit are some whose Authorization does not: 401.
    beyond = {label for label, told in reader.items() if 403 in told}
    assert beyond == seen_changes(document) | FOR_OPERATORS
    assert all(set(reader[label]) <= {401, 403} for label in beyond)
    assert not [label for label, told in chief.items() if 403 in told or set(told) == {401}]


def seen_changes(document: Json) -> set[str]:
    paths = document["paths"].items()
    return {f"{m.upper()} {path}" for path, methods in paths for m in methods if m != "get"}


def test_an_answer_that_breaks_the_document_is_seen(
    serving: Serving, rotor: str, worker: Worker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Negative controls: a lost field, a field that nobody named, a server's failure."""
    worker.drain()
    true = rotors.view_out
    faults: list[Callable[[Any], Json]] = [
        lambda view: {k: v for k, v in true(view).items() if k != "head_seq"},
        lambda view: true(view) | {"colour": "red"},
        lambda view: true(view) | {"version": "1"},
        lambda view: true(view) | {"version": 1 / 0},
    ]
    for wrong in faults:
        monkeypatch.setattr(rotors, "view_out", wrong)
        with serving() as client:
            document = client.get("/openapi.json").json()
            path = "/v1/rotors/{r}"
            document["paths"] = {path: {"get": document["paths"][path]["get"]}}
            with pytest.raises(BaseException, match=r"(?i)schema|server error"):
                answered(client, document, {}, 4)


def examples_of(document: Json) -> Iterator[tuple[str, str, Any]]:
    """(path, media type, body) of every example of a body in the document."""
    schemas = document["components"]["schemas"]
    for path, methods in document["paths"].items():
        for kind, told in methods.get("post", {}).get("requestBody", {}).get("content", {}).items():
            named = [one["value"] for one in told.get("examples", {}).values()]
            named += [told["example"]] if "example" in told else []
            schema = told["schema"]
            schema = schema.get("anyOf", [schema])[0]  # the body, where it may be left out
            if "$ref" in schema:
                schema = schemas[schema["$ref"].rpartition("/")[2]]
            named += schema.get("examples", []) if not named else []
            yield from ((path, kind, body) for body in named)


def test_every_example_of_the_document_can_be_posted(serving: Serving, tmp_path: Any) -> None:
    file = tmp_path / "webhook_key"
    file.write_text("7d" * 32)
    with serving(webhook_key_file=str(file)) as api:
        check_examples(api)


def check_examples(api: httpx.Client) -> None:
    document = api.get("/openapi.json").json()
    found = list(examples_of(document))
    order = ["/v1/models", "/v1/rotors", "/v1/rotors/{r}/blades", "/v1/rotors/{r}/inspections"]
    order += ["/v1/rotors/{r}/diagnoses", "/v1/rotors/{r}/diagnoses/{d}/adoption"]
    order += ["/v1/rotors/{r}/policy", "/v1/webhooks"]
    assert {path for path, _, _ in found} == set(order)
    diagnosis = ""
    for path, kind, body in sorted(found, key=lambda one: order.index(one[0])):
        if path == "/v1/rotors":
            body = body | {"network": None}  # the trial's model has other parameters
        content = body if kind == "text/csv" else json.dumps(body)
        url = path.replace("{r}", "r1").replace("{d}", diagnosis)
        sent = api.post(url, content=content, headers={"content-type": kind})
        if path.endswith("/diagnoses"):
            diagnosis = sent.json()["diagnosis"]["id"]
        if path.endswith("/adoption"):  # understood, of a diagnosis that is not done yet
            assert (sent.status_code, "it is queued" in sent.text) == (409, True), sent.text
            continue
        assert sent.status_code in (200, 201, 202), sent.text
