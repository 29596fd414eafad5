"""Webhooks and deliveries as rows.

Order: a rotor's deliveries are numbered in the order of its commits, because they are written while
its row is locked. Only the first pending one of a webhook and rotor (its head) may be sent.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import ColumnElement, Connection, RowMapping, delete, func, insert, select, update
from sqlalchemy.exc import IntegrityError

from service.hooks import GAP, DeliveryRecord, WebhookRecord, kind_of
from service.store import hook_tables as t
from service.store.engine import now_s
from service.store.untold import bound, count_untold, message, written

w, d, u = t.webhook.c, t.delivery.c, t.untold.c
# A webhook that is being deleted is waited for: no delivery may outlive it.
_ALL = select(w.id, w.events, w.rotors).order_by(w.id).with_for_update(read=True, key_share=True)


def tell(connection: Connection, rotor_id: str, note: str, payload: dict[str, Any]) -> None:
    """A delivery for each webhook that asks for this event of this rotor, in the caller's
    transaction."""
    kind = kind_of(note, payload)
    if kind is None:
        return
    rows = connection.execute(_ALL).all()
    asked = [row.id for row in rows if kind in json.loads(row.events) and _knows(row, rotor_id)]
    if not asked:
        return
    data = {"rotor": rotor_id} | {k: v for k, v in payload.items() if k != "sealed"}
    shared = {"rotor_id": rotor_id, "event": kind, "body": written(kind, data)}
    shared |= {"status": "pending"}
    for webhook_id in asked:
        row = shared | {"message_id": message(), "webhook_id": webhook_id}
        connection.execute(insert(t.delivery).values(**row, attempts=0, created_at=now_s()))
        bound(connection, webhook_id, rotor_id)


def _knows(row: Any, rotor_id: str) -> bool:
    return row.rotors is None or rotor_id in json.loads(row.rotors)


class SqlWebhooks:
    """The `Webhooks` of one transaction."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def put(self, webhook: WebhookRecord) -> WebhookRecord | None:
        there = self.find(webhook.id)
        if there is not None:
            return there
        values: dict[str, Any] = {
            "id": webhook.id,
            "url": webhook.url,
            "events": json.dumps(webhook.events),
            "rotors": None if webhook.rotors is None else json.dumps(webhook.rotors),
            "salt": webhook.salt,
            "fingerprint": webhook.fingerprint,
        }
        try:
            with self._connection.begin_nested():
                row = insert(t.webhook).values(**values, created_at=now_s(), fence=0)
                self._connection.execute(row)
        except IntegrityError:
            return self.find(webhook.id)
        return None

    def find(self, webhook_id: str) -> WebhookRecord | None:
        row = self._connection.execute(select(t.webhook).where(w.id == webhook_id))
        found = row.mappings().one_or_none()
        return None if found is None else webhook_of(found)

    def page(self, after: str, limit: int) -> list[WebhookRecord]:
        query = select(t.webhook).where(w.id > after).order_by(w.id).limit(limit)
        return [webhook_of(row) for row in self._connection.execute(query).mappings()]

    def counts(self, ids: Sequence[str]) -> dict[str, dict[str, int]]:
        query = select(d.webhook_id, d.status, func.count()).where(d.webhook_id.in_(ids))
        found: dict[str, dict[str, int]] = {one: {} for one in ids}
        for webhook_id, status, number in self._connection.execute(
            query.group_by(d.webhook_id, d.status)
        ):
            found[webhook_id][status] = number
        lost = select(u.webhook_id, func.sum(u.count)).where(u.webhook_id.in_(ids))
        for webhook_id, number in self._connection.execute(lost.group_by(u.webhook_id)):
            found[webhook_id]["dropped"] = int(number)
        return found

    def delete(self, webhook_id: str) -> bool:
        own = select(w.id).where(w.id == webhook_id).with_for_update()
        if self._connection.execute(own).first() is None:
            return False
        self._connection.execute(delete(t.delivery).where(d.webhook_id == webhook_id))
        self._connection.execute(delete(t.untold).where(u.webhook_id == webhook_id))
        self._connection.execute(delete(t.webhook).where(w.id == webhook_id))
        return True

    def deliveries(
        self, webhook_id: str, status: str | None, before: int | None, limit: int
    ) -> list[DeliveryRecord]:
        query = select(t.delivery).where(d.webhook_id == webhook_id)
        if status is not None:
            query = query.where(d.status == status)
        if before is not None:
            query = query.where(d.id < before)
        rows = self._connection.execute(query.order_by(d.id.desc()).limit(limit))
        return [delivery_of(row) for row in rows.mappings()]

    def delivery(self, webhook_id: str, message_id: str) -> DeliveryRecord | None:
        query = select(t.delivery).where(d.webhook_id == webhook_id, d.message_id == message_id)
        row = self._connection.execute(query).mappings().one_or_none()
        return None if row is None else delivery_of(row)

    def revive(self, webhook_id: str, message_id: str) -> None:
        dead: ColumnElement[bool] = (
            (d.webhook_id == webhook_id) & (d.message_id == message_id) & (d.status == "dead")
        )
        again = update(t.delivery).where(dead)
        self._connection.execute(again.values(status="pending", attempts=0, not_before=None))


def webhook_of(row: RowMapping) -> WebhookRecord:
    """A row as a record."""
    rotors = row["rotors"]
    return WebhookRecord(
        id=row["id"],
        url=row["url"],
        events=tuple(json.loads(row["events"])),
        rotors=None if rotors is None else tuple(json.loads(rotors)),
        salt=row["salt"],
        fingerprint=row["fingerprint"],
        created_at=row["created_at"],
    )


def delivery_of(row: RowMapping) -> DeliveryRecord:
    """A row as a record."""
    values = dict(row)
    return DeliveryRecord(number=values.pop("id"), **values)


def prune(connection: Connection, webhook_id: str, kept: Mapping[str, int]) -> None:
    """Keep the newest of a webhook's deliveries of each status named; count dead ones that go.

    How many may wait is another matter (`service.store.untold`).
    """
    own_row = select(w.id).where(w.id == webhook_id).with_for_update(read=True, key_share=True)
    if connection.execute(own_row).first() is None:
        return
    for status, count in kept.items():
        own = (d.webhook_id == webhook_id) & (d.status == status)
        last = select(d.id).where(own).order_by(d.id.desc()).offset(count).limit(1)
        number = connection.execute(last).scalar()
        if number is not None:
            if status == "dead":
                count_untold(connection, webhook_id, own & (d.id <= number) & (d.event != GAP))
            connection.execute(delete(t.delivery).where(own, d.id <= number))
