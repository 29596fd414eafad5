"""Webhooks: made, listed, deleted; what they were told, and told again."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

from core.errors import InputError
from service import signing
from service.errors import ConflictError, FaultsError, NotFoundError, WebhooksOffError
from service.hooks import KINDS, STATUSES, DeliveryRecord, WebhookRecord
from service.outbound import networks, target_of
from service.ports import Store, Transaction

PATIENCE_S = 5.0


@dataclass(frozen=True, slots=True)
class Counted:
    """A webhook and its deliveries by status."""

    webhook: WebhookRecord
    counts: dict[str, int]


def create_webhook(
    store: Store,
    key_file: str,
    allowed: str,
    webhook_id: str,
    url: str,
    events: Sequence[str] | None,
    rotors: Sequence[str] | None,
) -> tuple[WebhookRecord, str | None]:
    """A new webhook and its secret, which is shown this once; the same again: without it.

    key_file   of which the secret is made; empty: WebhooksOffError
    allowed    networks beside the public ones, as in BLADETWIN_WEBHOOK_NETWORKS
    events     None: all kinds
    rotors     the only ones, there already or not; None: all

    What is committed after it has returned is told; whoever commits meanwhile is waited for.

    Raises FaultsError for what cannot be used, ConflictError where the id has another content.
    """
    if not key_file:
        raise WebhooksOffError(signing.SETTING)
    key = signing.read_key(key_file)
    asked = KINDS if events is None else events
    faults = [
        InputError("events", one, "is no event", f"use some of {', '.join(KINDS)}")
        for one in asked
        if one not in KINDS
    ]
    if not asked:
        faults.append(InputError("events", [], "is empty", f"name some of {', '.join(KINDS)}"))
    if rotors is not None and not rotors:
        faults.append(InputError("rotors", [], "is empty", "name some, or leave it out for all"))
    try:
        target_of(url, networks(allowed))
    except InputError as error:
        faults.append(error)
    if faults:
        raise FaultsError(faults)
    salt = os.urandom(16).hex()
    secret = signing.secret_of(key, webhook_id, salt)
    kinds = tuple(kind for kind in KINDS if kind in asked)
    only = None if rotors is None else tuple(sorted(set(rotors)))
    made = WebhookRecord(webhook_id, url, kinds, only, salt, signing.fingerprint(secret))
    with store.write() as tx:
        there = tx.webhooks.put(made)
        found = there or _found(tx, webhook_id)
    if there is None:
        # a transaction under way may have looked for webhooks before this one was there
        store.others_ended(PATIENCE_S)
        return found, secret
    if not there.same(made):
        raise ConflictError("webhook", webhook_id, "choose a new id, or delete it first")
    return there, None


def list_webhooks(store: Store, after: str, limit: int) -> list[Counted]:
    """Webhooks in the order of their ids, after one."""
    with store.read() as tx:
        found = tx.webhooks.page(after, limit)
        counts = tx.webhooks.counts([one.id for one in found])
    return [Counted(one, counts[one.id]) for one in found]


def find_webhook(store: Store, webhook_id: str) -> Counted:
    with store.read() as tx:
        return Counted(_found(tx, webhook_id), tx.webhooks.counts([webhook_id])[webhook_id])


def delete_webhook(store: Store, webhook_id: str) -> WebhookRecord:
    """It is told nothing more, not even what is pending; what is being sent may still arrive."""
    with store.write() as tx:
        found = _found(tx, webhook_id)
        tx.webhooks.delete(webhook_id)
    return found


def list_deliveries(
    store: Store, webhook_id: str, status: str | None, before: int | None, limit: int
) -> list[DeliveryRecord]:
    """What a webhook was or is to be told, the newest first."""
    if status is not None and status not in STATUSES:
        raise InputError("status", status, "is no status", f"use {', '.join(STATUSES)}")
    with store.read() as tx:
        _found(tx, webhook_id)
        return tx.webhooks.deliveries(webhook_id, status, before, limit)


def retry_delivery(store: Store, webhook_id: str, message_id: str) -> DeliveryRecord:
    """Send a dead delivery again; one that is pending or delivered stays as it is."""
    with store.write() as tx:
        _found(tx, webhook_id)
        tx.webhooks.revive(webhook_id, message_id)
        found = tx.webhooks.delivery(webhook_id, message_id)
        if found is None:
            remedy = f"GET /v1/webhooks/{webhook_id}/deliveries lists those that are kept"
            raise NotFoundError("delivery", message_id, remedy)
        return found


def _found(tx: Transaction, webhook_id: str) -> WebhookRecord:
    found = tx.webhooks.find(webhook_id)
    if found is None:
        raise NotFoundError("webhook", webhook_id, "GET /v1/webhooks lists those that exist")
    return found
