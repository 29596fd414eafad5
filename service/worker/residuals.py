"""Residuals are computed for the newest sealed version of a rotor, and kept.

They cost a calibration for each visit, so no request computes them. A worker of the role `diagnose`
that has no diagnosis to do takes the rotor whose sealed version is newer than what is kept, under a
lease with a fence like a job's. Versions that come meanwhile are not queued up: the next look is at
the newest. What cannot be computed is kept as an error until the rotor has another version.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from sqlalchemy import ColumnElement, Engine, insert, or_, select, update

from core.errors import InputError
from core.log import effective
from core.readings import digest_of
from service.adopted import adopted_at
from service.entries import entries_of
from service.errors import LostLeaseError, StoreAwayError
from service.ports import Json, RotorSpec, Science
from service.settings import Settings
from service.store import tables as t
from service.store.commits import lock_rotor
from service.store.creation import sound_blades
from service.store.engine import now_s, transaction
from service.store.entries import read_entries
from service.store.outbox import post
from service.store.unit_of_work import SqlStore
from service.worker.clock import LONGEST_S, counted, over, rested
from service.worker.diagnosing import MOST_PARTICLES, plain
from service.worker.heartbeat import heartbeats
from service.worker.heed import StoppedError
from service.worker.overdue import Bound, Steps, endless, hangs

log = logging.getLogger("bladetwin.worker")
r, c = t.residual.c, t.cursor.c


@dataclass(frozen=True, slots=True)
class Claim:
    """A rotor whose residuals are to be computed, for its sealed version, and the fence."""

    rotor_id: str
    version: int
    through: int
    fence: int
    attempts: int


def holds(claim: Claim) -> ColumnElement[bool]:
    """The fence: nobody has claimed the rotor's residuals since."""
    return r.fence == claim.fence


def owned(owner: str) -> ColumnElement[bool]:
    """The claim was neither given back nor ended."""
    return r.owner == owner


def claim_residuals(
    engine: Engine, owner: str, lease_s: float, longest_s: float = LONGEST_S
) -> Claim | None:
    """The rotor whose residuals are oldest behind a sealed version, and held by nobody alive."""
    free = or_(r.lease_until.is_(None), over(r.lease_until, lease_s))
    now = rested(r.not_before, longest_s)
    behind = or_(r.rotor_id.is_(None), (r.version < c.version) & free & now)
    sealed = (
        c.provisional_since.is_(None) & (c.applied_seq > 0) & (c.applied_seq >= t.rotor.c.head_seq)
    )
    query = (
        select(c.rotor_id, c.version, c.applied_seq, r.fence)
        .join(t.rotor, t.rotor.c.id == c.rotor_id)
        .outerjoin(t.residual, r.rotor_id == c.rotor_id)
        .where(sealed, behind)
        .order_by(r.computed_at.nulls_first(), c.rotor_id)
        .limit(1)
    )
    with transaction(engine, write=False) as connection:
        if connection.execute(query).first() is None:
            return None
    with transaction(engine, write=True) as connection:
        found = connection.execute(query).first()
        if found is None or lock_rotor(connection, found.rotor_id) is None:
            return None
        own = r.rotor_id == found.rotor_id
        there = connection.execute(select(r.fence).where(own).with_for_update()).scalar()
        if there != found.fence:
            return None  # somebody was quicker
        if there is None:
            new = {"rotor_id": found.rotor_id, "version": 0, "alarms": 0, "fence": 0, "attempts": 0}
            connection.execute(insert(t.residual).values(new))
        take = (
            update(t.residual)
            .where(own)
            .values(
                fence=r.fence + 1,
                attempts=r.attempts + counted(r.lease_until, lease_s),
                owner=owner,
                lease_until=now_s() + lease_s,
            )
        )
        row = connection.execute(take.returning(r.fence, r.attempts)).one()
        return Claim(found.rotor_id, found.version, found.applied_seq, row.fence, row.attempts)


