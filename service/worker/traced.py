"""What an update of a rotor says to traces.

The update is a span of its own, in the trace of the oldest entry that it takes and with links to
the traces of the others. Besides, every entry has a span in its own trace, over the same time and
with a link to the update's: so each POST's trace leads to the version that its readings entered,
provisional, and again to the one that sealed them. Which these are stands in the log: those since
the last version, or since the last sealed one that is kept.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from sqlalchemy import func, select

from service import telemetry, tracing
from service.store import tables as t
from service.store.unit_of_work import SqlStore
from service.worker.lease import Lease

MOST = 128  # entries of one update that are told of one by one; links have this limit as well


@dataclass(frozen=True, slots=True)
class Origin:
    """An entry of the log, and the trace that it came with."""

    seq: int
    entry: str
    traceparent: str


class Told:
    """One update as traces know it; without traces it does nothing."""

    def __init__(self, store: SqlStore, lease: Lease, stack: ExitStack) -> None:
        self._store = store
        self._lease = lease
        self._stack = stack
        self._since_ns = time.time_ns()
        self._origins: Sequence[Origin] = ()
        self.span = tracing.NOTHING

    def begin(self, after: int, through: int) -> None:
        """What the update rests on was read: entries with after < seq <= through are new."""
        if not tracing.on():
            return
        lease = self._lease
        self._origins = origins(self._store, lease, after, through)
        parents = list(dict.fromkeys(one.traceparent for one in self._origins))
        parent = tracing.parent_of(parents[0] if parents else None)
        name = "seal" if lease.sealing else "update"
        self.span = self._stack.enter_context(
            tracing.span(
                name, kind="consumer", parent=parent, links=parents[1:], since_ns=self._since_ns
            )
        )
        if self.span.traceparent is not None:
            trace_id = self.span.traceparent.split("-")[1]
            self._stack.enter_context(telemetry.about(trace_id=trace_id))
        self.span.tell(
            rotor=lease.rotor_id, through_seq=through, attempt=lease.attempts, fence=lease.fence
        )

    def committed(self, version: int, *, sealed: bool) -> None:
        """The version is there: tell it of the update, and of each entry in its own trace."""
        if not tracing.on():
            return
        self.span.tell(version=version, sealed=sealed, entries=len(self._origins))
        links = [] if self.span.traceparent is None else [self.span.traceparent]
        for one in self._origins:
            with tracing.span(
                "entry sealed" if sealed else "entry applied",
                kind="consumer",
                parent=tracing.parent_of(one.traceparent),
                links=links,
                since_ns=self._since_ns,
            ) as span:
                span.tell(
                    rotor=self._lease.rotor_id,
                    entry=one.entry,
                    seq=one.seq,
                    version=version,
                    sealed=sealed,
                )

    def failed(self, error: Exception) -> None:
        self.span.fail(type(error).__name__)


@contextmanager
def told(store: SqlStore, lease: Lease) -> Iterator[Told]:
    """Around an update; it began with the claim."""
    with ExitStack() as stack:
        yield Told(store, lease, stack)


def origins(store: SqlStore, lease: Lease, after: int, through: int) -> Sequence[Origin]:
    """Entries that came with a trace, in order: those since `after`, the newest `MOST` of them;
    of a sealing those since the last sealed version."""
    e, s = t.entry.c, t.state.c
    with store.read() as tx:
        if lease.sealing:
            sealed = select(func.max(s.through_seq)).where(
                s.rotor_id == lease.rotor_id, s.sealed, s.version < lease.version
            )
            after = tx.connection.execute(sealed).scalar() or 0
        query = (
            select(e.seq, e.event_id, e.traceparent)
            .where(e.rotor_id == lease.rotor_id, e.seq > after, e.seq <= through)
            .where(e.traceparent.is_not(None))
            .order_by(e.seq.desc())
            .limit(MOST)
        )
        rows = tx.connection.execute(query).all()
    return [Origin(row.seq, row.event_id, row.traceparent) for row in reversed(rows)]
