"""Bodies above the limit are refused without being held in memory.

A declared length is judged before anything is read; a chunked body is counted as it comes. What
the client still sends is read and dropped for a while, so that it gets to see the answer instead
of a broken connection.
"""

from __future__ import annotations

from contextlib import suppress

from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.problems import fault, problem

DRAIN_BYTES = 512 * 2**20


class _TooLargeError(Exception):
    """The body has grown beyond the limit."""


class BodyLimit:
    """ASGI middleware: at most `limit` bytes of body, else 413."""

    def __init__(self, app: ASGIApp, limit: int) -> None:
        self.app = app
        self.limit = limit

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        headers = dict(scope["headers"])
        declared = headers.get(b"content-length", b"")
        if declared.isdigit() and int(declared) > self.limit:
            await self._refuse(scope, receive, send, int(declared), b"expect" not in headers)
            return
        taken = 0
        started = False

        async def counted() -> Message:
            nonlocal taken
            message = await receive()
            taken += len(message.get("body", b""))
            if taken > self.limit:
                raise _TooLargeError
            return message

        async def watched(message: Message) -> None:
            nonlocal started
            if taken > self.limit and not started:
                return  # what a parser made of the cut body
            started = True
            await send(message)

        with suppress(_TooLargeError):
            await self.app(scope, counted, watched)
        if taken > self.limit and not started:
            await self._refuse(scope, receive, send, taken, True)

    async def _refuse(
        self, scope: Scope, receive: Receive, send: Send, size: int, drain: bool
    ) -> None:
        dropped = 0
        while drain and dropped < DRAIN_BYTES:
            message = await receive()
            dropped += len(message.get("body", b""))
            if message["type"] != "http.request" or not message.get("more_body", False):
                break
        limit = f"{self.limit / 2**20:g} MiB"
        remedy = "post fewer inspections at once, or raise BLADETWIN_MAX_BODY_MB"
        if scope["path"] == "/v1/models":
            remedy = (
                "raise BLADETWIN_MAX_BODY_MB, or train with `bladetwin model train` and put the "
                "model into the database with `bladetwin model register`"
            )
        faults = [fault("body", f"{size} bytes or more", f"is above {limit}", remedy)]
        detail = (
            f"the body is above the limit of {limit}; nothing was stored. To mend it: {remedy}."
        )
        answer = problem(Request(scope), 413, "body-too-large", detail, faults)
        await answer(scope, receive, send)
