"""The protocol over HTTP. It knows no keys, so it answers programs of this machine alone."""

from __future__ import annotations

from collections.abc import Mapping

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse
from starlette.routing import Route

from service.api.loopback import by_loopback
from service.umbridge.protocol import Served, answer

STRANGER = "UM-Bridge has no keys: it answers programs of this machine alone"
MOST_BYTES = 2**22


def umbridge_app(models: Mapping[str, Served]) -> Starlette:
    """The application that serves these models."""

    async def respond(request: Request) -> JSONResponse:
        if not by_loopback(request.scope, ()):
            return JSONResponse({"error": {"type": "Forbidden", "message": STRANGER}}, 403)
        body = bytearray()
        async for chunk in request.stream():
            body += chunk
            if len(body) > MOST_BYTES:
                message = f"the body is above {MOST_BYTES} bytes"
                return JSONResponse({"error": {"type": "InvalidInput", "message": message}}, 413)
        method, path = request.method, request.url.path
        status, told = await run_in_threadpool(answer, models, method, path, bytes(body))
        return JSONResponse(told, status)

    methods = ["GET", "POST", "PUT", "PATCH", "DELETE"]
    return Starlette(routes=[Route("/{path:path}", respond, methods=methods)])
