"""The tables against what was acknowledged: lost, applied twice, out of order, or computed wrongly.

Entry n of a rotor is applied once if the versions' ends never go back, each provisional version was
computed from the version before it, and each version, sealed or not, is what the science makes of
the entries up to its end, each taken once. All three are looked at for every version there ever was
(nothing is thinned in these studies).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from sqlalchemy import Row, select

from core.digest import array_digest, state_digest
from core.log import effective
from core.observation import Inspection
from service.entries import entries_of
from service.ports import Event, Json, ModelCard, RotorSpec, Science
from service.store import tables as t
from service.store.engine import snapshot
from service.store.entries import read_entries
from service.store.unit_of_work import SqlStore, SqlTransaction
from service.studies.chaos.twin import Descent
from service.worker.task import spec_of


@dataclass(frozen=True, slots=True)
class Version:
    """A stored version, the one before it, and what it is to rest on."""

    store: SqlStore
    card: ModelCard
    spec: RotorSpec
    readings: Sequence[Inspection]
    before: Row[Any] | None
    row: Row[Any]


Again = Callable[[Version], str]  # the digest that the version has when it is made once more


@dataclass
class Findings:
    """Names of entries and versions, by what is wrong with them; all empty: nothing is."""

    lost: list[str] = field(default_factory=list)
    twice: list[str] = field(default_factory=list)
    strangers: list[str] = field(default_factory=list)
    misnumbered: list[str] = field(default_factory=list)
    wrong_versions: list[str] = field(default_factory=list)
    unfinished: list[str] = field(default_factory=list)
    digests: dict[str, str] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)

    @property
    def faults(self) -> dict[str, list[str]]:
        return {k: v for k, v in asdict(self).items() if isinstance(v, list) and v}

    def to_json(self) -> Json:
        """How many of each; the first few names where there are any."""
        told = {k: len(v) for k, v in asdict(self).items() if isinstance(v, list)}
        return told | {"examples": {k: v[:5] for k, v in self.faults.items()}, **self.counts}


def by_twin(version: Version) -> str:
    """The digest that the studies' exact twin gives, from the readings alone."""
    quick, row = not version.row.sealed, version.row
    made = Descent(provisional=True).update(
        version.card, version.spec, version.readings, None, quick=quick
    )
    meta = dict(made.meta)
    if quick:
        meta["parent"] = json.loads(row.meta).get("parent")
    return type(made)(meta, made.arrays).digest


def by_physics(science: Science) -> Again:
    """The same with the blade physics: a sealed version from the readings alone, a provisional one
    from the stored version before it, so that each was made from that one and no other."""

    def again(version: Version) -> str:
        before = version.before
        previous = None
        if before is not None and not version.row.sealed:
            get = version.store.arrays(before.rotor_id, before.version)
            previous = science.restore(json.loads(before.meta), get)
        made = science.update(
            version.card,
            version.spec,
            version.readings,
            previous,
            quick=not version.row.sealed,
        )
        return state_digest(made.meta, {n: array_digest(made.arrays[n]) for n in made.arrays})

    return again


def check(
    store: SqlStore, acknowledged: Mapping[tuple[str, str], int], *, again: Again | None = by_twin
) -> Findings:
    """Hold a database at rest against the acknowledged entries.

    again   makes every version once more; None: only the order of the versions is looked at
    """
    found = Findings()
    with store.read() as tx:
        rotors = tx.connection.execute(select(t.rotor.c.id).order_by(t.rotor.c.id)).scalars().all()
        cursor = tx.connection.execute(select(t.cursor.c.takeovers, t.cursor.c.seals)).all()
    found.counts = {
        "entries": 0,
        "versions": 0,
        "takeovers": sum(row.takeovers for row in cursor),
        "sealed_versions": sum(row.seals for row in cursor),
    }
    for rotor in rotors:
        own = {entry: seq for (r, entry), seq in acknowledged.items() if r == rotor}
        with snapshot(store.engine) as connection:
            tx = SqlTransaction(connection, store.cache, store.checked, store.sound)
            _check_rotor(store, tx, rotor, own, found, again)
    return found


