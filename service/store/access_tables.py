"""The tables of who calls: keys, what was done with them, and first answers.

`api_key` holds a key's digest, never the key. `audit` has a row for each state-changing request and
is never thinned; `first_answer` holds what requests with an Idempotency-Key were answered, until it
expires. Times are seconds since 1970 (UTC) by the database's clock, as of all tables.
"""

from __future__ import annotations

from sqlalchemy import (
    Column,
    Double,
    Index,
    Integer,
    LargeBinary,
    String,
    Table,
    Text,
)

from service.store.schema import BIG, NAME, metadata

api_key = Table(
    "api_key",
    metadata,
    Column("id", String(40), primary_key=True),
    Column("name", NAME, nullable=False),
    Column("digest", String(64), nullable=False),
    Column("scopes", Text, nullable=False),
    Column("rotors", Text),
    Column("created_at", Double, nullable=False),
    Column("expires_at", Double),
    Column("revoked_at", Double),
)

audit = Table(
    "audit",
    metadata,
    Column("id", BIG, primary_key=True, autoincrement=True),
    Column("at", Double, nullable=False),
    Column("key_id", String(40)),
    Column("who", NAME, nullable=False),
    Column("address", NAME),
    Column("request_id", NAME, nullable=False),
    Column("what", NAME, nullable=False),
    Column("path", Text, nullable=False),
    Column("rotor_id", NAME),
    Column("first_seq", BIG),
    Column("last_seq", BIG),
    Column("status", Integer, nullable=False),
    Column("problem", String(60)),
    Index("ix_audit_rotor_id_id", "rotor_id", "id"),
    Index("ix_audit_key_id_id", "key_id", "id"),
)

first_answer = Table(
    "first_answer",
    metadata,
    Column("owner", String(40), primary_key=True),
    Column("key", String(64), primary_key=True),
    Column("fingerprint", String(64), nullable=False),
    Column("status", Integer),
    Column("headers", Text),
    Column("body", LargeBinary),
    Column("begun_at", Double, nullable=False),
    Column("expires_at", Double, nullable=False),
    Index("ix_first_answer_expires_at", "expires_at"),
)
