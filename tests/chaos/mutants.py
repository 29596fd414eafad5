"""Services with one rule taken away, each of which the studies have to notice.

Each is a function that puts something else in the place of a rule, by `setattr` in a process of its
own (`main`), or by pytest's monkeypatch.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import Connection, select, true

from service.handlers import inspections
from service.ports import Appended
from service.store import log
from service.store import tables as t
from service.store.engine import transaction
from service.store.log import SqlLog
from service.store.unit_of_work import SqlStore
from service.studies.chaos import twin
from service.studies.chaos.processes import Kind
from service.worker import lease as leases
from service.worker import new_version, task
from service.worker.update import Updater

Put = Callable[[Any, str, Any], None]


def acknowledged_early(put: Put) -> None:
    """The answer goes out before the transaction is committed."""
    real = inspections.post_inspections

    def early(store: Any, rotor_id: str, items: Sequence[Any]) -> list[Appended]:
        with store.read() as tx:
            head = tx.records.rotor(rotor_id).head_seq
        threading.Timer(3.0, real, (store, rotor_id, items)).start()
        return [Appended(item.reading.id, head + i, True) for i, item in enumerate(items, start=1)]

    put(inspections, "post_inspections", early)


def head_not_locked(put: Put) -> None:
    """Two writers take the same sequence number."""

    def unlocked(connection: Any, rotor_id: str) -> Any:
        query = select(t.rotor.c.head_seq).where(t.rotor.c.id == rotor_id)
        return connection.execute(query).scalar()

    put(log, "lock_rotor", unlocked)
    put(log, "append_one", lambda *given: (None, None))  # whose number nobody else can have
    put(SqlStore, "write", SqlStore.read)  # SQLite's lock is that of BEGIN IMMEDIATE


def repetition_not_known(put: Put) -> None:
    """A reading that is posted again is taken for a new one."""
    put(SqlLog, "_known", lambda self, rotor_id, ids: {})


def digest_not_compared(put: Put) -> None:
    """A known id with another content is taken for a repetition."""
    real = SqlLog._known

    class Equal(str):
        __hash__ = str.__hash__

        def __ne__(self, other: object) -> bool:
            return False

    def same(self: SqlLog, rotor_id: str, ids: list[str]) -> Any:
        known = real(self, rotor_id, ids)
        return {name: (Equal(digest), seq) for name, (digest, seq) in known.items()}

    put(SqlLog, "_known", same)


def cursor_to_the_head(put: Put) -> None:
    """The cursor moves to the head as it is at the commit, not to what was read."""
    real = Updater.commit

    def commit(self: Updater, lease: Any, task: Any, state: Any, change: Any) -> int:
        with self.store.read() as tx:
            head = tx.records.rotor(lease.rotor_id).head_seq
        return real(self, lease, replace(task, through=head), state, change)

    put(Updater, "commit", commit)


def memory_not_compared(put: Put) -> None:
    """A worker goes on from what it remembers, whoever wrote the version since."""
    real = Updater.read

    def read(self: Updater, lease: Any) -> Any:
        memory = self._memory.get(lease.rotor_id)
        if memory is not None:
            memory.version, memory.through = lease.version, lease.applied_seq
        return real(self, lease)

    put(Updater, "read", read)
    put(task, "same_history", lambda *given: True)


def no_fence(put: Put) -> None:
    """Whoever was believed dead commits all the same."""
    put(leases, "holds", lambda lease: true())
    put(leases, "moves_on", lambda lease: true())


def cursor_outside(put: Put) -> None:
    """The state is committed in a transaction of its own, before the cursor moves."""
    real = new_version.write_state

    def by_itself(connection: Connection, record: Any, changed: Any) -> None:
        connection.rollback()
        with transaction(connection.engine, write=True) as own:
            real(own, record, changed)

    put(new_version, "write_state", by_itself)


BREAK: dict[str, Callable[[Put], None]] = {
    rule.__name__: rule
    for rule in (
        acknowledged_early,
        head_not_locked,
        repetition_not_known,
        digest_not_compared,
        cursor_to_the_head,
        memory_not_compared,
        no_fence,
        cursor_outside,
    )
}


def main(kind: Kind, owner: str, mutant: str) -> None:
    """A process of the study with this rule broken."""
    BREAK[mutant](setattr)
    twin.main(kind, owner)
