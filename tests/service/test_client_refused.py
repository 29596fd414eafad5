"""The clients where a service, or what stands before it, does not simply answer."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable
from typing import Any

import httpx
import numpy as np
import pytest

from core.errors import ModelError
from service.client import AsyncClient, Client, ProblemError
from service.client.transports import TRIES
from service.sampling import Served

Answer = Callable[[httpx.Request], httpx.Response]
URL = "http://twin"


def slower() -> httpx.Response:
    return httpx.Response(429, headers={"Retry-After": "2"}, json={"detail": "too many"})


def client(answer: Answer) -> Client:
    return Client(http=httpx.Client(base_url=URL, transport=httpx.MockTransport(answer)))


def refusal(answer: httpx.Response) -> ProblemError:
    with pytest.raises(ProblemError) as found:
        client(lambda request: answer).readings_csv("r1")
    return found.value


def test_what_a_proxy_sends_elsewhere_is_no_file() -> None:
    moved = httpx.Response(308, headers={"Location": "https://twin/x"}, text="<html>moved</html>")
    error = refusal(moved)
    assert error.status == 308
    assert "https://twin/x" in str(error)


@pytest.mark.parametrize("body", ['["not", "an", "object"]', '"text"', "3", "<html>", ""])
def test_a_refusal_that_is_no_problem_is_told_as_it_came(body: str) -> None:
    error = refusal(httpx.Response(502, text=body))
    assert error.status == 502
    assert error.faults == []
    assert body in str(error)


def test_a_page_in_the_service_s_place_is_told_as_one_line_without_its_tags() -> None:
    """A gateway whose service is down, in front of an ops script."""
    page = "<html>\n<head><style>h1\n{color: red}</style></head>\n<h1>502 Bad\nGateway</h1></html>"
    said = str(refusal(httpx.Response(502, html=page)))
    assert said.startswith("GET /v1/rotors/r1/inspections: 502: no answer of bladetwin's: 502 Bad ")
    assert "Gateway. To mend it: see that the service runs" in said
    assert not set("<>{}\n") & set(said)


def test_a_stream_that_is_sent_elsewhere_is_refused_too() -> None:
    moved = httpx.Response(301, headers={"Location": "/there"}, text="moved")
    with pytest.raises(ProblemError, match="/there"):
        next(client(lambda request: moved).events("r1"))


def busy(times: int, asked: list[str]) -> Answer:
    """Too many requests so many times, then an answer."""

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append(request.method)
        return slower() if len(asked) <= times else httpx.Response(200, json={"id": "r1"})

    return answer


@pytest.mark.parametrize("times", [0, 1, TRIES - 1])
def test_a_request_that_comes_too_soon_is_sent_again(
    monkeypatch: pytest.MonkeyPatch, times: int
) -> None:
    asked: list[str] = []
    pauses: list[float] = []
    monkeypatch.setattr(time, "sleep", pauses.append)
    assert client(busy(times, asked)).rotor("r1")["id"] == "r1"
    assert len(asked) == times + 1
    assert pauses == [2.0] * times


def test_a_service_that_stays_busy_is_told_of(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    with pytest.raises(ProblemError, match="too many"):
        client(busy(TRIES, asked)).rotor("r1")
    assert len(asked) == TRIES


def test_the_awaited_client_waits_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    pauses: list[float] = []
    real, here = asyncio.sleep, threading.current_thread()

    async def sleep(seconds: float) -> None:
        if threading.current_thread() is not here:  # another server of these tests
            await real(seconds)
            return
        pauses.append(seconds)
        await real(0)

    async def go() -> Any:
        transport = httpx.MockTransport(busy(2, asked))
        async with AsyncClient(http=httpx.AsyncClient(base_url=URL, transport=transport)) as twin:
            return await twin.rotor("r1")

    monkeypatch.setattr(asyncio, "sleep", sleep)
    assert asyncio.run(go())["id"] == "r1"
    assert pauses == [2.0, 2.0]


def test_all_pages_of_the_models_are_read() -> None:
    names = [f"m{i}" for i in range(7)]

    def answer(request: httpx.Request) -> httpx.Response:
        begin = names.index(request.url.params.get("cursor", "m0"))
        begin += "cursor" in request.url.params
        shown = names[begin : begin + 3]
        more = begin + 3 < len(names)
        items = [{"id": name} for name in shown]
        return httpx.Response(200, json={"items": items, "next": shown[-1] if more else None})

    assert [one["id"] for one in client(answer).models()] == names


@pytest.mark.parametrize("most", [30.0, 10.0, 3.0, 0.0])
def test_waiting_goes_by_what_the_service_allows(
    monkeypatch: pytest.MonkeyPatch, most: float
) -> None:
    """It is applied at the third poll that the service takes."""
    taken: list[float] = []
    monkeypatch.setattr(time, "sleep", lambda seconds: None)

    def answer(request: httpx.Request) -> httpx.Response:
        asked = float(request.url.params["timeout"])
        if asked > most:
            fault = {"field": "timeout", "value": asked, "problem": "is above", "remedy": "less"}
            return httpx.Response(422, json={"detail": "above", "faults": [fault]})
        taken.append(asked)
        applied = 5 if len(taken) == 3 else 4
        told = {"id": "r1", "status": "current", "version": 1, "applied_seq": applied}
        return httpx.Response(200, json=told)

    assert client(answer).wait_for("r1", 5)["applied_seq"] == 5
    assert len(taken) == 3
    assert max(taken) <= most


def test_another_fault_of_the_waiting_is_told() -> None:
    def answer(request: httpx.Request) -> httpx.Response:
        fault = {"field": "wait_for", "value": 5, "problem": "is odd", "remedy": "none"}
        return httpx.Response(422, json={"detail": "odd", "faults": [fault]})

    with pytest.raises(ProblemError, match="odd"):
        client(answer).wait_for("r1", 5)


@pytest.mark.parametrize(
    ("error", "times"), [(httpx.ReadTimeout("slow"), 1), (httpx.ConnectError("away"), 3)]
)
def test_a_run_that_takes_too_long_is_not_begun_again(error: Exception, times: int) -> None:
    evaluated: list[str] = []

    def answer(request: httpx.Request) -> httpx.Response:
        told = {
            "/Info": {"protocolVersion": 1.0, "models": ["pump"]},
            "/ModelInfo": {"support": {"Evaluate": True}},
            "/InputSizes": {"inputSizes": [1]},
            "/OutputSizes": {"outputSizes": [1]},
        }
        if request.url.path == "/Evaluate":
            evaluated.append("run")
            raise error
        return httpx.Response(200, json=told[request.url.path])

    http = httpx.Client(base_url=URL, transport=httpx.MockTransport(answer))
    served = Served(http, None, {})
    with pytest.raises(ModelError):
        served(np.array([1.0]))
    assert len(evaluated) == times


def test_a_version_of_a_model_is_given_by_its_name(api: httpx.Client, rotor: str) -> None:
    """The one that a rotor has, though a newer one may be there."""
    now = api.get("/v1/rotors/r1").json()
    twin = Client(http=api)
    assert twin.model(now["model"], now["model_version"])["version"] == now["model_version"]
    with pytest.raises(ProblemError, match=r"model rotor-blade of version 'none'") as found:
        twin.model("rotor-blade", "none")
    assert found.value.status == 404
