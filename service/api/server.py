"""uvicorn, as the service runs it: on uvloop, with the parser of httptools and a bound on heads."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import Callable
from http import HTTPStatus
from typing import Any, cast

import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from service.api.problems import document
from service.api.waiting import Changes
from service.settings import Settings

HEAD_BYTES = 64 * 2**10
AT_ONCE = 64 * 2**10


class Gathering:
    """A transport from which all that is written in one turn of the event loop leaves at once.

    uvicorn writes the head of an answer and its body one after the other, and each would be sent by
    itself: two calls of the system, and a client that is woken twice. What is larger than
    `AT_ONCE` goes straight away, so that the transport can say when it has enough.
    """

    def __init__(self, transport: asyncio.Transport, loop: asyncio.AbstractEventLoop) -> None:
        self._transport, self._loop = transport, loop
        self._parts: list[bytes] = []
        self._size = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._transport, name)

    def write(self, data: bytes) -> None:
        if not self._parts:
            self._loop.call_soon(self._send)
        self._parts.append(data)
        self._size += len(data)
        if self._size > AT_ONCE:
            self._send()

    def _send(self) -> None:
        if self._parts:
            parts, self._parts, self._size = self._parts, [], 0
            self._transport.write(b"".join(parts))

    def close(self) -> None:
        self._send()
        self._transport.close()


class Protocol(HttpToolsProtocol):
    """One connection: its answers leave whole, its requests' heads and trailers are bounded.

    The parser (llhttp) keeps a line until its end, however long it gets. So what has come since the
    last part of a body, or since the last request, is counted, and above `HEAD_BYTES` the
    connection ends with 431. (A single read may go beyond it, and holds 256 KiB at most.)
    """

    _since = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(cast(asyncio.Transport, Gathering(transport, self.loop)))

    def data_received(self, data: bytes) -> None:
        self._since += len(data)
        super().data_received(data)
        if self._since > HEAD_BYTES and not self.transport.is_closing():
            self.logger.warning("a request's head is above %d KiB", HEAD_BYTES // 2**10)
            detail = f"The head of this request is above {HEAD_BYTES} bytes; shorten its headers."
            self.refuse(431, "head-too-large", detail)

    def send_400_response(self, msg: str) -> None:
        detail = "This is no request of HTTP/1.1, or of a method that HTTP does not know."
        self.refuse(400, "malformed-request", detail)

    def refuse(self, status: int, kind: str, detail: str) -> None:
        """Answer with a problem, in the shape of all others, and end the connection."""
        body = json.dumps(document(status, kind, detail, "")).encode()
        lines = (
            f"HTTP/1.1 {status} {HTTPStatus(status).phrase}",
            "content-type: application/problem+json",
            f"content-length: {len(body)}",
            "connection: close\r\n\r\n",
        )
        head = "\r\n".join(lines)
        self.transport.write(head.encode() + body)
        self.transport.close()

    def on_body(self, body: bytes) -> None:
        self._since = 0
        super().on_body(body)

    def on_message_complete(self) -> None:
        self._since = 0
        super().on_message_complete()


class Server(uvicorn.Server):
    """Says when it listens, and lets long polls and streams go as soon as a signal asked to stop.

    Not in the signal's handler: that may run while the same thread holds the very lock that it
    would need, and wait for ever.
    """

    changes: Changes | None = None
    opened: Callable[[], None] | None = None  # called when it listens
    closing: Callable[[], None] | None = None  # called when it begins to end

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if self.opened is not None and self.started:
            self.opened()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        if self.closing is not None:
            self.closing()
        if self.changes is not None:
            self.changes.begin_close()
        await super().shutdown(sockets)


def server(app: FastAPI, settings: Settings) -> Server:
    """A server of the application at the settings' address."""
    config = uvicorn.Config(
        app,
        http=Protocol,
        host=settings.host,
        port=settings.port,
        log_config=None,
        access_log=False,
        server_header=False,
        headers=[("Server", "bladetwin")],
        timeout_graceful_shutdown=5,
    )
    made = Server(config)
    made.changes = app.state.services.changes
    return made
