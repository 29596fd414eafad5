"""Answers that are kept as bytes: the same as computed anew, and never older than the newest."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import httpx
import pytest
from fastapi import APIRouter
from sqlalchemy import update

from core.observation import Inspection
from service.api.kept import Ground, Kept, Shelf
from service.api.rotor_answers import view_out
from service.fake import FakeScience
from service.handlers import rotors
from service.handlers.rotors import view_in
from service.store import tables as t
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker

Serving = Callable[..., AbstractContextManager[httpx.Client]]
B1 = "/v1/rotors/r1/blades/B1"
QUESTIONS = (
    f"{B1}/prediction?quantity=elongation&times=8000,50000",
    f"{B1}/prediction?quantity=elongation&times=8000,50000&format=csv",
    f"{B1}/posterior",
    "/v1/rotors/r1/posterior",
    f"{B1}/life?quantity=elongation&limit=0.3",
    "/v1/rotors/r1/life?quantity=elongation&limit=0.3",
)
OWN = ("x-request-id", "date", "ratelimit", "ratelimit-policy")


@pytest.fixture
def counted(science: FakeScience, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The blades that a prediction was computed for."""
    found: list[str] = []
    whole = FakeScience.predict

    def predict(self: FakeScience, card: Any, meta: Any, get: Any, blade: str, *more: Any,
                **named: Any) -> Any:  # fmt: skip
        found.append(blade)
        return whole(self, card, meta, get, blade, *more, **named)

    monkeypatch.setattr(FakeScience, "predict", predict)
    return found


@pytest.fixture
def told(
    rotor: str, post: Callable[..., int], reading: Callable[..., Inspection], worker: Worker
) -> str:
    post(rotor, reading("i1"))
    worker.drain()
    return rotor


def own(answer: httpx.Response) -> dict[str, str]:
    return {k: v for k, v in answer.headers.items() if k not in OWN}


def test_the_second_answer_is_the_first_one_to_the_byte(
    api: httpx.Client, told: str, counted: list[str]
) -> None:
    for question in QUESTIONS:
        for squeezed in ("gzip", "identity"):
            headers = {"Accept-Encoding": squeezed}
            first, again = (api.get(question, headers=headers) for _ in range(2))
            assert again.content == first.content
            assert own(again) == own(first)
            assert first.headers["x-request-id"] != again.headers["x-request-id"]
            tag = {"If-None-Match": first.headers["etag"]} | headers
            same = api.get(question, headers=tag)
            assert (same.status_code, same.content) == (304, b"")
            assert same.headers["etag"] == first.headers["etag"]
    assert len(counted) == 4, "two forms in two encodings, each once"


def test_a_new_version_is_answered_from_its_commit_on(
    api: httpx.Client,
    told: str,
    post: Callable[..., int],
    reading: Callable[..., Inspection],
    worker: Worker,
    counted: list[str],
) -> None:
    before = {question: api.get(question) for question in QUESTIONS}
    for number in range(3):
        post(told, reading(f"n{number}", time_h=9000.0 + number, value=0.2 + 0.1 * number))
        for question in QUESTIONS:
            assert api.get(question).content == before[question].content, "not applied yet"
        worker.drain()
        version = api.get("/v1/rotors/r1").json()["version"]
        for question, old in before.items():
            tag = {"If-None-Match": old.headers["etag"]}
            new = api.get(question, headers=tag)
            assert new.status_code == 200
            assert new.content != old.content
            assert new.headers["etag"] != old.headers["etag"]
            if "csv" not in question:
                assert new.json()["rests_on"]["version"] == version
            before[question] = new


def test_who_asks_with_a_tag_first_does_not_take_the_answer_from_others(
    api: httpx.Client, told: str, serving: Serving, counted: list[str]
) -> None:
    tag = api.get(QUESTIONS[0]).headers["etag"]
    with serving() as fresh:  # nothing is kept here yet
        for _ in range(2):
            assert fresh.get(QUESTIONS[0], headers={"If-None-Match": tag}).status_code == 304
        assert len(counted) == 1
        assert fresh.get(QUESTIONS[0]).json() == api.get(QUESTIONS[0]).json()


