"""All that an update rests on beside the entries that are new to it, as one row.

A statement costs the worker as much as what it asks for, so that one which asks for five things at
once is a fifth of five; and what it finds is of one moment.
"""

from __future__ import annotations

from typing import NamedTuple

from sqlalchemy import Connection, bindparam, select

from service.adopted import KINDS
from service.ports import BladeRecord, RotorRecord
from service.store import tables as t
from service.store.cache import Compared
from service.store.creation import END, MOVED, count_of, sound
from service.store.gathered import Told
from service.store.records import BLADES, ROTOR, SqlRecords, found_of, rotor_of

# What every update asks, in one question and as of one moment: the rotor and its blades, where its
# log ends, how many entries moved a blade or changed the model; and two rows by their keys, whose
# names the worker remembers. By whether it is SQLite's.
_LAST = t.entry.alias("last")
_WHOLE = {
    sqlite: select(
        *ROTOR,
        BLADES[sqlite].label("blades"),
        END.label("end"),
        MOVED.label("moved"),
        count_of(KINDS).label("changes"),
        _LAST.c.event_id,
        _LAST.c.digest.label("entry_digest"),
        _LAST.c.received_at,
        t.state.c.digest.label("state_digest"),
    )
    .join(t.cursor)
    .outerjoin(_LAST, (_LAST.c.rotor_id == t.rotor.c.id) & (_LAST.c.seq == bindparam("seq")))
    .outerjoin(
        t.state,
        (t.state.c.rotor_id == t.rotor.c.id) & (t.state.c.version == bindparam("version")),
    )
    .where(t.rotor.c.id == bindparam("rotor"))
    for sqlite in (False, True)
}


class Whole(NamedTuple):
    """A rotor as one statement found it.

    changes   entries of its log that change its model
    last      what one entry is called by: its id, digest and time; None each: it is not there
    state     digest of one version; None: it is not there
    """

    rotor: RotorRecord
    blades: list[BladeRecord]
    changes: int
    last: tuple[str | None, str | None, float | None]
    state: str | None


def sound_rotor(
    connection: Connection, rotor_id: str, seq: int, version: int, compared: Compared | None = None
) -> Whole:
    """What an update rests on beside the entries that are new to it; DamagedRotorError as of
    `sound_blades`. The entry and the version that are named need not be there."""
    split = connection.dialect.name == "sqlite"
    asked = {"rotor": rotor_id, "seq": seq, "version": version}
    row = found_of(rotor_id, connection.execute(_WHOLE[split], asked))
    rotor = rotor_of(row[: len(ROTOR)])
    blades = SqlRecords(connection).blades_of(rotor_id, Told(row.blades, split))
    sound(connection, rotor, blades, (rotor.head_seq, row.end, row.moved), compared)
    last = (row.event_id, row.entry_digest, row.received_at)
    return Whole(rotor, blades, row.changes, last, row.state_digest)
