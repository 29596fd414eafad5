"""API keys, by id; their secrets are not here."""

from __future__ import annotations

import json
from typing import Any

from sqlalchemy import Connection, RowMapping, insert, select, update

from service.access import KeyRecord
from service.store import access_tables as t
from service.store.engine import now_s


class SqlKeys:
    """The `Keys` of one transaction. The moment beside a key is the database's, as expiry is."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def put(self, key: KeyRecord, lifetime_s: float | None) -> KeyRecord:
        """Write a new key that expires `lifetime_s` from now, or never; as it is stored."""
        values: dict[str, Any] = {
            "id": key.id,
            "name": key.name,
            "digest": key.digest,
            "scopes": json.dumps(key.scopes),
            "rotors": None if key.rotors is None else json.dumps(key.rotors),
            "created_at": now_s(),
            "expires_at": None if lifetime_s is None else now_s() + lifetime_s,
        }
        self._connection.execute(insert(t.api_key).values(**values))
        found = self.find(key.id)
        assert found is not None
        return found[0]

    def find(self, key_id: str) -> tuple[KeyRecord, float] | None:
        """The key and the present moment; None: no such key."""
        query = select(t.api_key, now_s().label("now")).where(t.api_key.c.id == key_id)
        row = self._connection.execute(query).mappings().one_or_none()
        return None if row is None else (_key(row), row["now"])

    def all(self) -> tuple[list[KeyRecord], float]:
        """All keys, the oldest first, and the present moment."""
        query = select(t.api_key).order_by(t.api_key.c.created_at, t.api_key.c.id)
        rows = self._connection.execute(query).mappings()
        keys = [_key(row) for row in rows]
        return keys, float(self._connection.execute(select(now_s())).scalar_one())

    def revoke(self, key_id: str) -> bool:
        """From now on the key is not accepted; whether it was not revoked before."""
        unrevoked = (t.api_key.c.id == key_id) & t.api_key.c.revoked_at.is_(None)
        statement = update(t.api_key).where(unrevoked).values(revoked_at=now_s())
        return self._connection.execute(statement).rowcount == 1


def _key(row: RowMapping) -> KeyRecord:
    rotors = row["rotors"]
    return KeyRecord(
        id=row["id"],
        name=row["name"],
        digest=row["digest"],
        scopes=tuple(json.loads(row["scopes"])),
        rotors=None if rotors is None else tuple(json.loads(rotors)),
        created_at=row["created_at"],
        expires_at=row["expires_at"],
        revoked_at=row["revoked_at"],
    )
