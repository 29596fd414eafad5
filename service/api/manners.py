"""What every answer has: a request id, headers that browsers mind, and a line in the log.

A client may name its request in `X-Request-Id`; the id comes back with the answer and stands in
every line that the request logs and in its row of the audit trail.
"""

from __future__ import annotations

import logging
import re
import secrets
import time

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service import telemetry
from service.api.visit import PLACE, Visit
from service.tokens import redacted

log = logging.getLogger("bladetwin.http")
REQUEST_ID = re.compile(r"[A-Za-z0-9._:\-]{1,100}")
ALWAYS = {
    "X-Content-Type-Options": "nosniff",
    "Content-Security-Policy": (
        "default-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
    ),
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}
QUIET = frozenset({"/healthz", "/readyz"})


class Manners:
    """ASGI middleware, the outermost: begins the visit and ends it with a line in the log."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        given = Headers(scope=scope).get("x-request-id", "")
        named = REQUEST_ID.fullmatch(given) is not None and redacted(given) == given
        client = scope.get("client")
        visit = Visit(given if named else secrets.token_hex(8), client and str(client[0]))
        scope[PLACE] = visit
        status = 0

        async def mannered(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                headers = MutableHeaders(scope=message)
                for name, value in (ALWAYS | visit.headers).items():
                    headers[name] = value
                headers["X-Request-Id"] = visit.request_id
                # What has no tag to be asked for again by is not to be kept by anybody.
                headers.setdefault("Cache-Control", "no-store")
            await send(message)

        begun = time.monotonic()
        with telemetry.request(visit.request_id):
            try:
                await self.app(scope, receive, mannered)
            finally:
                told = log.debug if scope["path"] in QUIET else log.info
                took = 1000 * (time.monotonic() - begun)
                told("%s %s %d %.1f ms", scope["method"], scope["path"], status, took)
