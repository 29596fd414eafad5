"""Spans written with OpenTelemetry and sent by OTLP over HTTP (extra ``otel``).

The provider is this module's own and not the process's: libraries that would trace by themselves
where a global one is set, whole URLs with queries included (FastAPI does), stay silent. Sampling,
limits, the time between sendings and headers for the collector are read by the SDK from its
standard variables (``OTEL_TRACES_SAMPLER``, ``OTEL_BSP_…``, ``OTEL_EXPORTER_OTLP_HEADERS``).
A collector that is away costs spans and lines in the log, never a request: the queue is bounded.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from service.errors import NotInstalledError
from service.release import release
from service.tokens import redacted
from service.tracing import OURS, STANDARD, Fact, Kind, Span

try:
    from opentelemetry import trace
    from opentelemetry.context import Context
    from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
    from opentelemetry.sdk.resources import Resource
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.sdk.trace.export import BatchSpanProcessor
    from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator
except ImportError:
    raise NotInstalledError(
        "opentelemetry-sdk or its OTLP exporter over HTTP", "otel", f"unset {OURS}, {STANDARD[1]}"
    ) from None

CLOSE_S = 3.0
SEND_S = 3.0
W3C = TraceContextTextMapPropagator()
KINDS = {
    "internal": trace.SpanKind.INTERNAL,
    "server": trace.SpanKind.SERVER,
    "consumer": trace.SpanKind.CONSUMER,
}


class OtelSpan(Span):
    """A span of the SDK."""

    def __init__(self, span: Any) -> None:
        self.span = span
        self.traceparent = _traceparent(span)

    def tell(self, **facts: Fact | None) -> None:
        for name, value in facts.items():
            if value is None or not self.span.is_recording():
                continue
            key = name.replace("__", ".") if "__" in name else f"bladetwin.{name}"
            self.span.set_attribute(key, redacted(value) if isinstance(value, str) else value)

    def rename(self, name: str) -> None:
        if self.span.is_recording():
            self.span.update_name(name)

    def event(self, name: str) -> None:
        if self.span.is_recording():
            self.span.add_event(redacted(name))

    def fail(self, kind: str) -> None:
        if self.span.is_recording():
            self.span.set_status(trace.StatusCode.ERROR, kind)
            self.span.set_attribute("error.type", kind)

    def end(self) -> None:
        if self.span.is_recording():
            self.span.end()


class OtelTracer:
    """Writes spans with a provider of its own; `processor` takes those that have ended."""

    def __init__(self, processor: Any, role: str, instance: str) -> None:
        facts = {
            "service.version": release(),
            "service.instance.id": instance,
            "bladetwin.role": role,
        }
        resource = Resource.create(facts)
        if resource.attributes.get("service.name", "").startswith("unknown_service"):
            resource = resource.merge(Resource({"service.name": "bladetwin"}))
        self._provider = TracerProvider(resource=resource, shutdown_on_exit=False)
        self._provider.add_span_processor(processor)
        self._tracer = self._provider.get_tracer("bladetwin", release())

    def start(
        self,
        name: str,
        kind: Kind,
        parent: Mapping[str, str] | None,
        links: Sequence[str],
        since_ns: int | None,
    ) -> OtelSpan:
        context = None if parent is None else W3C.extract(dict(parent), Context())
        told = [trace.Link(found) for one in links if (found := _context_of(one)) is not None]
        return OtelSpan(
            self._tracer.start_span(
                name, context=context, kind=KINDS[kind], links=told, start_time=since_ns
            )
        )

    def within(self, span: Span) -> Iterator[None]:
        assert isinstance(span, OtelSpan)
        with trace.use_span(span.span, record_exception=False, set_status_on_exception=False):
            yield

    def current(self) -> str | None:
        return _traceparent(trace.get_current_span())

    def close(self) -> None:
        """Send what is left; a collector that does not answer is not waited for."""
        sending = threading.Thread(target=self._provider.shutdown, name="traces", daemon=True)
        sending.start()
        sending.join(CLOSE_S)


def open_tracer(url: str, role: str, instance: str) -> OtelTracer:
    """A tracer that sends to the collector at `url`, in batches and behind the work."""
    timed = any(os.environ.get(f"OTEL_EXPORTER_OTLP_{which}TIMEOUT") for which in ("", "TRACES_"))
    exporter = OTLPSpanExporter(endpoint=url, timeout=None if timed else SEND_S)
    return OtelTracer(BatchSpanProcessor(exporter), role, instance)


def _traceparent(span: Any) -> str | None:
    carrier: dict[str, str] = {}
    W3C.inject(carrier, trace.set_span_in_context(span, Context()))
    return carrier.get("traceparent")


def _context_of(traceparent: str) -> Any:
    """The span that a traceparent names; None where it names none."""
    context = W3C.extract({"traceparent": traceparent}, Context())
    found = trace.get_current_span(context).get_span_context()
    return found if found.is_valid else None
