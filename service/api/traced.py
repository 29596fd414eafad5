"""A span for each request, in the trace that the client names.

`traceparent` and `tracestate` are taken as W3C Trace Context says: one valid header goes on with
the client's trace, anything else begins a new one. The answer names the request's own span in
`traceresponse`, in the same form. A span carries method, route (the template, never the path that
was asked for), status, request id and rotor; no query, no header, no body, no key.

A stream of events is a span until its answer begins: it would be told after hours otherwise. What
probes and scrapers ask for is not traced.
"""

from __future__ import annotations

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service import telemetry, tracing
from service.api.manners import QUIET
from service.api.metrics import METHODS, template
from service.api.visit import visit_of

UNTRACED = QUIET | {"/metrics"}


class Traced:
    """ASGI middleware, right inside of what begins the visit."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        visit = visit_of(scope)
        if not tracing.on() or visit is None or scope["path"] in UNTRACED:
            await self.app(scope, receive, send)
            return
        method = scope["method"] if scope["method"] in METHODS else "_OTHER"
        with tracing.span(method, kind="server", parent=parent(scope)) as span:
            if span.traceparent is not None:
                visit.headers["traceresponse"] = span.traceparent
                telemetry.tell(trace_id=span.traceparent.split("-")[1])

            async def watched(message: Message) -> None:
                if message["type"] == "http.response.start":
                    status, route = message["status"], template(scope)
                    named = route != "none"
                    span.rename(f"{method} {route}" if named else method)
                    span.tell(
                        http__request__method=method,
                        http__route=route if named else None,
                        http__response__status_code=status,
                        request_id=visit.request_id,
                        rotor=scope.get("path_params", {}).get("r"),
                        problem=visit.problem,
                    )
                    if status >= 500:
                        span.fail(visit.problem or str(status))
                    if "event-stream" in Headers(raw=message["headers"]).get("content-type", ""):
                        span.end()
                await send(message)

            await self.app(scope, receive, watched)


def parent(scope: Scope) -> dict[str, str]:
    """The trace that a request names; empty: none, or two."""
    headers = Headers(scope=scope)
    given = headers.getlist("traceparent")
    if len(given) != 1:
        return {}
    state = ",".join(headers.getlist("tracestate"))
    return {"traceparent": given[0]} | ({"tracestate": state} if state else {})
