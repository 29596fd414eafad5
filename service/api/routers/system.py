"""Is the process alive; can it serve."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse, Response

from service.api.metrics import Requests, page
from service.api.services import Wired
from service.errors import StoreAwayError
from service.prometheus import MEDIA_TYPE

router = APIRouter(tags=["system"])


@router.get("/healthz", summary="The process is alive")
async def healthz() -> dict[str, str]:
    return {"status": "alive"}


@router.get("/readyz", summary="The database answers, with a schema that this release may run on")
def readyz(request: Request) -> JSONResponse:
    checks: dict[str, Any] = {}
    try:
        found, remedy = request.app.state.schema()
        checks["database"] = "answers"
        checks["schema"] = found
        ready = remedy is None
        if not ready:
            checks["remedy"] = remedy
    except StoreAwayError as error:
        ready = False
        checks["database"] = error.cause
    return JSONResponse({"ready": ready} | checks, 200 if ready else 503)


@router.get("/metrics", summary="Metrics, as Prometheus reads them", response_class=Response)
def metrics(request: Request, services: Wired) -> Response:
    try:
        with services.store.read() as tx:
            found = tx.gauges(services.science.superseded)
    except StoreAwayError:
        found = None
    state = request.app.state
    counted: tuple[Requests, int] = (state.requests, state.feed.listeners)
    if state.together is not None:
        counted = state.together.whole(*counted)
    return Response(page(found, *counted), media_type=MEDIA_TYPE)
