"""A diagnosis as a page to hand on."""

from __future__ import annotations

from hashlib import sha256
from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import HTMLResponse, Response
from pydantic import FiniteFloat

from service.api.services import Name, Wired, unchanged
from service.api.tags import REVALIDATE
from service.api.visit import visit_of
from service.handlers.reports import diagnosis_report
from service.report.page import policy

router = APIRouter(prefix="/v1/rotors/{r}/diagnoses", tags=["diagnoses"])
Limit = Annotated[
    FiniteFloat | None,
    Query(description="of the quantity that is forecast, in its unit"),
]


@router.get(
    "/{d}/report",
    summary="A finished diagnosis as one HTML file: no script, no other file",
    response_class=HTMLResponse,
)
def get_report(
    request: Request, r: Name, d: Name, services: Wired, limit: Limit = None
) -> Response:
    """The page may load nothing but the style sheet inside it, whoever shows it."""
    page = diagnosis_report(services.store, r, d, limit)
    visit = visit_of(request.scope)
    if visit is not None:
        visit.headers["Content-Security-Policy"] = f"{policy()}; frame-ancestors 'none'"
    tag = f'"{sha256(page.encode()).hexdigest()[:32]}"'
    known = unchanged(request, tag)
    return known or HTMLResponse(page, headers={"ETag": tag, "Cache-Control": REVALIDATE})
