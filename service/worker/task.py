"""What one update rests on: the rotor, its entries, and the state before them.

The worker remembers the last states that it wrote (`memory`). One is used only while its version
is the one that the claim read, so that another worker's commit in between makes this one read the
database. The log only grows: entries that are known already are not read again, once it was seen
that the last of them is still the same one.

A state that turns out damaged when it is loaded is left alone: the next version is computed from
the log without it, and every array is written anew. Nothing is computed from a rotor whose row, or
a blade's, is not what was written (`service.store.creation`): the log cannot make these again.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

from service.adopted import adopted_at
from service.entries import entries_of
from service.errors import DamagedError
from service.ports import BladeRecord, ModelCard, RotorRecord, RotorSpec, Science
from service.store.entries import read_entries
from service.store.named import digests
from service.store.unit_of_work import SqlStore, SqlTransaction
from service.store.whole import Whole
from service.worker.lease import Lease
from service.worker.memory import NO_VERSION, Mark, Memory, mark
from service.worker.packing import PackedLog

log = logging.getLogger("bladetwin.worker")


@dataclass(frozen=True, slots=True)
class Task:
    """Everything that one update rests on."""

    card: ModelCard
    spec: RotorSpec
    through: int
    log: PackedLog
    pending: int
    memory: Memory
    last: Mark | None


def spec_of(tx: SqlTransaction, rotor: RotorRecord, through: int) -> RotorSpec:
    """The rotor as an update through entry `through` sees it; DamagedRotorError: nothing is to be
    computed from it. It goes before the model is looked for, which the rotor's row names."""
    return _spec(rotor, tx.sound_blades(rotor), through)


def _spec(rotor: RotorRecord, sound: Sequence[BladeRecord], through: int) -> RotorSpec:
    blades = [b for b in sound if b.added_seq <= through]
    known = {b.id: b.known for b in blades if b.known is not None}
    name = rotor.origin or rotor.id
    return RotorSpec(name, tuple(b.id for b in blades), rotor.particles, rotor.seed, known)


def read(store: SqlStore, science: Science, lease: Lease, memory: Memory | None) -> Task:
    """The rotor, its entries up to the head, and the state before them."""
    with store.read() as tx:
        ends = (0, 0) if memory is None else (memory.through, memory.version)
        found = tx.sound_rotor(lease.rotor_id, *ends)
        rotor = found.rotor
        through = lease.applied_seq if lease.sealing else rotor.head_seq
        spec = _spec(rotor, found.blades, through)
        card = tx.records.model(rotor.model_id, rotor.model_version)
        if memory is not None and not same_history(found, lease, memory):
            log.warning("rotor %s: the log went another way than this worker saw", rotor.id)
            memory = None
        if memory is None or (memory.version, memory.through) != (
            lease.version,
            lease.applied_seq,
        ):
            memory = _restored(store, science, tx, lease, memory)
        fresh = read_entries(tx.connection, rotor.id, memory.through, through)
        network = adopted_at(tx, rotor, through).network if found.changes else rotor.network
    readings = entries_of(fresh)
    return Task(
        card=science.vary(card, network),
        spec=spec,
        through=through,
        log=memory.log.extended(readings),
        pending=len(readings),
        memory=memory,
        last=mark(fresh, memory.last),
    )


def same_history(found: Whole, lease: Lease, memory: Memory) -> bool:
    """The database has the entry with which the memory ends; the version, too, if it is used."""
    if memory.through and found.last != memory.last:
        return False
    return memory.version != lease.version or found.state == memory.digest


def _restored(
    store: SqlStore, science: Science, tx: SqlTransaction, lease: Lease, stale: Memory | None
) -> Memory:
    """The state that the claim read, and the entries before it."""
    if stale is None or stale.through > lease.applied_seq:
        stale = Memory(NO_VERSION, 0, None, {})
    events = read_entries(tx.connection, lease.rotor_id, stale.through, lease.applied_seq)
    known, last = stale.log.extended(entries_of(events)), mark(events, stale.last)
    if lease.version == 0:
        return Memory(0, 0, None, {}, log=known)
    memory = Memory(
        lease.version,
        lease.applied_seq,
        None,
        {},
        anew=True,
        last=last,
        log=known,
    )
    try:
        record = tx.states.get(lease.rotor_id, lease.version)
        memory.sha256 = dict(tx.states.names(lease.rotor_id, lease.version))
        tx.states.prefetch(lease.rotor_id, lease.version)
        arrays = store.arrays(lease.rotor_id, lease.version)
        memory.state, memory.anew = science.restore(record.meta, arrays), False
    except DamagedError as error:
        log.error("%s The worker rebuilds it from the log now.", error)
        memory.sha256 = digests(tx.connection, lease.rotor_id)
    return memory


def anew(store: SqlStore, science: Science, lease: Lease) -> Task:
    """The rotor's entries up to the cursor, and no state: all is computed and written."""
    with store.read() as tx:
        rotor = tx.records.rotor(lease.rotor_id)
        through = lease.applied_seq
        spec = spec_of(tx, rotor, through)
        card = tx.records.model(rotor.model_id, rotor.model_version)
        events = read_entries(tx.connection, rotor.id, 0, through)
        names = digests(tx.connection, rotor.id)
        network = adopted_at(tx, rotor, through).network
    whole = PackedLog().extended(entries_of(events))
    memory = Memory(lease.version, through, None, names, anew=True, log=whole)
    return Task(science.vary(card, network), spec, through, whole, 0, memory, mark(events, None))
