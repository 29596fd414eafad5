"""Sealed versions of an older algorithm, computed anew by whoever seals and has nothing else to do.

A release that mends the calibration mends what was computed before it, too: a rotor that gets no
reading for a year would answer by the old algorithm until then. Such a rotor is not dirty, for it
waits for nothing; it is claimed as one that is to be sealed, so that an entry that comes meanwhile
is applied over it at once. Its new version rests on the same entries, with one number more.

Processes of an older release that go on beside this one write versions of theirs, and do not know
that newer ones exist. So it is looked again now and then; none of theirs is renewed by them.

A rotor that cannot be computed anew (its model is none of this release's) keeps what it has, and is
not blocked: the log says why, and the process leaves it alone. One over which workers die, or take
too long, is left alone by all of them after `DEATHS`, and says so in its `last_error`, until a
reading or `retry` ends that. (More deaths would block it, or be laid to the reading that is next.)
"""

from __future__ import annotations

import logging
import math
from time import monotonic
from typing import Any

from sqlalchemy import ColumnElement, Connection, Engine, Row, and_, false, select, update

from service.ports import Science
from service.store import tables as t
from service.store.engine import transaction
from service.worker import claiming, clock
from service.worker.claiming import Role
from service.worker.lease import Lease

log = logging.getLogger("bladetwin.worker")
LOOK_S = 60.0  # between two looks that find nothing
DEATHS = 2
c = t.cursor.c


def superseded(names: tuple[str, ...]) -> ColumnElement[bool]:
    """The newest version is of one of these algorithms, nothing else is to be done, and it was not
    given up."""
    idle = and_(c.dirty == false(), c.blocked == false(), c.version == t.state.c.version)
    return and_(idle, c.last_error.is_(None), t.state.c.algorithm_version.in_(names))


def _give_up(connection: Connection, row: Row[Any]) -> None:
    """Give the rotor back as it was, with a note of why it stays so."""
    note = (
        f"version {row.version} is of an older algorithm and stays: {DEATHS} workers died over "
        "computing it anew, or took longer than BLADETWIN_UPDATE_MAX_S; their logs say more. "
        "A reading, or POST …/retry, has it tried again."
    )
    log.error("rotor %s: %s", row.rotor_id, note)
    free = update(t.cursor).where(c.rotor_id == row.rotor_id)
    values = {"owner": None, "lease_until": None, "sealing": False, "attempts": 0}
    connection.execute(free.values(**values, last_error=note, last_error_event=None))


class Older:
    """Claims rotors whose newest version is of an older algorithm; one process's.

    science    names the algorithms; asked at the first look
    """

    def __init__(self, science: Science, owner: str, lease_s: float, role: Role) -> None:
        self._science = science
        self._owner = owner
        self._lease_s = lease_s
        self._next = -math.inf if "quiet" in claiming.KINDS[role] else math.inf
        self._left: set[str] = set()

    def claim(self, engine: Engine) -> Lease | None:
        """One of them; None: there is none, or it was looked a moment ago."""
        if monotonic() < self._next:
            return None
        rested = clock.rested(c.not_before, clock.LONGEST_S)
        first = (
            select(c.rotor_id)
            .join(t.state, t.state.c.rotor_id == c.rotor_id)
            .where(superseded(self._science.superseded), claiming.unheld(self._lease_s), rested)
            .where(c.rotor_id.not_in(sorted(self._left)))
            .order_by(c.rotor_id)
            .limit(1)
        )
        with transaction(engine, write=False) as connection:
            found = connection.execute(first).first()
        if found is None:
            self._next = monotonic() + LOOK_S
            return None
        with transaction(engine, write=True) as connection:
            found = connection.execute(claiming.locked(first)).first()
            if found is None:
                return None  # somebody was quicker
            take = claiming.take(self._lease_s, "quiet").where(c.rotor_id == found.rotor_id)
            row = connection.execute(take.returning(*claiming.TAKEN), {"by": self._owner}).one()
            died = row.attempts > DEATHS
            if died:
                _give_up(connection, row)
        if died:
            return self.claim(engine)
        place = (row.fence, row.applied_seq, row.version, row.attempts)
        return Lease(row.rotor_id, self._owner, *place, row.sealing, renews=True)

    def leave(self, lease: Lease, error: Exception) -> None:
        """Note that it cannot be done."""
        self._left.add(lease.rotor_id)
        log.error(
            "rotor %s: version %d is of an older algorithm and cannot be computed anew; it stays. "
            "%s: %s",
            lease.rotor_id,
            lease.version,
            type(error).__name__,
            error,
        )
