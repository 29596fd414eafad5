"""An application in its event loop, and the requests that it answers there, piece by piece."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Coroutine
from concurrent.futures import Future
from typing import Any, TypeVar

import httpx
from starlette.types import ASGIApp, Message, Scope

log = logging.getLogger("bladetwin.testing")
T = TypeVar("T")
AHEAD = 16  # pieces that are made before they are fetched
CLOSE_S, MOMENT_S = 10.0, 0.1
ENDED = "the service in memory has ended"
CALLER = ("127.0.0.1", 50_000)


class Exchange:
    """One request and its answer; its methods run in the application's loop.

    status, headers   of the answer, once it has begun
    awaited           somebody waits for its next piece now
    """

    status: int
    headers: list[tuple[bytes, bytes]]

    def __init__(self, app: ASGIApp, request: httpx.Request, body: bytes) -> None:
        self._app = app
        self._request = request
        self._body: bytes | None = body
        self._made: asyncio.Queue[Message | Exception] = asyncio.Queue(AHEAD)
        self._left = asyncio.Event()
        self._ended = False
        self._failed: Exception | None = None
        self.awaited = False

    def _scope(self) -> Scope:
        url = self._request.url
        return {
            "type": "http",
            "asgi": {"version": "3.0", "spec_version": "2.3"},
            "http_version": "1.1",
            "method": self._request.method,
            "scheme": url.scheme,
            "path": url.path,
            "raw_path": url.raw_path.split(b"?")[0],
            "query_string": url.query,
            "root_path": "",
            "headers": [(name.lower(), value) for name, value in self._request.headers.raw],
            "server": (url.host, url.port or 80),
            "client": CALLER,
        }

    async def run(self) -> None:
        """Let the application answer."""
        try:
            await self._app(self._scope(), self._receive, self._send)
            if not self._ended:
                raise RuntimeError("the application ended without an answer")
        except Exception as error:
            if self._left.is_set():
                return
            log.exception("%s %s failed", self._request.method, self._request.url.path)
            told = f"{type(error).__name__}: {error}"
            await self._put(httpx.RemoteProtocolError(told, request=self._request))

    async def _receive(self) -> Message:
        if self._body is not None:
            body, self._body = self._body, None
            return {"type": "http.request", "body": body, "more_body": False}
        await self._left.wait()
        return {"type": "http.disconnect"}

    async def _send(self, message: Message) -> None:
        self._ended = message["type"] == "http.response.body" and not message.get("more_body")
        await self._put(message)

    async def _put(self, made: Message | Exception) -> None:
        if not self._left.is_set():
            await self._made.put(made)

    async def begun(self) -> None:
        """Return when status and headers are there."""
        first = await self._next()
        self.status = first["status"]
        self.headers = list(first.get("headers", []))

    async def piece(self) -> bytes | None:
        """The next piece of the answer's body; None: that was all."""
        if self._failed is None and self._left.is_set():
            return None
        message = await self._next()
        if not message.get("more_body", False):
            self.leave()
        return bytes(message.get("body", b""))

    async def _next(self) -> Message:
        patience = self._request.extensions.get("timeout", {}).get("read")
        if self._failed is not None:
            raise self._failed
        self.awaited = True
        try:
            made = await asyncio.wait_for(self._made.get(), patience)
        except TimeoutError:
            self.leave()
            raise httpx.ReadTimeout("no answer in time", request=self._request) from None
        finally:
            self.awaited = False
        if isinstance(made, Exception):
            raise made
        return made

    @property
    def left(self) -> bool:
        """Its answer was fetched, or nobody listens any more."""
        return self._left.is_set()

    def leave(self) -> None:
        """Nobody listens any more; the application is told, and what it still sends is dropped."""
        self._left.set()
        while not self._made.empty():
            self._made.get_nowait()

    def fail(self, error: Exception) -> None:
        """Whoever waits for the answer, or for more of it, hears this instead."""
        self.leave()
        self._failed = error
        self._made.put_nowait(error)


class Inside:
    """An application in its loop; `error`: what every request ends with from now on."""

    def __init__(self, app: ASGIApp, loop: asyncio.AbstractEventLoop) -> None:
        self._app = app
        self.loop = loop
        self._tasks: dict[asyncio.Task[None], Exchange] = {}
        self._closing = False
        self._ended = False
        self.error: Exception | None = None

    def hand(self, coroutine: Coroutine[Any, Any, T]) -> Future[T]:
        """From any thread: have the loop do it. ConnectError: the loop has ended."""
        if self._ended:
            coroutine.close()
            raise httpx.ConnectError(ENDED)
        return asyncio.run_coroutine_threadsafe(coroutine, self.loop)

    async def answer(self, request: httpx.Request, body: bytes) -> Exchange:
        """Begin a request; the exchange once its answer has begun."""
        if self.error is not None:
            raise self.error
        if self._closing:
            raise httpx.ConnectError(ENDED)
        exchange = Exchange(self._app, request, body)
        task = self.loop.create_task(exchange.run())
        self._tasks[task] = exchange
        try:
            await exchange.begun()
        except BaseException:
            exchange.leave()
            raise
        return exchange

    def leave(self, exchange: Exchange) -> None:
        """From any thread: nobody listens any more."""
        if not self._ended:
            self.loop.call_soon_threadsafe(exchange.leave)

    def fail(self, error: Exception) -> None:
        """From any thread: every request that is open ends with the error, and every later one."""
        if not self._ended:
            self.loop.call_soon_threadsafe(self._fail, error)

    def _fail(self, error: Exception) -> None:
        self.error = self.error or error
        for exchange in self._open():
            exchange.fail(error)

    def _open(self) -> list[Exchange]:
        """What is not fetched to its end; forgets what is."""
        self._tasks = {t: e for t, e in self._tasks.items() if not (t.done() and e.left)}
        return list(self._tasks.values())

    async def close(self) -> None:
        """Let whoever waits hear the end of an answer, then end what is still open; in the loop."""
        self._closing = True
        begun = self.loop.time()
        while open_ := self._open():
            gone_s = self.loop.time() - begun
            if gone_s > (CLOSE_S if any(one.awaited for one in open_) else MOMENT_S):
                break
            await asyncio.sleep(0.005)
        for exchange in self._open():
            exchange.fail(httpx.RemoteProtocolError(ENDED))
        if late := [task for task in self._tasks if not task.done()]:
            _, stuck = await asyncio.wait(late, timeout=CLOSE_S)
            for task in stuck:
                task.cancel()
        self._ended = True
