"""Keys: who passes, who does not, and what those who do not pass learn."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from hashlib import sha256
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from sqlalchemy import text

from core.errors import InputError
from service import tokens
from service.api.loopback import by_loopback
from service.api.scopes import RULES
from service.bootstrap import check_keys, make_app
from service.errors import FaultsError, KeysMissingError
from service.fake import FakeScience
from service.handlers.keys import create_key, list_keys, recognise, revoke_key
from service.settings import Settings
from service.store.engine import transaction
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker

Headers = dict[str, str]
Key = Callable[..., Headers]
Serving = Callable[..., AbstractContextManager[httpx.Client]]
NAMES = {"{r}": "r1", "{b}": "B1", "{i}": "i1", "{m}": "rotor-blade"}
NAMES |= {"{id}": "none", "{d}": "none"}
READING = {"blade": "B1", "quantity": "elongation", "time_h": 8000.0, "value": 0.11}
BODIES: dict[str, Any] = {
    "POST /v1/models": {"builtin": "rotor-blade"},
    "POST /v1/rotors": {"id": "new", "model": "rotor-blade", "blades": [{"id": "B1"}]},
    "POST /v1/rotors/{r}/inspections": READING | {"id": "i1"},
    "POST /v1/rotors/{r}/blades": {"id": "B9"},
    "POST /v1/rotors/{r}/policy": {"adopt": "never"},
}
GUARDED = [name for name, rule in RULES.items() if rule.scope != "open"]


QUERIES = dict.fromkeys(  # what a route cannot do without
    ("GET /v1/rotors/{r}/blades/{b}/life", "GET /v1/rotors/{r}/life"), "?limit=0.3"
)


def ask(
    client: httpx.Client, name: str, headers: Headers | None = None, **names: str
) -> httpx.Response:
    """Call a route by its name in the table, with a body that it takes."""
    method, path = name.split(" ")
    for place, value in (NAMES | {f"{{{k}}}": v for k, v in names.items()}).items():
        path = path.replace(place, value)
    body = {"json": BODIES[name]} if name in BODIES else {}
    path += QUERIES.get(name, "")
    if not path.endswith("/events"):
        return client.request(method, path, headers=headers, **body)
    with client.stream(method, path, headers=headers) as answer:  # which does not end by itself
        if answer.is_error:
            answer.read()
        return answer


@pytest.fixture
def locked(serving: Serving, rotor: str, worker: Worker) -> Iterator[httpx.Client]:
    """A service with a rotor that asks everybody for a key."""
    worker.drain()
    with serving(keys="always", rate_burst=100_000) as client:
        yield client


def routes_of(app: FastAPI) -> set[str]:
    """Every route that the application would serve, in the document or not."""
    found = set()
    for outer in app.routes:
        inner = getattr(outer, "original_router", None)
        for route in [outer] if inner is None else inner.routes:
            methods = set(getattr(route, "methods", None) or {"ANY"}) - {"HEAD"}
            found |= {f"{method} {getattr(route, 'path', '')}" for method in methods}
    return found


def forgotten() -> str:
    """A route that nobody gave a scope."""
    return "open"


def test_every_route_has_a_scope_and_no_other_has(store: SqlStore, settings: Settings) -> None:
    app = make_app(store, FakeScience(), settings)
    assert routes_of(app) == set(RULES)
    app.add_api_route("/v1/new", forgotten, methods=["GET"], include_in_schema=False)
    assert routes_of(app) - set(RULES) == {"GET /v1/new"}, "negative control"


def test_a_route_that_nobody_gave_a_scope_is_not_served(
    store: SqlStore, settings: Settings, serving: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    with serving() as client:
        assert client.get("/v1/models").status_code == 200
    monkeypatch.delitem(RULES, "GET /v1/models")
    with serving() as client:
        assert client.get("/v1/models").status_code == 405
    monkeypatch.delitem(RULES, "POST /v1/models")
    with serving() as client:
        assert client.get("/v1/models").status_code == 404


def told(answer: httpx.Response) -> tuple[int, bytes, list[tuple[str, str]]]:
    """An answer without what differs between any two."""
    passing = {"x-request-id", "date", "ratelimit", "server"}
    return (
        answer.status_code,
        answer.content,
        sorted((k, v) for k, v in answer.headers.items() if k not in passing),
    )


def test_without_a_usable_key_every_path_answers_alike(
    locked: httpx.Client, store: SqlStore, key: Key
) -> None:
    revoked = key("read", "ingest", "operate")
    revoke_key(store, revoked["Authorization"][11:23])
    expired = key("read", "ingest", "operate", days=1e-9)
    good = key("read", "ingest", "operate")["Authorization"]
    strangers: list[Headers] = [
        {},
        revoked,
        expired,
        {"Authorization": good[:-1] + ("A" if good[-1] != "A" else "B")},
        {"Authorization": good.replace("Bearer", "Basic")},
        {"Authorization": "Bearer btk_0123456789ab_" + 43 * "A"},
        {"Authorization": "Bearer"},
        {"Authorization": good.removeprefix("Bearer ")},
        {"Authorization": "Bearer \u20ac".encode("latin-1", "replace").decode()},
    ]
    answers = {told(ask(locked, name, who))[:2] for who in strangers for name in GUARDED}
    for method, path in (
        ("GET", "/nowhere"),
        ("PATCH", "/v1/rotors/r1"),
        ("GET", "/v1/rotors/zz"),
        ("GET", "/v1/rotors/a%00b"),
        ("OPTIONS", "/v1/rotors"),
        ("POST", "/v1/rotors/r1/inspections"),
        ("POST", "/"),
        ("GET", "/v1"),
    ):
        answers.add(told(locked.request(method, path, content=b"{", headers=strangers[-2]))[:2])
    assert len(answers) == 1
    status, body = answers.pop()
    assert status == 401
    assert json.loads(body)["type"] == "urn:bladetwin:problem:key-required"
    assert len({str(told(ask(locked, name))) for name in GUARDED}) == 1, "headers, too"
    known = {ask(locked, name, {"Authorization": good}).status_code for name in GUARDED}
    assert {200, 404} <= known, "negative control: with a key, paths differ"


def test_health_and_readiness_are_open(locked: httpx.Client) -> None:
    assert locked.get("/healthz").json() == {"status": "alive"}
    assert locked.get("/readyz").json()["ready"] is True
    assert locked.post("/readyz").status_code == 401


def test_who_tries_keys_by_the_thousand_reaches_the_database_no_more(
    serving: Serving, key: Key, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A key that was met passes all the same, and one that was not by a rate for all of them."""
    asked: list[str] = []

    def counted(store: SqlStore, token: str) -> Any:
        asked.append(token)
        return recognise(store, token)

    monkeypatch.setattr("service.api.gate.recognise", counted)
    monkeypatch.setattr("service.api.gate.LOOKS", 1e-3)
    met, unmet = key("read"), key("read")
    with serving(keys="always", rate_per_s=1e-3, rate_burst=3) as client:
        assert client.get("/v1/models", headers=met).status_code == 200
        tried = [f"Bearer {tokens.new_token()[1]}" for _ in range(9)]
        answers = [client.get("/v1/models", headers={"Authorization": one}) for one in tried]
        assert [one.status_code for one in answers] == 3 * [401] + 6 * [429]
        assert len(asked) == 1 + 3 + 1
        assert int(answers[-1].headers["retry-after"]) > 900
        assert client.get("/v1/models", headers=met).status_code == 200
        assert client.get("/v1/models", headers=unmet).status_code == 429
        assert len(asked) == 6
    monkeypatch.setattr("service.api.gate.LOOKS", 5.0)
    with serving(keys="always", rate_per_s=1e-3, rate_burst=1) as client:
        assert client.get("/v1/models", headers={"Authorization": tried[0]}).status_code == 401
        assert client.get("/v1/models", headers={"Authorization": tried[1]}).status_code == 429
        assert client.get("/v1/models", headers=unmet).status_code == 200


