"""Who may take a rotor, and when.

A claim raises the fence and takes a lease by the database's clock. Whoever finds the lease over
may claim again with a higher fence (`service.worker.lease`: what a lease allows).

A rotor is claimed to apply what is pending, or, when nothing is, to seal a provisional posterior.
Sealing takes long and may wait: an entry that comes meanwhile is claimed over it at once, and the
sealing worker's commit is one that came too late. But a stream without a pause must not put it off
for ever: a rotor that has been provisional for `overdue_s` goes before all else that a sealer does,
is sealed as far as it was applied, and what comes meanwhile waits for that one sealing. Until a
sealer takes it entries are applied as ever: where none lives they do not wait for it.

A rotor whose model changes (an entry that adopts effects or backs them out, `service.adopted`) is
computed anew from its whole log, which takes as long as a sealing: that is the sealer's work, and
entries that come with it or after it are applied with it. Nothing is claimed over it.

A rotor is also claimed by name, to rebuild what was damaged (`claim_rotor`): under the same fence,
and never from a worker whose lease still runs.

Each claim counts as an attempt until a version comes of it, and a rotor over which too many workers
died is blocked. When a lease or a pause is over: `service.worker.clock`.

Every condition below is one function, so that a test can take it away and see the loss noticed.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, Literal

from sqlalchemy import (
    ColumnElement,
    Engine,
    Row,
    Select,
    Update,
    and_,
    bindparam,
    case,
    exists,
    false,
    not_,
    or_,
    select,
    true,
    update,
)
from sqlalchemy.sql.dml import ReturningUpdate

from service.adopted import KINDS as CHANGES
from service.store import tables as t
from service.store.engine import begun_s, is_sqlite, now_s, transaction
from service.worker import clock
from service.worker.lease import Lease

c = t.cursor.c
Role = Literal["all", "apply", "seal", "diagnose", "deliver"]
Kind = Literal["late", "apply", "model", "quiet"]
KINDS: dict[Role, tuple[Kind, ...]] = {
    "all": ("late", "apply", "model", "quiet"),
    "apply": ("apply",),
    "seal": ("late", "model", "quiet"),
    "diagnose": (),
    "deliver": (),
}
FOREVER = 1e12  # s


def pending() -> ColumnElement[bool]:
    """Entries of the log, or the prior, are not applied yet."""
    head = select(t.rotor.c.head_seq).where(t.rotor.c.id == c.rotor_id).scalar_subquery()
    return or_(c.version == 0, c.applied_seq < head)


def remodelled() -> ColumnElement[bool]:
    """An entry that is not applied yet changes the model.

    Each kind by itself, so that PostgreSQL finds it by the index of kinds once it has statistics of
    the table; until then it goes through the rotor's log.
    """
    e = t.entry.c
    own = (e.rotor_id == c.rotor_id, e.seq > c.applied_seq)
    return or_(*(exists().where(*own, e.kind == kind) for kind in CHANGES))


def overdue(overdue_s: float) -> ColumnElement[bool]:
    """The rotor has been provisional for too long."""
    return and_(c.provisional_since.is_not(None), clock.passed(c.provisional_since, overdue_s))


def unheld(lease_s: float) -> ColumnElement[bool]:
    """Nobody alive holds the rotor."""
    return or_(c.lease_until.is_(None), clock.over(c.lease_until, lease_s))


def ran_out(lease_s: float) -> ColumnElement[bool]:
    """Somebody held the rotor and did not give it back."""
    return clock.over(c.lease_until, lease_s)


def claimable(
    kind: Kind, *, lease_s: float, quiet_s: float, overdue_s: float
) -> ColumnElement[bool]:
    """There is work of this kind, nobody alive holds it, and no pause is running."""
    free = unheld(lease_s)
    late = overdue(overdue_s)
    due = {
        "late": and_(late, free),
        # most rotors are dirty since they wait to be sealed: their logs are not looked at
        "apply": and_(
            case((pending(), not_(remodelled())), else_=false()),
            or_(free, and_(c.sealing == true(), not_(late))),
        ),
        "model": and_(remodelled(), free),
        "quiet": and_(not_(pending()), free, clock.passed(c.dirty_since, quiet_s)),
    }[kind]
    rested = or_(c.not_before.is_(None), c.not_before <= now_s())
    return and_(c.dirty == true(), c.blocked == false(), rested, due)


def claim(
    engine: Engine,
    owner: str,
    lease_s: float,
    *,
    role: Role = "all",
    quiet_s: float = 0.0,
    overdue_s: float = math.inf,
) -> Lease | None:
    """Take the rotor that has waited longest; None: nothing to do.

    Pending entries go before sealing; a rotor is sealed when it was quiet for `quiet_s`, and before
    anything else when it was provisional for `overdue_s`.
    """
    at_once = not is_sqlite(engine)
    for kind in KINDS[role]:
        asked = (kind, lease_s, quiet_s, min(overdue_s, FOREVER), _conditions())
        lease = _claim_at_once(engine, owner, asked) if at_once else _claim(engine, owner, asked)
        if lease is not None:
            return lease
    return None


Asked = tuple[Kind, float, float, float, tuple[object, ...]]
TAKEN = (c.rotor_id, c.fence, c.applied_seq, c.version, c.attempts, c.sealing)


def _conditions() -> tuple[object, ...]:
    """What makes the statements, so that other ones make other statements."""
    of_kind = (claimable, pending, remodelled, overdue, clock.passed, unheld)
    of_clock = (clock.over, clock.outlived, clock.counted, now_s, begun_s, clock.AHEAD)
    return (*of_kind, ran_out, locked, *of_clock)


def locked(first: Select[Any]) -> Select[Any]:
    """The rotor is the caller's alone until the claim is committed; held ones are passed over."""
    return first.with_for_update(skip_locked=True, of=t.cursor)


