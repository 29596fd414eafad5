"""Requests to an application in this process: no port, and answers piece by piece.

The application lives in an event loop of a thread of its own, as under a server. A request of any
thread, or of any other loop, is handed to that loop and its answer is fetched from there while it
is made: long polls wait there, a stream of events comes event by event, and the timeout of a read
is that between two pieces. (httpx's own transport for applications hands an answer on when it is
complete, so that a stream would never begin.)
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Coroutine, Iterator
from typing import Any, TypeVar

import httpx

from service.testing.inside import Exchange, Inside

T = TypeVar("T")


class Transport(httpx.BaseTransport):
    """For `httpx.Client`, from any thread."""

    def __init__(self, inside: Inside) -> None:
        self._inside = inside

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        exchange = _done(self._inside, self._inside.answer(request, request.read()))
        pieces = _Pieces(self._inside, exchange)
        return httpx.Response(exchange.status, headers=exchange.headers, stream=pieces)


class _Pieces(httpx.SyncByteStream):
    def __init__(self, inside: Inside, exchange: Exchange) -> None:
        self._inside, self._exchange = inside, exchange

    def __iter__(self) -> Iterator[bytes]:
        while (piece := _done(self._inside, self._exchange.piece())) is not None:
            if piece:
                yield piece

    def close(self) -> None:
        self._inside.leave(self._exchange)


def _done(inside: Inside, coroutine: Coroutine[Any, Any, T]) -> T:
    """What the loop made of it; given up where this thread is interrupted."""
    future = inside.hand(coroutine)
    try:
        return future.result()
    except BaseException:
        future.cancel()
        raise


class AsyncTransport(httpx.AsyncBaseTransport):
    """For `httpx.AsyncClient`, from any loop."""

    def __init__(self, inside: Inside) -> None:
        self._inside = inside

    async def handle_async_request(self, request: httpx.Request) -> httpx.Response:
        answer = self._inside.answer(request, await request.aread())
        exchange = await asyncio.wrap_future(self._inside.hand(answer))
        pieces = _AsyncPieces(self._inside, exchange)
        return httpx.Response(exchange.status, headers=exchange.headers, stream=pieces)


class _AsyncPieces(httpx.AsyncByteStream):
    def __init__(self, inside: Inside, exchange: Exchange) -> None:
        self._inside, self._exchange = inside, exchange

    async def __aiter__(self) -> AsyncIterator[bytes]:
        while True:
            piece = await asyncio.wrap_future(self._inside.hand(self._exchange.piece()))
            if piece is None:
                return
            if piece:
                yield piece

    async def aclose(self) -> None:
        self._inside.leave(self._exchange)
