"""Webhooks."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query
from fastapi.responses import JSONResponse

from service.api.problems import RequestError, fault
from service.api.schemas import Nothing, WebhookIn
from service.api.services import Cursor, Limit, Name, Services, Wired, moment, page, page_size
from service.handlers import webhooks as use
from service.hooks import STATUSES, DeliveryRecord, Status, WebhookRecord

router = APIRouter(prefix="/v1/webhooks", tags=["webhooks"])


def webhook_out(found: WebhookRecord, counts: dict[str, int]) -> dict[str, Any]:
    return {
        "id": found.id,
        "url": found.url,
        "events": list(found.events),
        "rotors": None if found.rotors is None else list(found.rotors),
        "created_at": moment(found.created_at),
        "deliveries": {name: counts.get(name, 0) for name in (*STATUSES, "dropped")},
    }


def delivery_out(found: DeliveryRecord) -> dict[str, Any]:
    return {
        "id": found.message_id,
        "number": found.number,
        "rotor": found.rotor_id,
        "event": found.event,
        "status": found.status,
        "attempts": found.attempts,
        "created_at": moment(found.created_at),
        "tried_at": None if found.tried_at is None else moment(found.tried_at),
        "not_before": None if found.not_before is None else moment(found.not_before),
        "last_error": found.last_error,
    }


@router.post("", status_code=201, summary="Create a webhook; its secret is in this answer alone")
def post_webhook(body: WebhookIn, services: Wired) -> JSONResponse:
    settings = services.settings
    made, secret = use.create_webhook(
        services.store,
        settings.webhook_key_file,
        settings.webhook_networks,
        body.id,
        body.url,
        body.events,
        body.rotors,
    )
    # no-store: no cache, and no first answer kept by Idempotency-Key, may hold the secret
    headers = {"Location": f"/v1/webhooks/{made.id}", "Cache-Control": "no-store"}
    headers |= {"Idempotent-Replayed": "true"} if secret is None else {}
    return JSONResponse({"webhook": _one(services, made.id), "secret": secret}, 201, headers)


def _one(services: Services, webhook_id: str) -> dict[str, Any]:
    found = use.find_webhook(services.store, webhook_id)
    return webhook_out(found.webhook, found.counts)


@router.get("", summary="Webhooks, page by page")
def get_webhooks(services: Wired, limit: Limit = None, cursor: Cursor = None) -> dict[str, Any]:
    size = page_size(services, limit)
    found = use.list_webhooks(services.store, cursor or "", size + 1)
    return page([webhook_out(one.webhook, one.counts) for one in found], size, "id")


@router.get("/{w}", summary="A webhook, and how many deliveries it has of each status")
def get_webhook(w: Name, services: Wired) -> dict[str, Any]:
    return _one(services, w)


@router.delete("/{w}", summary="Delete a webhook, and what it was still to be told")
def delete_webhook(w: Name, services: Wired) -> dict[str, Any]:
    return {"id": use.delete_webhook(services.store, w).id, "deleted": True}


@router.get("/{w}/deliveries", summary="What a webhook was or is to be told, the newest first")
def get_deliveries(
    w: Name,
    services: Wired,
    status: Annotated[Status | None, Query()] = None,
    limit: Limit = None,
    cursor: Cursor = None,
) -> dict[str, Any]:
    size = page_size(services, limit)
    if cursor is not None and not (cursor.isdigit() and cursor.isascii() and len(cursor) < 19):
        remedy = "use `next` of the page before"
        text = f"cursor = {cursor!r} is no cursor. To mend it: {remedy}"
        faults = [fault("cursor", cursor, "is no cursor", remedy)]
        raise RequestError(422, "invalid-input", text, faults)
    before = None if cursor is None else int(cursor)
    found = use.list_deliveries(services.store, w, status, before, size + 1)
    return page([delivery_out(one) for one in found], size, "number")


@router.post("/{w}/deliveries/{d}/retry", status_code=202, summary="Send a dead delivery again")
def retry_delivery(
    w: Name, d: Name, services: Wired, body: Nothing | None = None
) -> dict[str, Any]:
    return delivery_out(use.retry_delivery(services.store, w, d))
