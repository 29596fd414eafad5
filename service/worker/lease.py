"""The fenced moves of a rotor's cursor.

A claim (`service.worker.claiming`) raises the fence. From then on the heartbeat and the commit of
whoever held the rotor before match no row and change nothing. The cursor moves in the transaction
that writes the new version, so a worker that dies anywhere leaves either both or neither.

Every condition below is one function, so that a test can take it away and see the loss noticed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace
from typing import Any, cast

from sqlalchemy import (
    BindParameter,
    ColumnElement,
    Connection,
    Engine,
    bindparam,
    case,
    func,
    select,
    true,
    update,
)
from sqlalchemy.sql.dml import ReturningUpdate
from sqlalchemy.sql.visitors import iterate

from service.errors import LostLeaseError
from service.store import tables as t
from service.store.commits import lock_rotor, locked_head, notified, notify
from service.store.engine import now_s, transaction
from service.store.hook_tables import webhook
from service.store.outbox import post

c = t.cursor.c


@dataclass(frozen=True, slots=True)
class Lease:
    """A claimed rotor: what its cursor said, and the fence that the claim raised.

    after_sealing   the claim before, of which no version came, was one to seal
    renews          a sealed version of an older algorithm is to be computed anew
    """

    rotor_id: str
    owner: str
    fence: int
    applied_seq: int
    version: int
    attempts: int
    sealing: bool
    after_sealing: bool = False
    renews: bool = False


Condition = Callable[[Lease], ColumnElement[bool]]
OWN = ("own_fence", "own_applied_seq", "own_owner")


def holds(lease: Lease) -> ColumnElement[bool]:
    """The fence: no one has claimed the rotor since."""
    return c.fence == lease.fence


def moves_on(lease: Lease) -> ColumnElement[bool]:
    """The cursor stands where the worker began."""
    return c.applied_seq == lease.applied_seq


def owned(lease: Lease) -> ColumnElement[bool]:
    """The claim is the caller's own."""
    return c.owner == lease.owner


def keep(connection: Connection, lease: Lease) -> None:
    """Lock the rotor for a change beside its cursor; LostLeaseError: roll everything back."""
    lock_rotor(connection, lease.rotor_id)
    own = select(c.rotor_id).where(c.rotor_id == lease.rotor_id, holds(lease))
    if connection.execute(own.with_for_update()).first() is None:
        raise LostLeaseError(lease.rotor_id, lease.fence)


def give_back(engine: Engine, lease: Lease) -> None:
    """End a claim that changed nothing of the cursor; entries that came meanwhile go on."""
    own = (c.rotor_id == lease.rotor_id) & holds(lease) & owned(lease)
    with transaction(engine, write=True) as connection:
        freed = update(t.cursor).where(own).values(owner=None, lease_until=None)
        if connection.execute(freed).rowcount:
            notify(connection, "bladetwin_work")


def uncounted(attempts: ColumnElement[int]) -> ColumnElement[int]:
    """One attempt less; they are counted anew where somebody freed the rotor meanwhile."""
    return case((attempts > 0, attempts - 1), else_=0)


def return_unused(engine: Engine, lease: Lease) -> None:
    """End a claim of which nothing came, through no fault of the rotor's: no attempt is counted."""
    own = (c.rotor_id == lease.rotor_id) & holds(lease) & owned(lease)
    with transaction(engine, write=True, alone=True) as connection:
        freed = update(t.cursor).where(own).values(attempts=uncounted(c.attempts))
        connection.execute(freed.values(owner=None, lease_until=None))


def heartbeat(engine: Engine, lease: Lease, lease_s: float) -> bool:
    """Prolong the lease; False: the rotor is no longer the caller's."""
    own = (c.rotor_id == lease.rotor_id) & holds(lease) & owned(lease)
    with transaction(engine, write=True, alone=True) as connection:
        beat = update(t.cursor).where(own).values(lease_until=now_s() + lease_s)
        return connection.execute(beat).rowcount == 1


