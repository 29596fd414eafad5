"""Webhooks: made, looked after, and read by who receives them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

from service.client import answers
from service.client.steps import Call, Json, Steps, ask, path, told
from service.signing import verified


def read_webhook(
    secret: str, headers: Mapping[str, str], body: bytes, *, tolerance_s: float = 300.0
) -> Json:
    """What a webhook's receiver was told: ``{"id", "type", "timestamp", "data"}``.

    secret    as the webhook's creation answered it
    headers   of the request; body: its bytes as they came, not parsed and written again
    id        the same each time a message is sent: one that was seen before is to be dropped

    Raises SignatureError where the service did not sign this, or longer ago than `tolerance_s`.
    """
    message_id = verified(secret, headers, body, tolerance_s=tolerance_s)
    said: Json = json.loads(body)
    return said | {"id": message_id}


def create_webhook(
    webhook: str,
    url: str,
    *,
    events: Sequence[str] | None = None,
    rotors: Sequence[str] | None = None,
) -> Steps[answers.WebhookMade]:
    """Have what happens sent to a URL: ``{"webhook", "secret"}``; the secret is shown once.

    events   some of sealed, blocked, alarm, diagnosed, diagnosis-failed, diagnosis-cancelled,
             adopted, backed-out; None: all
    rotors   the only ones; None: all
    """
    body: Json = {"id": webhook, "url": url}
    body |= {} if events is None else {"events": list(events)}
    body |= {} if rotors is None else {"rotors": list(rotors)}
    return ask("POST", path("webhooks"), json=body)


def webhook(webhook: str) -> Steps[answers.Webhook]:
    """A webhook, with how many deliveries are pending, delivered, dead and dropped."""
    return ask("GET", path("webhooks", webhook))


def delete_webhook(webhook: str) -> Steps[answers.WebhookDeleted]:
    """Delete a webhook and what is pending."""
    return ask("DELETE", path("webhooks", webhook))


def deliveries(webhook: str, status: str | None = None) -> Call:
    """What a webhook was or is to be told, the newest first, page by page."""
    return Call("GET", path("webhooks", webhook, "deliveries"), told(status=status))


def retry_delivery(webhook: str, delivery: str) -> Steps[answers.Delivery]:
    """Have a dead delivery sent again."""
    return ask("POST", path("webhooks", webhook, "deliveries", delivery, "retry"))