@lru_cache(maxsize=64)
def _longest(
    kind: Kind, lease_s: float, quiet_s: float, overdue_s: float, conditions: tuple[object, ...]
) -> Select[Any]:
    """The rotor that has waited longest, built once: every commit of anybody makes workers look."""
    due = claimable(kind, lease_s=lease_s, quiet_s=quiet_s, overdue_s=overdue_s)
    return select(c.rotor_id, c.sealing).where(due).order_by(c.dirty_since).limit(1)


def take(lease_s: float, kind: Kind) -> Update:
    """The claim of rotors that a condition is still to name."""
    return update(t.cursor).values(
        fence=c.fence + 1,
        attempts=c.attempts + clock.counted(c.lease_until, lease_s),
        owner=bindparam("by"),
        lease_until=now_s() + lease_s,
        sealing=kind in ("late", "quiet"),
        takeovers=c.takeovers + case((ran_out(lease_s), 1), else_=0),
    )


@lru_cache(maxsize=64)
def _first_taken(
    kind: Kind, lease_s: float, quiet_s: float, overdue_s: float, conditions: tuple[object, ...]
) -> ReturningUpdate[Any]:
    """Look, lock and claim as one statement of PostgreSQL's.

    A query that locks is computed once and by itself, wherever it stands (PostgreSQL inlines no
    such CTE), so that one rotor is locked and no other. The lock is of the newest version of the
    row: where somebody committed one after the statement began, the whole condition is asked of
    that one again, and a rotor that does not meet it any more is passed over. Then the update,
    whose own view of the row may be older than the lock, finds it changed, goes on to the same
    newest version, which nobody can have changed since, asks again only for its name, and adds to
    the fence that stands there. What the condition asks of other tables (the log's head, changes
    of the model) is as of the statement's beginning, as it was with two statements.

    Where nothing is due no row is locked and no transaction number taken.
    """
    first = locked(_longest(kind, lease_s, quiet_s, overdue_s, conditions)).cte("first")
    taken = take(lease_s, kind).where(c.rotor_id == first.c.rotor_id)
    return taken.returning(*TAKEN, first.c.sealing.label("before"))


def _claim_at_once(engine: Engine, owner: str, asked: Asked) -> Lease | None:
    with transaction(engine, write=True, alone=True) as connection:
        row = connection.execute(_first_taken(*asked), {"by": owner}).one_or_none()
    return None if row is None else _lease(owner, row, after_sealing=row.before)


def _claim(engine: Engine, owner: str, asked: Asked) -> Lease | None:
    """The same of SQLite, which locks all of the database: looked at before anything is locked."""
    first, (kind, lease_s, *_) = _longest(*asked), asked
    with transaction(engine, write=False) as connection:
        if connection.execute(first).first() is None:
            return None
    with transaction(engine, write=True) as connection:
        found = connection.execute(first).one_or_none()
        if found is None:
            return None
        taken = take(lease_s, kind).where(c.rotor_id == found.rotor_id).returning(*TAKEN)
        row = connection.execute(taken, {"by": owner}).one()
    return _lease(owner, row, after_sealing=found.sealing)


def _lease(owner: str, row: Row[Any], *, after_sealing: bool) -> Lease:
    place = (row.fence, row.applied_seq, row.version, row.attempts)
    return Lease(row.rotor_id, owner, *place, row.sealing, after_sealing=after_sealing)


def claim_rotor(engine: Engine, rotor_id: str, owner: str, lease_s: float) -> Lease | None:
    """Take this rotor to rebuild what it has; None: a worker holds it.

    No attempt is counted, and entries wait until the lease is given back.
    """
    take = (
        update(t.cursor)
        .where(c.rotor_id == rotor_id, unheld(lease_s))
        .values(fence=c.fence + 1, owner=owner, lease_until=now_s() + lease_s, sealing=False)
        .returning(c.fence, c.applied_seq, c.version, c.attempts)
    )
    with transaction(engine, write=True, alone=True) as connection:
        row = connection.execute(take).one_or_none()
    if row is None:
        return None
    return Lease(rotor_id, owner, row.fence, row.applied_seq, row.version, row.attempts, True)
