"""The layers around the routes, from the outside in.

=============  ===========================================================================
Measured       counts and times of requests
Manners        request id, browsers' headers, a line in the log
Traced         a span of the client's trace, where traces are on
CORS           where BLADETWIN_CORS_ORIGINS names pages that may call
Heads          HEAD as GET without its body
LastResort     an error that nobody foresaw is a problem, too
Trail          a row of the audit trail for what was refused
Gate           key, rate, schema, scope, rotor
Answers        bytes of answers that still hold
Compression    gzip for large answers
BodyLimit      bodies above the limit
Repeats        Idempotency-Key
EntityTags     ETag and 304
Again          what was understood before is answered anew without its route
=============  ===========================================================================
"""

from __future__ import annotations

from fastapi import FastAPI
from starlette.middleware.cors import CORSMiddleware

from service.api.gate import Gate
from service.api.heads import Heads
from service.api.kept import Again, Answers
from service.api.limits import BodyLimit
from service.api.manners import Manners
from service.api.metrics import Measured, Requests
from service.api.outdated import Outdated
from service.api.refusals import LastResort
from service.api.repeats import Repeats
from service.api.services import Services
from service.api.tags import Compression, EntityTags
from service.api.traced import Traced
from service.api.trail import Trail

SENT = (
    *("Authorization", "Idempotency-Key", "If-Match", "If-None-Match", "X-Request-Id"),
    *("traceparent", "tracestate"),
)
SHOWN = (
    *("ETag", "Location", "Retry-After", "RateLimit", "RateLimit-Policy", "X-Request-Id"),
    *("Idempotent-Replayed", "Bladetwin-Health", "traceresponse"),
)


def add_layers(app: FastAPI, services: Services, requests: Requests) -> None:
    """Put every layer around the application; the one added last is the outermost."""
    store, settings = services.store, services.settings
    app.add_middleware(Again)
    app.add_middleware(EntityTags)
    app.add_middleware(Repeats, store=store, keep_s=3600 * settings.idempotency_h)
    app.add_middleware(BodyLimit, limit=int(settings.max_body_mb * 2**20))
    app.add_middleware(Compression)
    app.add_middleware(Answers, store=store, limit_mb=settings.answers_mb)
    app.add_middleware(Gate, store=store, settings=settings, outdated=Outdated(app.state.schema))
    app.add_middleware(Trail, store=store)
    app.add_middleware(LastResort)
    app.add_middleware(Heads)
    if settings.origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=settings.origins,
            allow_methods=["GET", "HEAD", "POST", "DELETE"],
            allow_headers=SENT,
            expose_headers=SHOWN,
        )
    app.add_middleware(Traced)
    app.add_middleware(Manners)
    app.add_middleware(Measured, requests=requests)
