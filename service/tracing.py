"""Traces: what became of a request, from its POST to the sealed posterior, across processes.

Off until `begin` finds an endpoint; then `service.otel` (extra ``otel``) writes spans, and nothing
else of the service knows OpenTelemetry. While it is off a span is one object that does nothing, and
no query is asked for it.

A trace crosses processes by way of the database: an entry of the log, or a job, keeps the
`traceparent` (W3C Trace Context) of the request that wrote it, and whoever works on it goes on from
there. Texts pass `tokens.redacted`, errors are told by the name of their kind alone: neither keys
nor readings stand in a span.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Literal, Protocol
from urllib.parse import urlsplit

from core.errors import InputError
from service.settings import Settings

Fact = str | int | float | bool
Kind = Literal["internal", "server", "consumer"]
OURS = "BLADETWIN_OTEL_ENDPOINT"
STANDARD = ("OTEL_EXPORTER_OTLP_TRACES_ENDPOINT", "OTEL_EXPORTER_OTLP_ENDPOINT")


class Span:
    """A piece of work of a trace; this one is written down nowhere.

    traceparent   by which others go on from here; None: nothing is traced
    """

    traceparent: str | None = None

    def tell(self, **facts: Fact | None) -> None:
        """Let it carry more, named as in OpenTelemetry's conventions or ``bladetwin.<name>``.

        Two underscores stand for a dot; None: nothing to tell.
        """

    def rename(self, name: str) -> None:
        """It is called otherwise, now that more is known."""

    def event(self, name: str) -> None:
        """Something happened now."""

    def fail(self, kind: str) -> None:
        """It failed; `kind` is the name of an error, never its text."""

    def end(self) -> None:
        """It ends now, and not with its block."""


NOTHING = Span()


class Tracer(Protocol):
    """Writes spans."""

    def start(
        self,
        name: str,
        kind: Kind,
        parent: Mapping[str, str] | None,
        links: Sequence[str],
        since_ns: int | None,
    ) -> Span: ...
    def within(self, span: Span) -> Iterator[None]: ...
    def current(self) -> str | None: ...
    def close(self) -> None: ...


_tracer: Tracer | None = None


def on() -> bool:
    """Whether anything is traced."""
    return _tracer is not None


def use(tracer: Tracer | None) -> None:
    """Write spans with `tracer` from now on; None: no more."""
    global _tracer
    _tracer = tracer


@contextmanager
def span(
    name: str,
    *,
    kind: Kind = "internal",
    parent: Mapping[str, str] | None = None,
    links: Sequence[str] = (),
    since_ns: int | None = None,
) -> Iterator[Span]:
    """A span around the block, below the one that is open here unless a `parent` is given.

    parent     ``traceparent`` and perhaps ``tracestate`` of another process; what is no valid one
               begins a new trace, as an empty mapping does
    links      traceparents of other traces that it is about
    since_ns   when it began, if before now; nanoseconds since 1970
    """
    if _tracer is None:
        yield NOTHING
        return
    one = _tracer.start(name, kind, parent, links, since_ns)
    try:
        with contextmanager(_tracer.within)(one):
            yield one
    except BaseException as error:
        one.fail(type(error).__name__)
        raise
    finally:
        one.end()


def current() -> str | None:
    """The traceparent of the span that is open here; None: nothing is traced."""
    return None if _tracer is None else _tracer.current()


def parent_of(traceparent: str | None) -> Mapping[str, str]:
    """What `span` takes as `parent`, of a traceparent that was stored; None begins a new trace."""
    return {} if traceparent is None else {"traceparent": traceparent}


def endpoint(settings: Settings, environ: Mapping[str, str]) -> str | None:
    """The full URL of the collector; None: nothing is to be traced.

    BLADETWIN_OTEL_ENDPOINT, else OpenTelemetry's own variables; OTEL_SDK_DISABLED=true and
    OTEL_TRACES_EXPORTER=none switch off. InputError for another exporter or protocol than OTLP by
    HTTP, or where the URL is none.
    """
    exporter = environ.get("OTEL_TRACES_EXPORTER", "").strip().lower() or "otlp"
    if environ.get("OTEL_SDK_DISABLED", "").strip().lower() == "true" or exporter == "none":
        return None
    named = [(OURS, settings.otel_endpoint), *((name, environ.get(name, "")) for name in STANDARD)]
    name, url = next(((n, u.strip()) for n, u in named if u.strip()), ("", ""))
    if not url:
        return None
    if exporter != "otlp":
        raise InputError(
            "OTEL_TRACES_EXPORTER", exporter, "is not spoken here", "write otlp or none"
        )
    for asked in ("OTEL_EXPORTER_OTLP_TRACES_PROTOCOL", "OTEL_EXPORTER_OTLP_PROTOCOL"):
        protocol = environ.get(asked, "").strip() or "http/protobuf"
        if protocol != "http/protobuf":
            raise InputError(asked, protocol, "is not spoken here", "write http/protobuf")
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.hostname or parts.username is not None:
        problem = "is no http or https URL without a user and password"
        remedy = "write http://127.0.0.1:4318, and a password into OTEL_EXPORTER_OTLP_HEADERS"
        raise InputError(name, "…", problem, remedy)
    whole = name == STANDARD[0] or parts.path.rstrip("/").endswith("/v1/traces")
    return url if whole else url.rstrip("/") + "/v1/traces"


def begin(settings: Settings, role: str, instance: str) -> None:
    """Trace this process from now on, where the settings or the environment name an endpoint.

    Raises NotInstalledError where the extra is missing.
    """
    url = endpoint(settings, os.environ)
    if url is None:
        return
    from service.otel import open_tracer

    use(open_tracer(url, role, instance))


def end() -> None:
    """Send what is left, for a few seconds at most, and trace no more."""
    global _tracer
    tracer, _tracer = _tracer, None
    if tracer is not None:
        tracer.close()