@pytest.mark.parametrize("scope", ["read", "ingest", "operate"])
def test_a_key_may_do_what_its_scope_says_and_nothing_else(
    locked: httpx.Client, key: Key, scope: str
) -> None:
    header = key(scope)
    for name in GUARDED:
        answer = ask(locked, name, header)
        if RULES[name].scope == scope:
            assert answer.status_code not in (401, 403), (name, answer.text)
            continue
        assert answer.status_code == 403, (name, answer.text)
        body = answer.json()
        assert body["type"].endswith(":scope-missing")
        assert body["faults"][0]["remedy"] == f"use a key with scope {RULES[name].scope}"
    assert RULES["POST /v1/rotors/{r}/inspections"].scope == "ingest"


def test_another_keys_rotor_is_as_if_it_were_not_there(
    locked: httpx.Client, store: SqlStore, key: Key, worker: Worker
) -> None:
    everything = key("read", "ingest", "operate")
    for name in ("r0", "r2", "r3"):
        body = BODIES["POST /v1/rotors"] | {"id": name}
        assert locked.post("/v1/rotors", json=body, headers=everything).status_code == 201
    worker.drain()
    own = key("read", "ingest", "operate", rotors=["r1", "r3"])
    for name in (name for name in GUARDED if "{r}" in name):
        there, nowhere = ask(locked, name, own, r="r2"), ask(locked, name, own, r="zz")
        assert there.status_code == 404, name
        assert there.text.replace("r2", "zz") == nowhere.text, name
        assert told(there)[2] == told(nowhere)[2], name
        true = ask(locked, name, everything, r="zz")
        assert nowhere.text == true.text, f"{name}: as for a key that knows every rotor"
        assert ask(locked, name, own, r="r1", i="gone", b="B1").status_code != 401
    listed = locked.get("/v1/rotors", headers=own).json()
    assert [one["id"] for one in listed["items"]] == ["r1", "r3"]
    first = locked.get("/v1/rotors?limit=1", headers=own).json()
    assert (first["items"][0]["id"], first["next"]) == ("r1", "r1")
    rest = locked.get("/v1/rotors?limit=1&cursor=r1", headers=own).json()
    assert (rest["items"][0]["id"], rest["next"]) == ("r3", None)
    seen = {row["rotor"] for row in locked.get("/v1/audit?limit=200", headers=own).json()["items"]}
    assert seen == {"r1"}
    for name in ("POST /v1/models", "POST /v1/rotors"):
        refused = ask(locked, name, own)
        assert refused.status_code == 403
        assert refused.json()["type"].endswith(":rotor-restricted")
    assert {"r0", "r2"} <= {
        one["id"] for one in locked.get("/v1/rotors", headers=everything).json()["items"]
    }, "negative control"


