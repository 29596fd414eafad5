"""The application: routers, limits and problems around the wired parts."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from functools import partial

from fastapi import Depends, FastAPI

from service.api import refusals
from service.api.describe import describe
from service.api.feed import Feed
from service.api.layers import add_layers
from service.api.loopback import keys_required
from service.api.metrics import Requests
from service.api.query import known_query
from service.api.repeated import given_once
from service.api.routers import (
    adoptions,
    audit,
    diagnoses,
    draws,
    events,
    fields,
    glance,
    inspections,
    models,
    plans,
    reads,
    reports,
    residuals,
    rotors,
    series,
    system,
    webhooks,
)
from service.api.services import Services
from service.api.together import Together
from service.handlers.events import newest_notes
from service.pages.routes import router as pages
from service.release import release

PROBLEM = {
    "description": "A problem (RFC 9457)",
    "content": {
        "application/problem+json": {
            "schema": {
                "type": "object",
                "required": ["type", "title", "status", "detail", "instance", "faults"],
                "properties": {
                    "type": {"type": "string"},
                    "title": {"type": "string"},
                    "status": {"type": "integer"},
                    "detail": {"type": "string"},
                    "instance": {"type": "string"},
                    "faults": {
                        "type": "array",
                        "items": {
                            "type": "object",
                            "required": ["field", "value", "problem", "remedy"],
                        },
                    },
                },
            }
        }
    },
}


def create_app(
    services: Services,
    schema: Callable[[], tuple[str | None, str | None]],
    together: Together | None = None,
) -> FastAPI:
    """The application over wired parts.

    schema     the revision that the database has, and what to do where it is not this release's
    together   what other API processes of the same service count; None: there are none
    """

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        services.changes.start()
        async with _telling(together, app.state.requests, app.state.feed):
            yield
            services.changes.begin_close()
            await app.state.feed.close()
            services.changes.close()

    app = FastAPI(
        title="bladetwin",
        version=release(),
        summary="Online digital twin of turbine rotor blades",
        docs_url=None,
        redoc_url=None,
        lifespan=lifespan,
        responses={"default": PROBLEM},
        redirect_slashes=False,
        # whole addresses with their queries would stand in its spans; ours: service.api.traced
        telemetry={"tracing": False, "logs": False},
    )
    app.state.services = services
    app.state.schema = schema
    app.state.feed = Feed(services.changes, partial(newest_notes, services.store))
    app.state.requests, app.state.together = Requests(), together
    for module in (  # a request is held against one after the other: the busiest come first
        rotors,
        inspections,
        reads,
        system,
        models,
        glance,
        draws,
        fields,
        series,
        plans,
        events,
        diagnoses,
        adoptions,
        reports,
        residuals,
        audit,
        webhooks,
    ):
        once = [] if module is inspections else [Depends(given_once)]
        app.include_router(module.router, dependencies=[Depends(known_query), *once])
    app.include_router(pages)
    refusals.install(app)
    add_layers(app, services, app.state.requests)
    describe(app, keys=keys_required(services.settings))
    return app


@asynccontextmanager
async def _telling(
    together: Together | None, requests: Requests, feed: Feed
) -> AsyncIterator[None]:
    """The other API processes are told what this one counts."""
    if together is None:
        yield
        return
    together.resume(requests)
    task = asyncio.create_task(together.keep_writing(requests, feed))
    try:
        yield
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
