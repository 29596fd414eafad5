"""Inspections: posted one, many or as CSV; corrected, retracted, listed."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import JSONResponse, Response

from service.api.csv_rows import CSV_EXAMPLE
from service.api.files import CSV, PARQUET, SENSORTHINGS, file
from service.api.problems import fault, invalid
from service.api.reading_bodies import READINGS, InspectionIn, read_inspections
from service.api.repeated import given_once
from service.api.schemas import Nothing
from service.api.sensorthings import ARRAY_EXAMPLE, EXAMPLE
from service.api.services import (
    Cursor,
    Limit,
    Name,
    Services,
    Wired,
    accepted,
    moment,
    page,
    page_size,
    seq_of,
    tag_of,
    unchanged,
)
from service.export.readings import COLUMNS
from service.handlers import exports, listing
from service.handlers import inspections as use
from service.names import ID_PATTERN

router = APIRouter(prefix="/v1/rotors/{r}/inspections", tags=["inspections"])

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
            SENSORTHINGS: {
                "schema": {
                    "oneOf": [{"type": "object"}, {"type": "array", "items": {"type": "object"}}],
                    "description": "an Observation, data arrays, or Datastreams with Observations",
                },
                "examples": {
                    "observation": {"value": EXAMPLE},
                    "data array": {"value": ARRAY_EXAMPLE},
                },
            },
        },
    }
}


async def raw_body(request: Request) -> bytes:
    return await request.body()


def listed_out(item: listing.Listed) -> dict[str, Any]:
    body = dict(item.body)
    if "count" in body:
        body["values"] = body["nodes"] = None
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
    summary="Post one reading, many, CSV or SensorThings: all or nothing",
    openapi_extra=BODY,
)
def post_inspections(
    r: Name, request: Request, services: Wired, body: Annotated[bytes, Depends(raw_body)]
) -> JSONResponse:
    also = partial(use.faults_here, services.store, r)
    items = read_inspections(body, request.headers.get("content-type", ""), also)
    return accepted(use.post_inspections(services.store, r, items))


@router.get(
    "", summary="Readings in the order of arrival, and whether each counts", response_model=None
)
def get_inspections(
    r: Name,
    request: Request,
    services: Wired,
    limit: Limit = None,
    cursor: Cursor = None,
    blade: Annotated[
        str | None, Query(max_length=100, pattern=ID_PATTERN, description="of this blade alone")
    ] = None,
    newest: Annotated[bool, Query(description="the newest first")] = False,
    format: Annotated[
        Literal["json", "csv", "parquet", "sensorthings"],
        Query(
            description="whole files: csv and sensorthings, those that count; parquet, all with "
            "their status"
        ),
    ] = "json",
) -> Response:
    if format != "json":
        paging = {"limit": limit, "cursor": cursor, "newest": newest or None}
        remedy = "leave it out, or take format=json"
        faults = [
            fault(name, value, "belongs to pages; a file holds everything", remedy)
            for name, value in paging.items()
            if value is not None
        ]
        if faults:
            raise invalid(faults)
        return _file(request, services, r, blade, format)
    size = page_size(services, limit)
    after = seq_of(cursor)
    items = listing.list_inspections(services.store, r, after, size + 1, blade, newest)
    return JSONResponse(page([listed_out(item) for item in items], size, "seq"))


def _file(request: Request, services: Services, r: str, blade: str | None, form: str) -> Response:
    """The readings of a rotor, or of one blade, as the log stands now."""
    log = listing.log_now(services.store, r, blade)
    tag = tag_of(request, log.rotor, log.created_at, log.head_seq)
    if (same := unchanged(request, tag)) is not None:
        return same
    saved = (r, *([] if blade is None else [blade]), "readings", log.head_seq)
    if form == "csv":
        return file(exports.readings_csv(services.store, log, blade), CSV, saved, "csv", tag)
    if form == "sensorthings":
        return file(
            exports.sensorthings(services.store, log, blade), SENSORTHINGS, saved, "json", tag
        )
    table = exports.readings_parquet(services.store, log, blade)
    return file(table, PARQUET, saved, "parquet", tag)


@router.get("/{i}", summary="One reading with all its values")
def get_inspection(r: Name, i: Name, services: Wired) -> dict[str, Any]:
    return listed_out(listing.find_inspection(services.store, r, i))


@router.post(
    "/{i}/retraction",
    status_code=202,
    summary="As if the reading had never come",
    dependencies=[Depends(given_once)],
)
def post_retraction(r: Name, i: Name, services: Wired, body: Nothing | None = None) -> JSONResponse:
    return accepted([use.retract(services.store, r, i)])
