"""An alarm: a sealed version that is not to be trusted, where the one before was."""

from __future__ import annotations

import json

from sqlalchemy import Connection, select, true

from service.ports import StateRecord
from service.store import tables as t
from service.store.outbox import post


def alarm(connection: Connection, record: StateRecord) -> None:
    """A note where a sealed version is not to be trusted and the sealed one before was, or said
    something else; before the version is written. Provisional ones come and go."""
    found = record.meta["health"]
    status = found.get("status", "ok")
    if not record.sealed or status == "ok":
        return
    s = t.state.c
    query = select(s.meta).where(s.rotor_id == record.rotor_id, s.sealed == true())
    before = connection.execute(query.order_by(s.version.desc()).limit(1)).scalar()
    if before is not None and json.loads(before)["health"].get("status") == status:
        return
    told = {"version": record.version, "through_seq": record.through_seq, "health": status}
    post(connection, record.rotor_id, "alarm", told | {"reasons": found.get("reasons", [])})