def test_a_revoked_key_is_refused_from_the_next_request_on(
    locked: httpx.Client, store: SqlStore, key: Key
) -> None:
    header = key("read")
    assert locked.get("/v1/rotors", headers=header).status_code == 200
    key_id = tokens.id_of(header["Authorization"].removeprefix("Bearer "))
    assert key_id is not None
    assert revoke_key(store, key_id)[1] is True
    assert locked.get("/v1/rotors", headers=header).status_code == 401
    assert revoke_key(store, key_id)[1] is False


STRANGE: list[Headers] = [
    {"X-Forwarded-For": "127.0.0.1"},
    {"X-Forwarded-For": "192.0.2.7"},
    {"Forwarded": "for=192.0.2.7"},
    {"X-Real-IP": "127.0.0.1"},
    {"Via": "1.1 proxy"},
    {"Host": "evil.example"},
    {"Host": "127.0.0.1.evil.example:8000"},
    {"Origin": "https://evil.example"},
    {"Origin": "null"},
    {"Origin": "http://127.0.0.1:1"},
    {"Authorization": "Bearer nonsense"},
]


def test_on_the_loopback_programs_of_this_machine_need_no_key_and_strangers_do(
    serving: Serving, rotor: str
) -> None:
    with serving() as client:
        own = str(client.base_url).rstrip("/")
        for headers in ({}, {"Origin": own}, {"Host": "localhost:80"}, {"Host": "[::1]"}):
            assert client.get("/v1/rotors/r1", headers=headers).status_code == 200, headers
        for headers in STRANGE:
            assert client.get("/v1/rotors/r1", headers=headers).status_code == 401, headers
    for given in ({"keys": "always"}, {"host": "0.0.0.0"}, {"host": "::"}, {"host": "10.0.0.1"}):
        with serving(**given) as client:
            assert client.get("/v1/rotors/r1").status_code == 401, given
    with serving(cors_origins="https://plant.example") as client:
        page = {"Origin": "https://plant.example"}
        assert client.get("/v1/rotors/r1", headers=page).status_code == 200


