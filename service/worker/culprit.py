"""Which entry of the log stops a rotor, as far as that can be told.

What failed is tried once more before an entry is named: what passes then failed for the moment's
reasons, memory for one. It is tried as of the entry before those that are new, too, for what fails
there has nothing to do with them. Only then is the first of them with which it fails looked for, by
bisection. A sealing takes long, so that of several new entries none is tried alone; an entry that
ends its worker would end this one as well. There, which entries are new has to do.
"""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy import func, select, true

from core.log import effective
from service.adopted import adopted_at
from service.errors import StoreAwayError
from service.kernels import CompiledError
from service.ports import Science
from service.store import tables as t
from service.store.unit_of_work import SqlStore
from service.worker.lease import Lease
from service.worker.task import Task, spec_of

e, s = t.entry.c, t.state.c
PASSED = "It passed on another try, so no entry is named."
BEFORE = "It fails without the new entries, too, so none of them is named."
LONG = "To try each alone takes too long, so no entry is named."


@dataclass(frozen=True, slots=True)
class Culprit:
    """The entry that stops a rotor, None where that cannot be told; and what is known of it."""

    event: str | None
    note: str


@dataclass(frozen=True, slots=True)
class New:
    """The entries with after < seq <= through: no version, or no sealed one, rests on them."""

    store: SqlStore
    lease: Lease
    after: int
    through: int

    @property
    def count(self) -> int:
        return self.through - self.after

    @property
    def range(self) -> str:
        """The first and the last of them, in words."""
        done = "sealed" if self.lease.sealing else "applied"
        if self.count == 0:
            return f"No entry is new since what was {done} last."
        last = f"{self.through} ({self.event(self.through)})"
        if self.count == 1:
            return f"Not {done} yet: entry {last}."
        return f"Not {done} yet: entries {self.after + 1} ({self.event(self.after + 1)}) to {last}."

    def event(self, seq: int) -> str:
        """What an entry is called by; a retraction, by what it retracts."""
        query = select(e.kind, e.event_id, e.replaces)
        with self.store.read() as tx:
            own = query.where(e.rotor_id == self.lease.rotor_id, e.seq == seq)
            row = tx.connection.execute(own).one()
        return str(row.replaces if row.kind == "retraction" else row.event_id)


def new(store: SqlStore, lease: Lease, through: int | None = None) -> New:
    """What a claim is the first to apply, through the head if nothing is said, or to seal."""
    own = s.rotor_id == lease.rotor_id
    sealed = select(func.max(s.through_seq)).where(own, s.sealed == true())
    head = select(t.rotor.c.head_seq).where(t.rotor.c.id == lease.rotor_id)
    with store.read() as tx:
        if lease.sealing:
            after = tx.connection.execute(sealed).scalar() or 0
            return New(store, lease, after, lease.applied_seq)
        if through is None:
            through = tx.connection.execute(head).scalar_one()
    return New(store, lease, lease.applied_seq, through)


def of_deaths(store: SqlStore, lease: Lease) -> Culprit:
    """Of a rotor over which workers died: the entry that was pending, where it was one alone.

    Workers that died over a sealing say nothing of an entry that came after it.
    """
    found = new(store, lease)
    what = "sealing" if lease.sealing else "update"
    dead = f"{lease.attempts - 1} workers died or lost their lease during the {what}."
    alone = found.count == 1 and not (lease.sealing or lease.after_sealing)
    return Culprit(found.event(found.through) if alone else None, f"{dead} {found.range}")


def of_failure(store: SqlStore, science: Science, lease: Lease, task: Task) -> Culprit:
    """Of an update or a sealing that failed."""
    found = new(store, lease, task.through)
    long = lease.sealing or task.memory.anew
    if long and found.count > 1:
        return Culprit(None, f"{LONG} {found.range}")

    def fails(through: int) -> bool:
        return _fails(found, science, task, through, quick=not long)

    if not fails(found.through):
        return Culprit(None, PASSED)
    if found.count == 0 or fails(found.after):
        return Culprit(None, f"{BEFORE} {found.range}" if found.count else found.range)
    works, bad = found.after, found.through
    while bad - works > 1:
        middle = (works + bad) // 2
        if fails(middle):
            bad = middle
        else:
            works = middle
    return Culprit(found.event(bad), "")


def _fails(found: New, science: Science, task: Task, through: int, *, quick: bool) -> bool:
    """Whether the update as of an entry fails."""
    with found.store.read() as tx:
        rotor = tx.records.rotor(found.lease.rotor_id)
        card = tx.records.model(rotor.model_id, rotor.model_version)
        spec, network = spec_of(tx, rotor, through), adopted_at(tx, rotor, through).network
    readings = effective([entry for entry in task.log.entries() if entry.seq <= through])
    try:
        card = science.vary(card, network)
        science.update(card, spec, readings, task.memory.state, quick=quick)
    except (CompiledError, StoreAwayError):
        raise
    except Exception:
        return True
    return False
