"""The two clients: the same calls, sent by a connection that blocks or by one that is awaited."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Iterator
from types import TracebackType
from typing import Any, Self, TypeVar

import httpx

from service.client.steps import (
    Awaiting,
    Blocking,
    Call,
    Json,
    Pause,
    Steps,
    Walk,
    checked,
    wait_s,
)
from service.client.table import Calls
from service.sse import Reader

T = TypeVar("T")
URL = "http://127.0.0.1:8000"
PATIENCE_S = 90.0
TRIES = 10  # of a request that comes too soon (429): nothing was done of it


def _headers(key: str | None) -> dict[str, str]:
    return {} if key is None else {"Authorization": f"Bearer {key}"}


class Client(Calls, Blocking):
    """Talks to one service, with an API key where it asks for one.

    `http` may be given instead, e.g. the test client of an application.
    """

    def __init__(
        self,
        base_url: str = URL,
        *,
        key: str | None = None,
        timeout: float = PATIENCE_S,
        http: httpx.Client | None = None,
    ) -> None:
        self._http = http or httpx.Client(base_url=base_url, timeout=timeout, headers=_headers(key))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        self._http.close()

    def _sent(self, **request: Any) -> httpx.Response:
        answer = self._http.request(**request)
        for _ in range(TRIES - 1):
            if answer.status_code != httpx.codes.TOO_MANY_REQUESTS:
                break
            time.sleep(wait_s(answer))
            answer = self._http.request(**request)
        return answer

    def _run(self, steps: Steps[T]) -> T:
        walk = Walk(steps)
        step = walk.go()
        while step is not None:
            if isinstance(step, Pause):
                time.sleep(step.seconds)
                step = walk.go()
                continue
            try:
                answer = self._sent(**step.request())
            except httpx.TransportError as error:
                step = walk.fail(error)
            else:
                step = walk.go(answer)
        return walk.value

    def _pages(self, first: Call) -> Iterator[Json]:
        params = dict(first.params)
        while True:
            answer = self._sent(method=first.method, url=first.path, params=params)
            page = checked(answer).json()
            yield from page["items"]
            if page["next"] is None:
                return
            params["cursor"] = page["next"]

    def _stream(self, asked: Call) -> Iterator[Json]:
        request: Any = asked.request() | {"timeout": asked.silence_s}
        reader = Reader()
        with self._http.stream(**request) as answer:
            if not answer.is_success:
                answer.read()
            checked(answer)
            for line in answer.iter_lines():
                if (event := reader.line(line)) is not None:
                    yield event


class AsyncClient(Calls, Awaiting):
    """The same for programs of asyncio: methods are awaited, pages and events ``async for``.

    async with AsyncClient("http://127.0.0.1:8000") as twin:
        bands = await asyncio.gather(*(twin.prediction("r1", b) for b in ("B01", "B02")))
        async for event in twin.events("r1"):
            ...
    """

    def __init__(
        self,
        base_url: str = URL,
        *,
        key: str | None = None,
        timeout: float = PATIENCE_S,
        http: httpx.AsyncClient | None = None,
    ) -> None:
        self._http = http or httpx.AsyncClient(
            base_url=base_url, timeout=timeout, headers=_headers(key)
        )

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        await self.close()

    async def close(self) -> None:
        await self._http.aclose()

    async def _sent(self, **request: Any) -> httpx.Response:
        answer = await self._http.request(**request)
        for _ in range(TRIES - 1):
            if answer.status_code != httpx.codes.TOO_MANY_REQUESTS:
                break
            await asyncio.sleep(wait_s(answer))
            answer = await self._http.request(**request)
        return answer

    async def _run(self, steps: Steps[T]) -> T:
        walk = Walk(steps)
        step = walk.go()
        while step is not None:
            if isinstance(step, Pause):
                await asyncio.sleep(step.seconds)
                step = walk.go()
                continue
            try:
                answer = await self._sent(**step.request())
            except httpx.TransportError as error:
                step = walk.fail(error)
            else:
                step = walk.go(answer)
        return walk.value

    async def _pages(self, first: Call) -> AsyncIterator[Json]:
        params = dict(first.params)
        while True:
            answer = await self._sent(method=first.method, url=first.path, params=params)
            page = checked(answer).json()
            for item in page["items"]:
                yield item
            if page["next"] is None:
                return
            params["cursor"] = page["next"]

    async def _stream(self, asked: Call) -> AsyncIterator[Json]:
        request: Any = asked.request() | {"timeout": asked.silence_s}
        reader = Reader()
        async with self._http.stream(**request) as answer:
            if not answer.is_success:
                await answer.aread()
            checked(answer)
            async for line in answer.aiter_lines():
                if (event := reader.line(line)) is not None:
                    yield event
