"""What a rotor's versions are computed from beside its log, held against what it was called.

A rotor's digest was made from its row and the blades of its creation (`service.digests`). A blade
that joined or left later has an entry of the log, which has its digest and its place. The log
cannot make these rows again, so that nothing is to be computed where one of them is damaged.

What no digest covers has no witness: the version of the model, the `origin` and `created_at`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Literal

from sqlalchemy import Connection, select

from service.digests import as_created, digest_of_blade, digest_of_rotor
from service.entries import BLADES
from service.ports import BladeRecord, Event
from service.store import tables as t
from service.store.records import SqlRecords


def problems(
    connection: Connection, rotor_id: str, events: Sequence[Event] | None
) -> Iterator[tuple[Literal["rotor", "blade"], str, str]]:
    """What in a rotor's row and in those of its blades is not what was written: whose, and what.

    events   the rotor's log; None: it is damaged itself, and says nothing
    """
    row = connection.execute(select(t.rotor).where(t.rotor.c.id == rotor_id)).one()
    try:
        blades = SqlRecords(connection).blades(rotor_id)
        network = None if row.network is None else json.loads(row.network)
    except (ValueError, TypeError) as error:
        problem = f"its network, or what is known of a blade, is no JSON: {error}"
        yield "rotor", rotor_id, problem
        return
    asks = (row.particles, row.seed, network, row.adopt)
    made = digest_of_rotor(row.id, row.model_id, as_created(blades), *asks)
    if made != row.digest:
        whose = "its row and the blades of its creation have"
        problem = f"{whose} digest {made[:12]}…, written was {row.digest[:12]}…"
        yield "rotor", rotor_id, problem
    if events is None:
        return
    there = {blade.id: blade for blade in blades}
    moves = {(e.kind, e.blade or ""): e for e in events if e.kind in BLADES}
    for name in sorted(there.keys() | {blade for _, blade in moves}):
        differs = _differs(there.get(name), name, moves)
        if differs is not None:
            yield "blade", name, differs


def _differs(
    blade: BladeRecord | None, name: str, moves: Mapping[tuple[str, str], Event]
) -> str | None:
    joined, left = moves.get(("blade", name)), moves.get(("retirement", name))
    if blade is None:
        return "its row is missing, entries of the log name it"
    told = (0 if joined is None else joined.seq, None if left is None else left.seq)
    if (blade.added_seq, blade.retired_seq) != told:
        found = (blade.added_seq, blade.retired_seq)
        return f"added_seq and retired_seq are {found}, the log says {told}"
    if joined is not None and (made := digest_of_blade(blade)) != joined.digest:
        return f"its row has digest {made[:12]}…, entry {joined.seq} has {joined.digest[:12]}…"
    return None
