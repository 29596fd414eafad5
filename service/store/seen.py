"""A rotor as a read begins with it, in one statement.

Every read of the newest version needs the rotor's row, its cursor, that version, the blades or one
of them, and of the log what tells whether these are what was written, and whether it changes the
model. Each by itself takes a message and an answer, and more of the interpreter than of the
database; and on PostgreSQL another one's commit may come in between.

Of the versions it is the greatest: one beyond the cursor is damage, and has to be met.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

from sqlalchemy import ColumnElement, Connection, Select, bindparam, func, select

from service.adopted import KINDS
from service.ports import RotorRecord, Seen
from service.store import creation
from service.store import tables as t
from service.store.cache import Sound
from service.store.gathered import Told
from service.store.records import BLADE, BLADES, ROTOR, SqlRecords, blade_of, found_of, rotor_of
from service.store.states import SqlStates

_versions = t.state.alias("versions")
STATE = t.state.c.keys()
_ROWS = len(ROTOR), len(ROTOR) + len(STATE)
_OWN = t.rotor.c.id == bindparam("rotor")
_LAST = select(func.max(_versions.c.version)).where(_versions.c.rotor_id == bindparam("rotor"))
_CHANGES = creation.count_of(KINDS)


def _asked(*more: ColumnElement[Any]) -> Select[Any]:
    """Rotor, newest version, how many entries change the model, and more."""
    last = (t.state.c.rotor_id == t.rotor.c.id) & (t.state.c.version == _LAST.scalar_subquery())
    columns = (*ROTOR, *t.state.c, _CHANGES, creation.MOVED, *more)
    return select(*columns).select_from(t.rotor).join(t.cursor).outerjoin(t.state, last).where(_OWN)


_BLADE = _asked(*BLADE).outerjoin(
    t.blade, (t.blade.c.rotor_id == t.rotor.c.id) & (t.blade.c.id == bindparam("blade"))
)
_WHOLE = {split: _asked(creation.END, told) for split, told in BLADES.items()}


class Looks:
    """What one transaction sees of rotors; `sound`: what its process has compared before."""

    def __init__(
        self, connection: Connection, records: SqlRecords, states: SqlStates, sound: Sound
    ) -> None:
        self._connection = connection
        self._records = records
        self._states = states
        self._sound = sound

    def whole(self, rotor_id: str) -> Seen:
        """The rotor with all of its blades."""
        split = self._connection.dialect.name == "sqlite"
        rotor, state, changes, (moved, end, text) = self._row(_WHOLE[split], {"rotor": rotor_id})
        blades = self._records.blades_of(rotor_id, Told(text, split))
        ends = (rotor.head_seq, end, moved)
        return Seen(
            rotor,
            tuple(blades),
            changes,
            lambda: self._states.given(rotor_id, state, rotor.version),
            lambda: creation.check(self._connection, rotor, blades, self._sound, ends),
        )

    def with_blade(self, rotor_id: str, name: str | None) -> Seen:
        """The rotor with one of its blades, if it has it."""
        asked = {"rotor": rotor_id, "blade": name}
        rotor, state, changes, (moved, *values) = self._row(_BLADE, asked)
        found = None if values[0] is None else blade_of(rotor_id, tuple(values))
        return Seen(
            rotor,
            () if found is None else (found,),
            changes,
            lambda: self._states.given(rotor_id, state),
            lambda: creation.check_one(self._connection, rotor, name, found, self._sound, moved),
        )

    def _row(
        self, query: Select[Any], asked: Mapping[str, str | None]
    ) -> tuple[RotorRecord, SimpleNamespace, int, Sequence[Any]]:
        """Rotor, newest version as `service.store.kept.stored` has it, entries that change the
        model, and the rest."""
        row = found_of(str(asked["rotor"]), self._connection.execute(query, asked))
        own, last = _ROWS
        rotor = rotor_of(row[:own])
        stands = {"newest": rotor.version, "applied_seq": rotor.applied_seq}
        state = SimpleNamespace(**dict(zip(STATE, row[own:last], strict=True)), **stands)
        return rotor, state, row[last], row[last + 1 :]
