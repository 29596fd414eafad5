"""The tables of who is told: webhooks, and what is to be sent to them.

`webhook` is served by one worker at a time, under fence and lease like a rotor; `delivery` has a
row for each event that it is to be told, written in the transaction in which that happens.
`untold` counts, for each webhook and rotor, deliveries that are not sent any more: dropped where
too many waited, or dead and no longer kept.
"""

from __future__ import annotations

from sqlalchemy import (
    Column,
    Double,
    ForeignKey,
    Index,
    Integer,
    String,
    Table,
    Text,
    UniqueConstraint,
)

from service.store.schema import BIG, NAME, metadata

webhook = Table(
    "webhook",
    metadata,
    Column("id", NAME, primary_key=True),
    Column("url", Text, nullable=False),
    Column("events", Text, nullable=False),
    Column("rotors", Text),
    Column("salt", String(64), nullable=False),
    Column("fingerprint", String(64), nullable=False),
    Column("created_at", Double, nullable=False),
    Column("fence", BIG, nullable=False),
    Column("owner", NAME),
    Column("lease_until", Double),
    Column("served_at", Double),
)

delivery = Table(
    "delivery",
    metadata,
    Column("id", BIG, primary_key=True, autoincrement=True),
    Column("message_id", String(60), nullable=False),
    Column("webhook_id", NAME, ForeignKey("webhook.id"), nullable=False),
    Column("rotor_id", NAME, nullable=False),
    Column("event", String(20), nullable=False),
    Column("body", Text, nullable=False),
    Column("status", String(20), nullable=False),
    Column("attempts", Integer, nullable=False),
    Column("created_at", Double, nullable=False),
    Column("not_before", Double),
    Column("tried_at", Double),
    Column("last_error", Text),
    UniqueConstraint("message_id"),
    Index("ix_delivery_heads", "webhook_id", "status", "rotor_id", "id"),
    Index("ix_delivery_webhook_id_id", "webhook_id", "id"),
)

untold = Table(
    "untold",
    metadata,
    Column("webhook_id", NAME, ForeignKey("webhook.id"), primary_key=True),
    Column("rotor_id", NAME, primary_key=True),
    Column("count", BIG, nullable=False),
    Column("first_at", Double, nullable=False),
    Column("last_at", Double, nullable=False),
)
