"""The fenced moves of a webhook, like those of a rotor's cursor (`service.worker.lease`).

A worker takes a webhook under a fence and a lease, as others take a rotor, so that one worker at a
time sends to it and a slow receiver holds up nobody else. A webhook is taken when one of its
deliveries is due: pending, its pause over, and the first pending one of its rotor.
"""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy import ColumnElement, Engine, and_, exists, or_, select, update

from service.hooks import WebhookRecord
from service.store import hook_tables as t
from service.store.engine import now_s, transaction
from service.store.webhooks import webhook_of
from service.worker.clock import LONGEST_S, over, rested

w, d = t.webhook.c, t.delivery.c


@dataclass(frozen=True, slots=True)
class HookLease:
    """A claimed webhook, and the fence that the claim raised."""

    webhook: WebhookRecord
    fence: int
    owner: str


def due(longest_s: float = LONGEST_S) -> ColumnElement[bool]:
    """A delivery that may be sent now: pending, rested, and nothing of its rotor before it."""
    earlier = t.delivery.alias("earlier")
    first = ~exists().where(
        earlier.c.webhook_id == d.webhook_id,
        earlier.c.rotor_id == d.rotor_id,
        earlier.c.status == "pending",
        earlier.c.id < d.id,
    )
    return and_(d.status == "pending", rested(d.not_before, longest_s), first)


def holds(lease: HookLease) -> ColumnElement[bool]:
    """The fence: no one has claimed the webhook since, or made another one under its name."""
    same = w.fingerprint == lease.webhook.fingerprint
    return and_(w.id == lease.webhook.id, w.fence == lease.fence, same)


def claim_webhook(
    engine: Engine, owner: str, lease_s: float, longest_s: float = LONGEST_S
) -> HookLease | None:
    """Take the webhook that was served longest ago and has something to be sent; None: nothing."""
    free = or_(w.lease_until.is_(None), over(w.lease_until, lease_s))
    work = exists().where(d.webhook_id == w.id, due(longest_s))
    first = select(w.id).where(free, work).order_by(w.served_at.nulls_first(), w.id).limit(1)
    with transaction(engine, write=False) as connection:
        if connection.execute(first).scalar() is None:
            return None
    locked = first.with_for_update(skip_locked=True, key_share=True, of=t.webhook)
    with transaction(engine, write=True) as connection:
        webhook_id = connection.execute(locked).scalar()
        if webhook_id is None:
            return None
        take = update(t.webhook).where(w.id == webhook_id)
        take = take.values(fence=w.fence + 1, owner=owner, lease_until=now_s() + lease_s)
        row = connection.execute(take.returning(t.webhook)).mappings().one()
        return HookLease(webhook_of(row), row["fence"], owner)
