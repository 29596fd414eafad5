"""HEAD: the head of what GET would answer, on every route that answers GET.

Inside of this layer there is GET alone, so that key, scope, ETag, length and compression are those
of GET, and its work is done: what an answer is called by often follows from its bytes. Only the
body stays here, and the head waits for its end: a client has all that it asked for with the head,
and the work would go on behind it. A stream of events has no end to wait for; its route asks
`is_head` and opens none.
"""

from __future__ import annotations

from starlette.types import ASGIApp, Message, Receive, Scope, Send

PLACE = "bladetwin.head"
TOLD = ("route", "path_params", "endpoint")  # what layers outside want to know of the route


def is_head(scope: Scope) -> bool:
    """Whether a request that looks like GET asks for the head alone."""
    return scope.get(PLACE) is True


class Heads:
    """ASGI middleware: answers HEAD as GET, without the body."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self.app(scope, receive, send)
            return
        asked = {**scope, "method": "GET", PLACE: True}
        start: Message | None = None

        async def bodiless(message: Message) -> None:
            nonlocal start
            if message["type"] == "http.response.start":
                start = message
            elif start is not None and not message.get("more_body", False):
                scope.update({name: asked[name] for name in TOLD if name in asked})
                await send(start)
                await send({"type": "http.response.body", "body": b"", "more_body": False})

        await self.app(asked, receive, bodiless)
