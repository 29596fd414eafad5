"""Residuals as they were computed last; nothing is computed in a request."""

from __future__ import annotations

from dataclasses import dataclass
from heapq import nsmallest

from service.ports import Json, ResidualRecord, Store


@dataclass(frozen=True, slots=True)
class Residuals:
    """What is kept of a rotor's residuals, and the rows asked for.

    pending   the newest posterior is another one than they rest on, or will be; not of a rotor
              without any entry, which has none to be computed
    items     those that pass the filter, after the place
    """

    record: ResidualRecord
    pending: bool
    items: list[Json]


Place = tuple[float, str, int]


def place_of(row: Json) -> Place:
    """Where a row stands among all: by the rotor's hour, the reading and its part.

    It is the reading's own, so that pages go on from where they were though residuals were computed
    anew between them, with readings that came late.
    """
    return row["rotor_h"], row["inspection"], row["part"]


def read_residuals(
    store: Store, rotor_id: str, after: Place | None, limit: int, wanted: Json
) -> Residuals:
    """Rows of a rotor's residuals in order, after a place; `wanted`: blade, quantity, campaign."""
    with store.read() as tx:
        rotor = tx.records.rotor(rotor_id)
        record = tx.records.residuals(rotor_id)
    rows = [] if record.body is None else record.body["residuals"]
    asked = {name: value for name, value in wanted.items() if value is not None}
    found = [row for row in rows if all(row[name] == value for name, value in asked.items())]
    if after is not None:
        found = [row for row in found if place_of(row) > after]
    found = nsmallest(limit, found, key=place_of)
    pending = rotor.head_seq > 0 and (rotor.dirty or record.version < rotor.version)
    return Residuals(record, pending, found)