def test_a_version_that_is_named_and_a_refusal_are_never_kept(
    api: httpx.Client, told: str, counted: list[str]
) -> None:
    version = api.get("/v1/rotors/r1").json()["version"]
    for _ in range(2):
        assert api.get(f"{QUESTIONS[0]}&version={version}").status_code == 200
        assert api.get(f"{B1}/prediction?quantity=nothing").status_code == 422
        assert api.get(f"{QUESTIONS[0]}&version={version + 9}").status_code == 404
    assert len(counted) == 2


@pytest.fixture
def views(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The rotors that were read with their blades."""
    found: list[str] = []
    whole = rotors.view_in

    def view_in(tx: Any, rotor_id: str, **more: Any) -> Any:
        found.append(rotor_id)
        return whole(tx, rotor_id, **more)

    monkeypatch.setattr(rotors, "view_in", view_in)
    return found


def test_a_rotor_is_read_again_only_where_something_changed(
    api: httpx.Client,
    told: str,
    store: SqlStore,
    post: Callable[..., int],
    reading: Callable[..., Inspection],
    worker: Worker,
    views: list[str],
) -> None:
    address = f"/v1/rotors/{told}"

    def block() -> None:
        with store.write() as tx:
            row = t.cursor.c.rotor_id == told
            tx.connection.execute(update(t.cursor).where(row).values(blocked=True, last_error="x"))

    changes: tuple[Callable[[], object], ...] = (
        lambda: post(told, reading("n1", value=0.3)),
        worker.drain,
        lambda: api.post(f"{address}/inspections/n1/retraction"),
        worker.drain,
        lambda: api.post(f"{address}/blades", json={"id": "B9"}),
        worker.drain,
        lambda: api.post(f"{address}/blades/B9/retirement"),
        block,
        lambda: api.post(f"{address}/retry"),
        worker.drain,
        lambda: api.post(f"{address}/policy", json={"diagnose": "alarm"}),
    )
    seen = [api.get(address)]
    for change in changes:
        done = change()
        assert not isinstance(done, httpx.Response) or done.status_code in (200, 202), done
        with store.read() as tx:
            now = view_out(view_in(tx, told))
        views.clear()
        tag = {"If-None-Match": seen[-1].headers["etag"]}
        new, again = api.get(address, headers=tag), api.get(address)
        assert new.json() == now
        assert own(again) == own(new)
        assert again.content == new.content
        assert api.get(address, headers={"If-None-Match": new.headers["etag"]}).status_code == 304
        assert views == [told], "read once for the three"
        seen.append(new)
    assert len({one.content for one in seen}) == len(seen), "each change was seen"


def test_a_rotor_that_is_waited_for_or_gone_is_never_kept(
    api: httpx.Client, told: str, views: list[str]
) -> None:
    for _ in range(2):
        assert api.get(f"/v1/rotors/{told}?wait_for=1&timeout=0").status_code == 200
        assert api.get("/v1/rotors/nobody").status_code == 404
    assert views == [told, "nobody"] * 2


def test_what_is_kept_is_behind_keys_and_rights(
    told: str, serving: Serving, key: Callable[..., dict[str, str]]
) -> None:
    with serving(keys="always") as api:
        assert api.get(QUESTIONS[0], headers=key("read", rotors=["r1"])).status_code == 200
        assert api.get(QUESTIONS[0]).status_code == 401
        assert api.get(QUESTIONS[0], headers=key("ingest", rotors=["r1"])).status_code == 403
        assert api.get(QUESTIONS[0], headers=key("read", rotors=["r2"])).status_code == 404


def test_a_kept_answer_is_counted_under_its_route(api: httpx.Client, told: str) -> None:
    for _ in range(3):
        api.get(QUESTIONS[0])
    line = 'route="/v1/rotors/{r}/blades/{b}/prediction",status="200"} 3'
    assert line in api.get("/metrics").text


def test_nothing_is_kept_where_there_is_no_room(
    told: str, serving: Serving, counted: list[str]
) -> None:
    with serving(answers_mb=0.0) as api:
        assert api.get(QUESTIONS[0]).content == api.get(QUESTIONS[0]).content
    assert len(counted) == 2


def test_the_shelf_drops_what_was_not_asked_for_the_longest() -> None:
    ground = Ground("r", lambda store, rotor: None, None)
    shelf = Shelf(3 * (Shelf.ENTRY_BYTES + 102) / 2**20)  # with a path of one letter
    for name in "abc":
        shelf.put((name, b"", False), Kept(ground, name, [], b"x" * 100, {}))
    assert shelf.get(("a", b"", False)) is not None
    shelf.put(("d", b"", False), Kept(ground, "d", [], b"x" * 100, {}))
    found = {name for name in "abcd" if shelf.get((name, b"", False)) is not None}
    assert found == {"a", "c", "d"}
    shelf.put(("a", b"", False), Kept(ground, "a", [], None, {}))
    assert shelf.get(("c", b"", False)) is not None


@pytest.fixture
def routed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The paths for which a route was looked for."""
    found: list[str] = []
    whole = APIRouter.app

    async def app(self: APIRouter, scope: Any, receive: Any, send: Any) -> None:
        found.append(scope["path"])
        await whole(self, scope, receive, send)

    monkeypatch.setattr(APIRouter, "app", app)
    return found


def test_what_was_understood_before_is_answered_anew_as_its_route_would(
    routed: list[str],  # before the application is made
    api: httpx.Client,
    told: str,
    serving: Serving,
    post: Callable[..., int],
    reading: Callable[..., Inspection],
    worker: Worker,
) -> None:
    """To the byte and the header, in whatever encoding; and counted under the route's name."""
    questions = [*QUESTIONS, f"/v1/rotors/{told}"]
    encodings = [{"Accept-Encoding": one} for one in ("gzip", "identity")]
    for question in questions:
        for headers in encodings:
            api.get(question, headers=headers)
    post(told, reading("n1", time_h=9000.0, value=0.4))
    worker.drain()
    routed.clear()
    anew = [api.get(q, headers=headers) for q in questions for headers in encodings]
    assert routed == []
    lines = api.get("/metrics").text.splitlines()
    with serving() as fresh:
        routed.clear()
        whole = [fresh.get(q, headers=headers) for q in questions for headers in encodings]
        assert len(routed) == len(whole)
    for one, other in zip(anew, whole, strict=True):
        assert one.content == other.content
        assert own(one) == own(other)
    count = [line for line in lines if "http_requests_total" in line and "/prediction" in line]
    assert count == [
        'bladetwin_http_requests_total{method="GET",'
        'route="/v1/rotors/{r}/blades/{b}/prediction",status="200"} 8'
    ]


def test_where_it_cannot_be_answered_anew_its_route_tells_why(
    routed: list[str],  # before the application is made
    api: httpx.Client,
    told: str,
    store: SqlStore,
    post: Callable[..., int],
    reading: Callable[..., Inspection],
    worker: Worker,
) -> None:
    assert api.get(QUESTIONS[0]).status_code == 200
    post(told, reading("n1", time_h=9000.0, value=0.4))
    worker.drain()
    with store.write() as tx:
        tx.connection.execute(update(t.blade).where(t.blade.c.id == "B1").values(lot="other"))
    routed.clear()
    answer = api.get(QUESTIONS[0])
    assert (answer.status_code, len(routed)) == (503, 1)
    assert "blades of its creation" in answer.json()["detail"]
