"""What is measured of the API, and the page of all metrics.

Requests are counted by the route's template, never by the path that was asked for, so that the
number of series is bounded. A request takes until its answer begins: a stream of events would
count as hours otherwise; a `wait_for` counts with the time that it waited.
"""

from __future__ import annotations

import time

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.ports import Gauges, Json
from service.prometheus import Counter, Histogram, family

BOUNDS_S = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0)
METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
LABELS = ("method", "route", "status")


class Requests:
    """Counts and latencies of one process."""

    def __init__(self) -> None:
        self.total = Counter("bladetwin_http_requests_total", "Requests answered.", LABELS)
        self.seconds = Histogram(
            "bladetwin_http_request_seconds",
            "Time until an answer began.",
            ("method", "route"),
            BOUNDS_S,
        )

    def told(self) -> Json:
        """All of it, for another process."""
        return {"total": self.total.told(), "seconds": self.seconds.told()}

    def add(self, told: Json) -> None:
        """What another process, or this one's predecessor, counted."""
        self.total.add(told["total"])
        self.seconds.add(told["seconds"])

    def lines(self) -> list[str]:
        return self.total.lines() + self.seconds.lines()


class Measured:
    """ASGI middleware: counts each request and its time."""

    def __init__(self, app: ASGIApp, requests: Requests) -> None:
        self.app = app
        self.requests = requests

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        begun = time.perf_counter()
        method = scope["method"] if scope["method"] in METHODS else "other"

        async def watched(message: Message) -> None:
            if message["type"] == "http.response.start":
                route = template(scope)
                self.requests.total.count((method, route, str(message["status"])))
                self.requests.seconds.observe((method, route), time.perf_counter() - begun)
            await send(message)

        await self.app(scope, receive, watched)


def template(scope: Scope) -> str:
    """The template of the route that answers, e.g. ``/v1/rotors/{r}``; ``none`` without one."""
    return str(getattr(scope.get("route"), "path_format", None) or "none")


def of_database(found: Gauges | None) -> list[str]:
    """The families of the database; None: it does not answer."""
    lines = family(
        "bladetwin_database_up", "gauge", "1: the database answers.", [({}, found is not None)]
    )
    if found is None:
        return lines
    told: list[tuple[str, str, str, float | None]] = [
        ("rotors", "gauge", "Rotors.", found.rotors),
        ("backlog_entries", "gauge", "Entries of the log not yet applied.", found.backlog),
        ("oldest_entry_seconds", "gauge", "Age of the oldest of them.", found.oldest_s),
        ("dirty_rotors", "gauge", "Rotors with work to do: to apply or to seal.", found.dirty),
        ("blocked_rotors", "gauge", "Rotors that failed and wait for somebody.", found.blocked),
        ("provisional_rotors", "gauge", "Rotors not sealed yet.", found.provisional),
        ("outdated_rotors", "gauge", "Rotors of an older algorithm's version.", found.outdated),
        ("least_ess_ratio", "gauge", "Least effective share of nodes.", found.least_ess_ratio),
        ("jobs", "gauge", "Jobs queued or at work.", found.jobs),
        ("deliveries_pending", "gauge", "To be sent to webhooks.", found.deliveries_pending),
        ("deliveries_dead", "gauge", "Given up; sent when asked.", found.deliveries_dead),
        ("deliveries_dropped", "gauge", "Not sent any more.", found.deliveries_dropped),
        ("residual_alarms", "gauge", "Tests of residuals that alarm.", found.alarms),
        ("entries_applied_total", "counter", "Entries applied.", found.applied),
        ("versions_total", "counter", "Versions of posteriors written.", found.versions),
        ("versions_sealed_total", "counter", "Sealed versions written.", found.seals),
        ("takeovers_total", "counter", "Leases taken after they ran out.", found.takeovers),
        ("diagnoses_done_total", "counter", "Diagnoses that are done.", found.diagnosed),
        ("diagnoses_failed_total", "counter", "Diagnoses that failed.", found.undiagnosed),
        ("adoptions_total", "counter", "Adoptions of effects.", found.adoptions),
        ("back_outs_total", "counter", "Adoptions taken back.", found.back_outs),
    ]  # fmt: skip
    for name, kind, meaning, value in told:
        if value is not None:
            lines += family(f"bladetwin_{name}", kind, meaning, [({}, value)])
    return lines


def page(found: Gauges | None, requests: Requests, streams: int) -> str:
    """Everything, as Prometheus reads it."""
    opened = family(
        "bladetwin_event_streams", "gauge", "Streams of events open now.", [({}, streams)]
    )
    return "\n".join(of_database(found) + opened + requests.lines()) + "\n"
