"""Residuals as they were computed last; nothing is computed in a request."""

from __future__ import annotations

from dataclasses import dataclass

from service.ports import Json, ResidualRecord, Store


@dataclass(frozen=True, slots=True)
class Residuals:
    """What is kept of a rotor's residuals, and the rows asked for.

    pending   the newest posterior is another one than they rest on
    items     those that pass the filter, after the cursor
    """

    record: ResidualRecord
    pending: bool
    items: list[Json]


def read_residuals(store: Store, rotor_id: str, after: int, limit: int, wanted: Json) -> Residuals:
    """The rows of a rotor's residuals by number, after one; `wanted`: blade, quantity, campaign."""
    with store.read() as tx:
        rotor = tx.records.rotor(rotor_id)
        record = tx.records.residuals(rotor_id)
    rows = [] if record.body is None else record.body["residuals"]
    asked = {name: value for name, value in wanted.items() if value is not None}
    found: list[Json] = []
    for number, row in enumerate(rows, 1):
        if number > after and all(row[name] == value for name, value in asked.items()):
            found.append(row | {"number": number})
            if len(found) == limit:
                break
    pending = rotor.dirty or record.version < rotor.version
    return Residuals(record, pending, found)