def _check_rotor(
    store: SqlStore,
    tx: SqlTransaction,
    rotor: str,
    own: Mapping[str, int],
    found: Findings,
    again: Again | None,
) -> None:
    record = tx.records.rotor(rotor)
    events = read_entries(tx.connection, rotor, 0, 2**62)
    query = select(t.state).where(t.state.c.rotor_id == rotor).order_by(t.state.c.version)
    versions = tx.connection.execute(query).all()
    found.counts["entries"] += len(events)
    found.counts["versions"] += len(versions)
    _check_log(rotor, record.head_seq, events, own, found)
    notes = select(t.outbox.c.payload).where(
        t.outbox.c.rotor_id == rotor, t.outbox.c.kind == "applied"
    )
    told = sorted(json.loads(p)["version"] for p in tx.connection.execute(notes).scalars())
    numbers = [row.version for row in versions]
    if numbers != list(range(1, record.version + 1)) or told != numbers:
        found.wrong_versions.append(f"{rotor}: {len(numbers)} versions, {len(told)} notes")
    last = versions[-1] if versions else None
    if last is None or (record.applied_seq, last.through_seq) != (record.head_seq,) * 2:
        found.unfinished.append(f"{rotor}: applied {record.applied_seq} of {record.head_seq}")
    elif not last.sealed:
        found.unfinished.append(f"{rotor}: version {last.version} is not sealed")
    else:
        found.digests[rotor] = last.digest
    before: Row[Any] | None = None
    for row in versions:
        wrong = _wrong(before, row)
        if wrong is None and again is not None:
            wrong = _differs(again, store, tx, events, before, row)
        if wrong:
            found.wrong_versions.append(f"{rotor} version {row.version}: {wrong}")
        before = row


def _check_log(
    rotor: str, head: int, events: list[Event], own: Mapping[str, int], found: Findings
) -> None:
    seqs = [e.seq for e in events]
    if seqs != list(range(1, head + 1)):
        found.misnumbered.append(f"{rotor}: {len(seqs)} entries, head {head}")
    places: dict[str, list[int]] = {}
    for event in events:
        places.setdefault(event.event_id, []).append(event.seq)
    found.lost += [f"{rotor}/{name}" for name in own if name not in places]
    found.twice += [f"{rotor}/{name}" for name, seqs in places.items() if len(seqs) > 1]
    found.strangers += [f"{rotor}/{name}" for name in places if name not in own]
    found.misnumbered += [
        f"{rotor}/{name}: acknowledged as {seq}, stored as {places[name]}"
        for name, seq in own.items()
        if name in places and places[name] != [seq]
    ]


def _wrong(before: Row[Any] | None, row: Row[Any]) -> str | None:
    """What is wrong with a version beside the one before it."""
    if before is not None and row.through_seq < before.through_seq:
        return f"goes back from entry {before.through_seq} to {row.through_seq}"
    parent = json.loads(row.meta).get("parent", "")
    if parent != "" and parent != (None if before is None else before.digest):
        return "was computed from another version than the one before it"
    return None


def _differs(
    again: Again,
    store: SqlStore,
    tx: SqlTransaction,
    events: list[Event],
    before: Row[Any] | None,
    row: Row[Any],
) -> str | None:
    """The version made again from the log through its end, each entry taken once."""
    record = tx.records.rotor(row.rotor_id)
    card = tx.records.model(record.model_id, record.model_version)
    readings = effective(entries_of(events[: row.through_seq]))
    spec = spec_of(tx, record, row.through_seq)
    if again(Version(store, card, spec, readings, before, row)) != row.digest:
        return f"is not what entries 1 … {row.through_seq} give"
    return None
