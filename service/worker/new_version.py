"""What an update writes: a new version of a rotor's posterior, and the cursor that moves with it.

Of the version's arrays only those whose SHA-256 changed are written; the version is called by the
digest of what the science says of it and of the SHA-256 of every array that it has. State, arrays,
alarm and cursor are one transaction, under the fence of the worker's claim: exactly once, or not at
all.
"""

from __future__ import annotations

from sqlalchemy import Engine

from core.digest import state_digest
from service.ports import RotorState, StateRecord
from service.store.encoding import Encoded, encode
from service.store.engine import transaction
from service.store.versions import write_state
from service.worker import lease as leases
from service.worker.alarm import alarm
from service.worker.lease import Lease
from service.worker.memory import Memory
from service.worker.task import Task

# SHA-256 of each array of a version, and the arrays to write (None: the name ended)
Change = tuple[dict[str, str], dict[str, Encoded | None]]


def change(task: Task, state: RotorState) -> Change:
    """The arrays that the new version has to write, and the digest of each that it has."""
    before, fresh = task.memory.sha256, state.fresh
    sha256: dict[str, str] = {}
    changed: dict[str, Encoded | None] = {}
    for name in state.arrays:
        if name not in fresh:
            sha256[name] = before[name]
            continue
        encoded = encode(state.arrays[name])
        sha256[name] = encoded.sha256
        if task.memory.anew or before.get(name) != encoded.sha256:
            changed[name] = encoded
    return sha256, changed | dict.fromkeys(before.keys() - sha256.keys())


def commit(engine: Engine, lease: Lease, task: Task, state: RotorState, change: Change) -> Memory:
    """State and cursor in one transaction; what the worker is to remember of them.

    LostLeaseError leaves the database as it was.
    """
    sha256, changed = change
    sealed = bool(state.meta["sealed"])
    with transaction(engine, write=True) as connection:
        ratio = state.meta["health"].get("ess_ratio")
        version = leases.advance(connection, lease, task.through, sealed=sealed, ess_ratio=ratio)
        record = StateRecord(
            rotor_id=lease.rotor_id,
            version=version,
            through_seq=task.through,
            model_id=task.card.id,
            model_version=task.card.version,
            algorithm_version=str(state.meta["algorithm_version"]),
            sealed=sealed,
            digest=state_digest(state.meta, sha256),
            events_digest=str(state.meta["events_digest"]),
            meta=dict(state.meta),
            created_at=0.0,
        )
        alarm(connection, record)
        write_state(connection, record, changed)
    return Memory(
        version,
        task.through,
        state,
        sha256,
        last=task.last,
        digest=record.digest,
        log=task.log.closed(),
    )
