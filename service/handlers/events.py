"""What happened to a rotor, from a note on: hints, after which a client reads what it needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from service.ports import Note, RotorRecord, Store

PAGE = 100


@dataclass(frozen=True, slots=True)
class News:
    """Notes after the one that a client knows, in order.

    reset   notes between them are no longer kept, or the one known is of another database: the
            client has to read the rotor again and goes on from `number`
    """

    rotor: RotorRecord
    notes: tuple[Note, ...]
    reset: bool
    number: int


def news(store: Store, rotor_id: str, after: int | None) -> News:
    """The notes after `after`; None: the newest one, as a start.

    The notes are read before it is asked which are missing, so that none can be dropped unseen in
    between.
    """
    with store.read() as tx:
        rotor = tx.records.rotor(rotor_id)
        newest = tx.outbox.newest([rotor_id]).get(rotor_id, 0)
        begin = max(0, newest - 1) if after is None else after
        notes = tx.outbox.after(rotor_id, begin, PAGE)
        if after is not None and tx.outbox.missing(rotor_id, after):
            return News(rotor, (), True, newest)
    return News(rotor, tuple(notes), False, notes[-1].id if notes else begin)


def newest_notes(store: Store, rotor_ids: Sequence[str]) -> dict[str, int]:
    """The number of each rotor's newest note, in one query."""
    with store.read() as tx:
        return tx.outbox.newest(rotor_ids)
