"""HEAD on every route that has GET: its head, and no body."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import httpx
import pytest

from core.observation import Inspection
from service.api import heads
from service.api.feed import Feed
from service.api.scopes import RULES
from service.worker.loop import Worker
from tests.patience import PATIENCE_S

Make = Callable[..., Inspection]
Post = Callable[..., int]
Serving = Callable[..., AbstractContextManager[httpx.Client]]
NAMES = {"r": "r1", "b": "B1", "i": "i1", "m": "rotor-blade", "name:path": "pages.css"}
ASKED = {
    "/life": "?limit=0.3",
    "/prediction": "?times=8000",
    "/series": "?times=8000",
    "/rotors/{r}/field": "?times=8000",
    "/blades/{b}/field": "?time_h=8000",
}
OF_A_MOMENT = {"/metrics", "/v1/operations"}  # two answers differ, HEAD or not
ANEW = {"date", "x-request-id", "ratelimit", "transfer-encoding"}
GETS = [name.split(" ")[1] for name in RULES if name.startswith("GET ")]


def filled(template: str) -> str:
    """The path of a route; what there is no such thing of is 404, to HEAD as to GET."""
    path = template
    for name, value in NAMES.items():
        path = path.replace(f"{{{name}}}", value)
    for name in ("d", "w", "id"):
        path = path.replace(f"{{{name}}}", "none")
    return path + next((q for end, q in ASKED.items() if template.endswith(end)), "")


def told(answer: httpx.Response, path: str) -> dict[str, str]:
    """The headers that do not differ between any two answers."""
    apart = ANEW | ({"content-length", "etag"} if path in OF_A_MOMENT else set())
    return {name: value for name, value in answer.headers.items() if name not in apart}


@pytest.fixture
def lived(api: httpx.Client, rotor: str, worker: Worker, reading: Make, post: Post) -> httpx.Client:
    post(rotor, reading("i1"))
    worker.drain()
    return api


def test_every_get_route_answers_head_with_the_same_head_and_no_body(lived: httpx.Client) -> None:
    statuses = {}
    for template in GETS:
        path = filled(template)
        if template.endswith("/events"):
            continue
        got, head = lived.get(path), lived.head(path)
        assert (head.status_code, head.content) == (got.status_code, b""), path
        assert told(head, path) == told(got, path), path
        statuses[template] = got.status_code
        if "etag" in got.headers and path not in OF_A_MOMENT:
            known = {"If-None-Match": got.headers["etag"]}
            got, head = lived.get(path, headers=known), lived.head(path, headers=known)
            assert (got.status_code, head.status_code) == (304, 304), path
            assert told(head, path) == told(got, path), path
    missing = {template for template, status in statuses.items() if status != 200}
    assert all("{d}" in one or "{w}" in one or "{id}" in one for one in missing), missing


@pytest.mark.parametrize(
    "path",
    [
        "/v1/rotors/r1/inspections?format=csv",
        "/v1/rotors/r1/posterior?format=netcdf",
        "/v1/rotors/r1/blades/B1/field?format=vtu&time_h=8000",
    ],
)
def test_a_file_has_its_head_by_head(lived: httpx.Client, path: str) -> None:
    got, head = lived.get(path), lived.head(path)
    assert got.status_code == 200, got.text
    assert (head.status_code, head.content) == (200, b"")
    assert told(head, path) == told(got, path)
    assert head.headers["etag"]
    assert "attachment" in head.headers["content-disposition"]


def test_the_head_of_a_stream_of_events_opens_none(
    serving: Serving, rotor: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []
    listening = Feed.listening

    def watched(own: Feed, rotor: str) -> Any:
        opened.append(rotor)
        return listening(own, rotor)

    monkeypatch.setattr(Feed, "listening", watched)
    path = f"/v1/rotors/{rotor}/events"
    with serving(heartbeat_s=0.05) as client:
        head = client.head(path, timeout=PATIENCE_S)
        assert (head.status_code, head.content, opened) == (200, b"", [])
        with client.stream("GET", path) as stream:
            assert told(stream, path) == told(head, path)
            next(line for line in stream.iter_lines() if line == ": alive")
        assert opened == [rotor], "the control"
        assert client.head("/v1/rotors/zz/events").status_code == 404


def test_head_needs_what_get_needs(serving: Serving, rotor: str, key: Any) -> None:
    with serving(keys="always") as client:
        assert client.head(f"/v1/rotors/{rotor}").status_code == 401
        ingest = client.head(f"/v1/rotors/{rotor}", headers=key("ingest"))
        assert (ingest.status_code, ingest.content) == (403, b"")
        assert client.head(f"/v1/rotors/{rotor}", headers=key("read")).status_code == 200
        assert client.head("/v1/rotors/zz", headers=key("read")).status_code == 404


def test_a_path_without_get_has_no_head(lived: httpx.Client) -> None:
    refused = lived.head("/v1/rotors/r1/retry")
    assert (refused.status_code, refused.headers["allow"]) == (405, "POST")
    assert lived.put("/v1/rotors").headers["allow"] == "GET, HEAD, POST"


def test_a_connection_goes_on_after_head(lived: httpx.Client) -> None:
    """A body that came all the same would be taken for the next answer."""
    for _ in range(3):
        assert lived.head("/openapi.json").status_code == 200
        assert lived.get("/healthz").json()


def test_metrics_know_head_and_its_route(lived: httpx.Client) -> None:
    lived.head("/v1/rotors/r1")
    lines = lived.get("/metrics").text.splitlines()
    assert any('method="HEAD",route="/v1/rotors/{r}",status="200"' in line for line in lines)


def test_the_document_tells_of_no_head(lived: httpx.Client) -> None:
    """It would say everything twice; that HEAD goes with GET is HTTP's rule."""
    paths = lived.get("/openapi.json").json()["paths"]
    assert not any("head" in operations for operations in paths.values())


def test_without_the_layer_head_is_refused(
    serving: Serving, rotor: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The control."""

    async def through(own: heads.Heads, scope: Any, receive: Any, send: Any) -> None:
        await own.app(scope, receive, send)

    monkeypatch.setattr(heads.Heads, "__call__", through)
    with serving() as client:
        assert client.head(f"/v1/rotors/{rotor}").status_code == 405