def advance(
    connection: Connection,
    lease: Lease,
    through: int,
    *,
    sealed: bool,
    ess_ratio: float | None = None,
) -> int:
    """Move the cursor to `through` in the caller's transaction; the number of the new version.

    The rotor's row is locked first, in the same order as ingest does. The rotor stays dirty when
    its head moved on, or when a sealing pass has to follow; a blocked one (whose old versions are
    rebuilt) stays blocked, with its error. LostLeaseError: roll everything back.
    """
    move, names = _move(sealed, (holds, moves_on))
    given = {"rotor": lease.rotor_id, "to": through, "ess": ess_ratio}
    given |= {name: getattr(lease, name.removeprefix("own_")) for name in names if name in OWN}
    version = connection.execute(move, given).scalar()
    if version is None:
        raise LostLeaseError(lease.rotor_id, lease.fence)
    told = {"version": version, "through_seq": through, "sealed": sealed}
    post(connection, lease.rotor_id, "applied", told)
    return int(version)


@lru_cache(maxsize=64)
def _move(
    sealed: bool, conditions: tuple[Condition, ...]
) -> tuple[ReturningUpdate[Any], frozenset[str]]:
    """The cursor's move, built once, and the names of what it has to be given.

    The rotor's row is locked, the cursor moves and listeners are woken as one statement. A query
    that locks is computed once and by itself (`service.worker.claiming`), and gives the newest
    version of the row, whoever was waited for. The move needs what it gives, so it comes after it,
    and is of the newest version of the cursor as well: what an ingest that was waited for wrote
    there is overwritten by what its head says.
    """
    own = cast("Lease", SimpleNamespace(**{n.removeprefix("own_"): bindparam(n) for n in OWN}))
    head = locked_head(bindparam("rotor")).cte("head")
    to = bindparam("to", type_=c.applied_seq.type)
    dirty = head.c.head_seq > to if sealed else true()
    move = (
        update(t.cursor)
        .where(c.rotor_id == head.c.id, *(condition(own) for condition in conditions))
        .values(
            applied_seq=to,
            version=c.version + 1,
            dirty=dirty,
            dirty_since=case((dirty, now_s())),
            provisional_since=None if sealed else func.coalesce(c.provisional_since, now_s()),
            seals=c.seals + int(sealed),
            ess_ratio=bindparam("ess"),
            attempts=case((c.blocked == true(), c.attempts), else_=0),
            owner=None,
            lease_until=None,
            sealing=False,
            not_before=None,
            last_error=case((c.blocked == true(), c.last_error), else_=None),
            last_error_event=case((c.blocked == true(), c.last_error_event), else_=None),
        )
        .returning(c.version, case((c.dirty == true(), notified("bladetwin_work", ""))))
    )
    binds = (part for part in iterate(move) if isinstance(part, BindParameter))
    return move, frozenset(bind.key for bind in binds)


def fail(
    engine: Engine, lease: Lease, error: str, event: str | None, pause_s: float, *, block: bool
) -> None:
    """Note the error and give the rotor back, to pause or to stay blocked until freed.

    One that was freed during the attempt, so that its attempts are counted anew, is neither: it is
    tried again at once.
    """
    own = (c.rotor_id == lease.rotor_id) & holds(lease) & owned(lease)
    freed = c.attempts < lease.attempts
    with transaction(engine, write=True) as connection:
        lock_rotor(connection, lease.rotor_id)
        note = (
            update(t.cursor)
            .where(own)
            .values(
                owner=None,
                lease_until=None,
                not_before=case((freed, None), else_=now_s() + pause_s),
                blocked=case((freed, False), else_=block),
                last_error=error[:4000],
                last_error_event=event,
            )
            .returning(c.blocked)
        )
        if connection.execute(note).scalar():
            post(connection, lease.rotor_id, "blocked", {"error": error[:4000], "event": event})


def release(engine: Engine, owner: str, *, counted: bool = True) -> int:
    """End the leases of a worker that is known to be dead; how many rotors it held.

    The attempts stay counted: an entry that kills its worker must block its rotor in the end. Not
    `counted`: the worker was told to stop and was killed over it, which is no fault of its work.
    """
    with transaction(engine, write=True) as connection:
        freed = []
        for table in (t.cursor, t.job, webhook, t.residual):
            values: dict[str, object] = {"lease_until": None, "owner": None}
            if not counted and "attempts" in table.c:
                values["attempts"] = uncounted(table.c.attempts)
            own = update(table).where(table.c.owner == owner)
            freed.append(connection.execute(own.values(**values)).rowcount)
        if freed[0]:
            notify(connection, "bladetwin_work")
        return freed[0]