class Residuals:
    """Computes residuals, one rotor at a time. `stopping` says that the worker is to end."""

    def __init__(
        self,
        store: SqlStore,
        science: Science,
        settings: Settings,
        owner: str,
        stopping: Callable[[], bool] = lambda: False,
    ) -> None:
        self.store = store
        self.science = science
        self.settings = settings
        self.owner = owner
        self.stopping = stopping
        self.bound: Bound = endless

    def run_once(self) -> bool:
        """Claim a rotor and compute its residuals; False: none is behind."""
        claim = claim_residuals(
            self.store.engine, self.owner, self.settings.lease_s, self.settings.retry_max_s
        )
        if claim is None:
            return False
        try:
            if claim.attempts > self.settings.max_attempts:
                dead = f"{claim.attempts - 1} workers died or lost their lease over them"
                self.keep(claim, None, dead)
                return True
            steps = Steps(self.settings.step_max_s, self.bound)
            overdue = lambda: hangs(f"residuals of {claim.rotor_id}", steps.deadline)  # noqa: E731
            beat = lambda: self._beat(claim)  # noqa: E731
            with steps, heartbeats(beat, self.settings.lease_s, steps.deadline, overdue):
                body = self.compute(claim, steps.next)
            self.keep(claim, body, None)
        except LostLeaseError as error:
            log.warning("%s", error)
        except StoppedError:
            with suppress(LostLeaseError):
                self._close(claim, attempts=r.attempts - 1)
        except StoreAwayError:
            with suppress(LostLeaseError, StoreAwayError):
                self._close(claim, attempts=r.attempts - 1)
            raise
        except Exception as error:
            self._failed(claim, error)
        return True

    def compute(self, claim: Claim, begins: Callable[[], None] = lambda: None) -> Json:
        """The residuals of the log through the version's entry, outside any transaction.

        begins   is told of each step
        """
        with self.store.read() as tx:
            rotor = tx.records.rotor(claim.rotor_id)
            blades = sound_blades(tx.connection, rotor)
            blades = [b for b in blades if b.added_seq <= claim.through]
            card = tx.records.model(rotor.model_id, rotor.model_version)
            network = adopted_at(tx, rotor, claim.through).network
            readings = effective(
                entries_of(read_entries(tx.connection, rotor.id, 0, claim.through))
            )
        card = self.science.vary(card, network)
        particles = min(rotor.particles, MOST_PARTICLES)
        known = {b.id: b.known for b in blades if b.known is not None}
        name = rotor.origin or rotor.id
        spec = RotorSpec(name, tuple(b.id for b in blades), particles, rotor.seed, known)

        def progress(what: str, done: int, total: int) -> None:
            if self.stopping():
                raise StoppedError(f"residuals of {rotor.id} go back: their worker ends")
            begins()

        found = self.science.residuals(card, spec, blades, readings, progress)
        told: Json = plain(found) | {
            "rests_on": {
                "version": claim.version,
                "through_seq": claim.through,
                "events_digest": digest_of(readings),
                "model_digest": card.digest,
                "particles": particles,
            }
        }
        return told

    def keep(self, claim: Claim, body: Json | None, error: str | None) -> None:
        """Write what was found; a hint to listeners where something alarms now, or no longer."""
        alarms = 0 if body is None else int(body["alarms"])
        with transaction(self.store.engine, write=True) as connection:
            lock_rotor(connection, claim.rotor_id)
            own = (r.rotor_id == claim.rotor_id) & holds(claim)
            before = connection.execute(select(r.alarms).where(own).with_for_update()).scalar()
            if before is None:
                raise LostLeaseError(f"residuals of {claim.rotor_id}", claim.fence)
            values = {"version": claim.version, "alarms": alarms, "attempts": 0, "error": error}
            values |= {"body": None if body is None else json.dumps(body, allow_nan=False)}
            values |= {"owner": None, "lease_until": None, "not_before": None}
            done = update(t.residual).where(own).values(**values, computed_at=now_s())
            connection.execute(done)
            if alarms or before:
                tests = [] if body is None else [one for one in body["tests"] if one["alarm"]]
                shown = [{k: one[k] for k in ("grouping", "value", "statistic")} for one in tests]
                told = {"version": claim.version, "alarms": alarms, "tests": shown[:5]}
                post(connection, claim.rotor_id, "residuals", told)

    def _beat(self, claim: Claim) -> bool:
        own = (r.rotor_id == claim.rotor_id) & holds(claim) & owned(self.owner)
        with transaction(self.store.engine, write=True) as connection:
            beat = update(t.residual).where(own)
            until = now_s() + self.settings.lease_s
            return connection.execute(beat.values(lease_until=until)).rowcount == 1

    def _close(self, claim: Claim, **values: object) -> None:
        own = (r.rotor_id == claim.rotor_id) & holds(claim) & owned(self.owner)
        with transaction(self.store.engine, write=True) as connection:
            close = update(t.residual).where(own).values(owner=None, lease_until=None, **values)
            if connection.execute(close).rowcount != 1:
                raise LostLeaseError(f"residuals of {claim.rotor_id}", claim.fence)

    def _failed(self, claim: Claim, error: Exception) -> None:
        """Pause and try again; what will not do better next time is kept as the answer."""
        text = f"{type(error).__name__}: {error}"[:4000]
        log.error("residuals of %s: attempt %d: %s", claim.rotor_id, claim.attempts, text)
        pause = self.settings.retry_base_s * 2 ** (claim.attempts - 1)
        try:
            if isinstance(error, InputError) or claim.attempts >= self.settings.max_attempts:
                self.keep(claim, None, text)
            else:
                self._close(claim, not_before=now_s() + min(pause, self.settings.retry_max_s))
        except LostLeaseError as lost:
            log.warning("%s", lost)
