"""Answers that are kept as bytes: the same as computed anew, and never older than the newest."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import httpx
import pytest

from core.observation import Inspection
from service.api.kept import Kept, Shelf
from service.fake import FakeScience
from service.worker.loop import Worker

Serving = Callable[..., AbstractContextManager[httpx.Client]]
B1 = "/v1/rotors/r1/blades/B1"
QUESTIONS = (
    f"{B1}/prediction?quantity=elongation&times=8000,50000",
    f"{B1}/prediction?quantity=elongation&times=8000,50000&format=csv",
    f"{B1}/posterior",
    "/v1/rotors/r1/posterior",
    f"{B1}/life?quantity=elongation&limit=0.3",
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
    shelf = Shelf(3 * (Shelf.ENTRY_BYTES + 100) / 2**20)
    for name in "abc":
        shelf.put((name, b"", False), Kept("r", (1, ""), name, [], b"x" * 100, {}))
    assert shelf.get(("a", b"", False)) is not None
    shelf.put(("d", b"", False), Kept("r", (1, ""), "d", [], b"x" * 100, {}))
    found = {name for name in "abcd" if shelf.get((name, b"", False)) is not None}
    assert found == {"a", "c", "d"}
    shelf.put(("a", b"", False), Kept("r", (1, ""), "a", [], None, {}))
    assert shelf.get(("c", b"", False)) is not None
