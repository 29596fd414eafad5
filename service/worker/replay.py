"""A rotor's posterior computed again from the log alone, and compared with what is stored.

A sealed posterior is a function of the readings, the seed and the algorithm, so the log gives it
again bit for bit, on the same release and kind of machine, with no state before it. `from_log` does
that; `replay` compares every digest with the newest sealed version's. What differs is mended by
`service.worker.rebuild`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from sqlalchemy import Row, select

from core.digest import state_digest
from core.errors import ModelError
from core.log import effective
from service.adopted import adopted_at
from service.entries import entries_of
from service.errors import DamagedError, GoneError, NotFoundError
from service.ports import Json, RotorState, Science
from service.store import tables as t
from service.store.encoding import Encoded, decode, encode
from service.store.engine import snapshot
from service.store.entries import read_entries
from service.store.kept import stored
from service.store.named import digests
from service.store.unit_of_work import SqlStore
from service.worker.task import spec_of


@dataclass(frozen=True, slots=True)
class Replayed:
    """A sealed posterior from the log through one entry."""

    through_seq: int
    meta: Json
    arrays: Mapping[str, Encoded]

    @property
    def sha256(self) -> dict[str, str]:
        return {name: one.sha256 for name, one in self.arrays.items()}

    @property
    def digest(self) -> str:
        return state_digest(self.meta, self.sha256)


def from_log(store: SqlStore, science: Science, rotor_id: str, through: int) -> Replayed:
    """The sealed posterior that rests on the entries up to `through`; no stored state is read.

    DamagedRotorError: the rotor's row, or a blade's, is not what was written.
    """
    with store.read() as tx:
        rotor = tx.records.rotor(rotor_id)
        spec = spec_of(tx, rotor, through)
        card = tx.records.model(rotor.model_id, rotor.model_version)
        events = read_entries(tx.connection, rotor_id, 0, through)
        network = adopted_at(tx, rotor, through).network
    readings = effective(entries_of(events))
    varied = science.vary(card, network)
    state: RotorState = science.update(varied, spec, readings, None, quick=False)
    arrays = {name: encode(array) for name, array in state.arrays.items()}
    return Replayed(through, dict(state.meta), arrays)


def replay(store: SqlStore, science: Science, rotor_id: str) -> Json:
    """The newest sealed version beside what the log gives: every digest of both, and ``same``.

    Where no sealed version is kept, what the log gives through the cursor, and ``same`` is None.
    """
    with snapshot(store.engine) as connection:
        rows = connection.execute(stored(rotor_id).order_by(t.state.c.version.desc())).all()
        row = next((row for row in rows if row.sealed), None)
        names = {} if row is None else digests(connection, rotor_id, row.version)
        cursor = select(t.cursor.c.applied_seq).where(t.cursor.c.rotor_id == rotor_id)
        applied = connection.execute(cursor).scalar()
    if applied is None:
        raise NotFoundError("rotor", rotor_id, "GET /v1/rotors lists those that exist")
    through = applied if row is None or row.version == row.newest else row.through_seq
    made = from_log(store, science, rotor_id, through)
    told: Json = {
        "rotor": rotor_id,
        "version": row and row.version,
        "newest_version": rows[0].version if rows else None,
        "through_seq": made.through_seq,
        "algorithm_version": made.meta["algorithm_version"],
        "stored": row and _digests_of(row.events_digest, row.digest, names),
        "replayed": _digests_of(made.meta["events_digest"], made.digest, made.sha256),
        "same": None,
        "differ": [],
    }
    if row is not None:
        differ = sorted(n for n in names.keys() | made.arrays if names.get(n) != made.sha256.get(n))
        told["differ"] = [_difference(store, row, name, made) for name in differ]
        told["same"] = told["stored"] == told["replayed"]
        told["stored_algorithm_version"] = row.algorithm_version
    return told


def _digests_of(events: str, state: str, arrays: Mapping[str, str]) -> Json:
    return {"events_digest": events, "state_digest": state, "arrays": dict(sorted(arrays.items()))}


def _difference(store: SqlStore, row: Row[Any], name: str, made: Replayed) -> Json:
    """How far an array is from the replayed one; None where the two cannot be compared."""
    largest = None
    if name in made.arrays:
        with store.read() as tx:
            try:
                found = tx.states.array((row.rotor_id, row.version, name))
                again = decode(name, made.arrays[name])
                if found.shape == again.shape:
                    largest = float(np.max(np.abs(found - again), initial=0.0))
            except (DamagedError, GoneError, ModelError):
                pass
    return {"array": name, "largest_difference": largest}
