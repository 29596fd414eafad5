"""Inspections: posted one, many or as CSV; corrected, retracted, listed."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import JSONResponse

from service.api.schemas import (
    COLUMNS,
    CSV_EXAMPLE,
    READINGS,
    InspectionIn,
    Nothing,
    read_inspections,
)
from service.api.services import (
    Cursor,
    Limit,
    Name,
    Wired,
    accepted,
    moment,
    page,
    page_size,
    seq_of,
)
from service.handlers import inspections as use
from service.names import ID_PATTERN

router = APIRouter(prefix="/v1/rotors/{r}/inspections", tags=["inspections"])
FEW = 16

_ONE = InspectionIn.model_json_schema()
_MANY = {
    "type": "object",
    "properties": {"inspections": {"type": "array", "minItems": 1, "items": _ONE}},
    "required": ["inspections"],
    "additionalProperties": False,
}
BODY = {
    "requestBody": {
        "required": True,
        "content": {
            "application/json": {
                "schema": {"oneOf": [_ONE, _MANY]},
                "examples": {
                    "one": {"value": READINGS[0]},
                    "many": {"value": {"inspections": READINGS}},
                },
            },
            "text/csv": {
                "schema": {"type": "string", "description": f"columns: {', '.join(COLUMNS)}"},
                "example": CSV_EXAMPLE,
            },
        },
    }
}


async def raw_body(request: Request) -> bytes:
    return await request.body()


def listed_out(item: use.Listed, *, full: bool) -> dict[str, Any]:
    body = dict(item.body)
    values = body["values"]
    if not full and len(values) > FEW:
        body["values"] = body["nodes"] = None
        body["count"] = len(values)
    return {
        **body,
        "seq": item.seq,
        "status": item.status,
        "received_at": moment(item.received_at),
        "posted_by": item.posted_by,
    }


@router.post(
    "",
    status_code=202,
    summary="Post one reading, many, or CSV: all or nothing",
    openapi_extra=BODY,
)
def post_inspections(
    r: Name, request: Request, services: Wired, body: Annotated[bytes, Depends(raw_body)]
) -> JSONResponse:
    items = read_inspections(body, request.headers.get("content-type", ""))
    return accepted(use.post_inspections(services.store, r, items))


@router.get("", summary="Readings in the order of arrival, and whether each counts")
def get_inspections(
    r: Name,
    services: Wired,
    limit: Limit = None,
    cursor: Cursor = None,
    blade: Annotated[
        str | None, Query(max_length=100, pattern=ID_PATTERN, description="of this blade alone")
    ] = None,
    newest: Annotated[bool, Query(description="the newest first")] = False,
) -> dict[str, Any]:
    size = page_size(services, limit)
    after = seq_of(cursor)
    items = use.list_inspections(services.store, r, after, size + 1, blade, newest)
    return page([listed_out(item, full=False) for item in items], size, "seq")


@router.get("/{i}", summary="One reading with all its values")
def get_inspection(r: Name, i: Name, services: Wired) -> dict[str, Any]:
    return listed_out(use.find_inspection(services.store, r, i), full=True)


@router.post("/{i}/retraction", status_code=202, summary="As if the reading had never come")
def post_retraction(r: Name, i: Name, services: Wired, body: Nothing | None = None) -> JSONResponse:
    return accepted([use.retract(services.store, r, i)])