@pytest.mark.parametrize(
    ("client", "server", "open_to_it"),
    [
        ("127.0.0.1", "127.0.0.1", True),
        ("::1", "::1", True),
        ("127.0.0.1", "10.0.0.1", False),
        ("10.0.0.2", "127.0.0.1", False),
        (None, "127.0.0.1", False),
        ("127.0.0.1", None, False),
    ],
)
def test_both_ends_of_a_connection_are_on_the_loopback(
    client: str | None, server: str | None, open_to_it: bool
) -> None:
    scope: dict[str, Any] = {"type": "http", "headers": [(b"host", b"localhost:8000")]}
    scope["client"] = None if client is None else (client, 50_000)
    scope["server"] = None if server is None else (server, 8000)
    assert by_loopback(scope, ()) is open_to_it


def test_only_the_digest_of_a_key_is_kept(store: SqlStore) -> None:
    key, token = create_key(store, "gateway", ["read"])
    with transaction(store.engine, write=False) as connection:
        row = connection.execute(text("SELECT * FROM api_key")).mappings().one()
    assert row["digest"] == sha256(token.encode()).hexdigest() == key.digest
    secret = token.split("_", 2)[2]
    assert len(secret) == 43
    assert secret not in str(dict(row))
    assert create_key(store, "other", ["read"])[1].split("_", 2)[2] != secret


def test_a_digest_is_compared_in_constant_time_even_where_there_is_no_such_key(
    store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    compared: list[tuple[str, str]] = []

    def watched(one: str, other: str) -> bool:
        compared.append((one, other))
        return one == other

    _, token = create_key(store, "gateway", ["read"])
    monkeypatch.setattr(tokens, "compare_digest", watched)
    assert recognise(store, token).key is not None
    assert recognise(store, "btk_0123456789ab_" + 43 * "A").key is None
    assert recognise(store, token[:-4] + "AAAA").key is None
    assert len(compared) == 3
    assert not tokens.matches("x", None)


def test_a_key_that_cannot_be_is_refused_with_every_fault(store: SqlStore) -> None:
    with pytest.raises(FaultsError) as caught:
        create_key(store, "a\x00b", ["reed", "read"], ["a/b"], days=-1.0)
    faults: tuple[InputError, ...] = caught.value.faults
    assert [fault.what for fault in faults] == ["name", "scope", "rotor", "days"]
    with pytest.raises(FaultsError, match="scope"):
        create_key(store, "name", [])
    assert list_keys(store) == []


def test_a_server_that_would_refuse_everybody_does_not_start(
    store: SqlStore, settings: Settings
) -> None:
    open_to_all = settings.model_copy(update={"host": "0.0.0.0"})
    check_keys(store, settings)
    create_key(store, "old", ["read"], days=1e-9)
    revoke_key(store, create_key(store, "gone", ["read"])[0].id)
    assert [status for _, status in list_keys(store)] == ["expired", "revoked"]
    for needs in (open_to_all, settings.model_copy(update={"keys": "always"})):
        with pytest.raises(KeysMissingError, match="bladetwin keys create"):
            check_keys(store, needs)
    create_key(store, "ops", ["operate"])
    check_keys(store, open_to_all)
