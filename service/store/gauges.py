"""What a database says of its service at one moment, in one reading transaction.

Counters are kept in the tables, for the workers that count are other processes, perhaps on other
machines: `cursor.takeovers` and `cursor.seals` rise in the transactions that they count. Neither
entries of a log nor jobs are ever deleted, so that what they tell can be counted where they lie.
"""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import Connection, and_, func, select, true

from service.adopted import ADOPTION, BACK_OUT
from service.handlers.diagnoses import KIND as DIAGNOSE
from service.ports import Gauges
from service.store import tables as t
from service.store.engine import now_s
from service.store.hook_tables import delivery, untold


def read_gauges(connection: Connection, superseded: Sequence[str]) -> Gauges:
    """The gauges of all rotors together.

    superseded   state algorithms before this release's
    """
    c, r, e, j = t.cursor.c, t.rotor.c, t.entry.c, t.job.c
    of_rotors = (
        select(
            func.count().label("rotors"),
            func.sum(r.head_seq - c.applied_seq).label("backlog"),
            func.sum(c.applied_seq).label("applied"),
            func.sum(c.version).label("versions"),
            func.sum(c.seals).label("seals"),
            func.sum(c.takeovers).label("takeovers"),
            func.count().filter(c.dirty == true()).label("dirty"),
            func.count().filter(c.blocked == true()).label("blocked"),
            func.count().filter(c.provisional_since.is_not(None)).label("provisional"),
            func.min(c.ess_ratio).label("ess_ratio"),
        )
        .select_from(t.rotor)
        .join(t.cursor, c.rotor_id == r.id)
    )
    row = connection.execute(of_rotors).one()
    newest = and_(t.state.c.rotor_id == c.rotor_id, t.state.c.version == c.version)
    older = select(func.count()).select_from(t.cursor).join(t.state, newest)
    older = older.where(t.state.c.algorithm_version.in_(superseded))
    # the first entry that a rotor has not applied is the one after its cursor
    first = and_(e.rotor_id == c.rotor_id, e.seq == c.applied_seq + 1)
    waiting = select(now_s() - func.min(e.received_at)).select_from(t.cursor).join(t.entry, first)
    queued = select(func.count()).where(j.status.in_(("queued", "running")))
    of_hooks = select(delivery.c.status, func.count()).group_by(delivery.c.status)
    deliveries = {row[0]: row[1] for row in connection.execute(of_hooks)}
    dropped = select(func.coalesce(func.sum(untold.c.count), 0))
    alarms = select(func.coalesce(func.sum(t.residual.c.alarms), 0))
    return Gauges(
        rotors=row.rotors,
        backlog=int(row.backlog or 0),
        applied=int(row.applied or 0),
        versions=int(row.versions or 0),
        seals=int(row.seals or 0),
        takeovers=int(row.takeovers or 0),
        dirty=row.dirty,
        blocked=row.blocked,
        provisional=row.provisional,
        least_ess_ratio=row.ess_ratio,
        oldest_s=max(0.0, connection.execute(waiting).scalar() or 0.0),
        jobs=int(connection.execute(queued).scalar_one()),
        deliveries_pending=deliveries.get("pending", 0),
        deliveries_dead=deliveries.get("dead", 0),
        deliveries_dropped=int(connection.execute(dropped).scalar_one()),
        alarms=int(connection.execute(alarms).scalar_one()),
        outdated=int(connection.execute(older).scalar_one()),
        **_of_the_loop(connection),
    )


def _of_the_loop(connection: Connection) -> dict[str, int]:
    """Diagnoses that ended, and what went into rotors' models or out of them."""
    r, e, j = t.rotor.c, t.entry.c, t.job.c
    # rotor by rotor, by the index of kinds: the logs themselves are not gone through
    changed = and_(e.rotor_id == r.id, e.kind.in_((ADOPTION, BACK_OUT)))
    of_models = select(e.kind, func.count()).select_from(t.rotor).join(t.entry, changed)
    ended = select(j.status, func.count()).where(
        j.kind == DIAGNOSE, j.status.in_(("done", "failed"))
    )
    found = {
        row[0]: row[1]
        for query in (of_models.group_by(e.kind), ended.group_by(j.status))
        for row in connection.execute(query)
    }
    names = {ADOPTION: "adoptions", BACK_OUT: "back_outs", "done": "diagnosed"}
    names |= {"failed": "undiagnosed"}
    return {name: found.get(key, 0) for key, name in names.items()}
