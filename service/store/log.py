"""The inspection log, which is the queue.

Appending takes the rotor's row lock first (`lock`), so that sequence numbers are gap-free and in
the order of the commits: whoever sees number n sees every number below it. In the same
transaction the rotor's cursor becomes dirty; workers are notified when it flips.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Any

from sqlalchemy import (
    Connection,
    Row,
    Select,
    Text,
    bindparam,
    case,
    false,
    insert,
    literal,
    or_,
    select,
    true,
    update,
)

from service import tracing
from service.errors import ConflictError, NotFoundError
from service.ports import Appended, Event, ModelCard, NewEvent
from service.store import tables as t
from service.store.commits import lock_rotor, notified, notify
from service.store.engine import now_s
from service.store.entries import CHANGES, COLUMNS, NAMES, events_of, page_query, read_entries
from service.store.parts import among
from service.store.single import append_one

CHUNK = 500
# Statements of every post and read, built and understood once.
_KNOWN = select(t.entry.c.event_id, t.entry.c.digest, t.entry.c.seq).where(
    t.entry.c.rotor_id == bindparam("rotor"),
    t.entry.c.event_id.in_(bindparam("ids", expanding=True)),
)
_REPLACED = select(t.entry.c.event_id, t.entry.c.replaces).where(
    t.entry.c.rotor_id == bindparam("rotor"),
    t.entry.c.event_id.in_(bindparam("ids", expanding=True)),
)
_ADVANCE = (
    update(t.rotor).where(t.rotor.c.id == bindparam("rotor")).values(head_seq=bindparam("head"))
)
_FLIP = (
    update(t.cursor)
    .where(
        t.cursor.c.rotor_id == bindparam("rotor"),
        or_(t.cursor.c.dirty == false(), t.cursor.c.applied_seq == bindparam("head")),
    )
    .values(dirty=True, dirty_since=now_s())
    .returning(notified("bladetwin_work", ""))
)
# Of what overrules a reading nobody asks what it says.
_OVERRULING = select(
    *(literal("").label("body") if column.name == "body" else column for column in COLUMNS)
).where(t.entry.c.rotor_id == bindparam("rotor"))
# By the index of what is named: of most entries there is none; `seq + 0` keeps SQLite from going
# through all that came since.
_NAMED_SINCE = select(t.entry.c.replaces).where(
    t.entry.c.rotor_id == bindparam("rotor"),
    t.entry.c.replaces.is_not(None),
    t.entry.c.seq + 0 > bindparam("after"),
    t.entry.c.seq + 0 <= bindparam("through"),
)
_OVERRULES_EACH = _OVERRULING.where(t.entry.c.replaces.in_(bindparam("ids", expanding=True)))
_OVERRULES = _OVERRULING.where(among(t.entry.c.replaces, bindparam("ids", type_=Text())))
_APPEND = insert(t.entry).values(received_at=now_s())


class SqlLog:
    """The `Log` of one transaction.

    posted_by   what its entries keep of who posted them
    appended    the first and last sequence number that it gave, if any
    """

    def __init__(self, connection: Connection, posted_by: str | None = None) -> None:
        self._connection = connection
        self._posted_by = posted_by
        self.appended: tuple[int, int] | None = None

    def lock(self, rotor_id: str) -> int:
        head = lock_rotor(self._connection, rotor_id)
        if head is None:
            raise NotFoundError("rotor", rotor_id, "POST /v1/rotors creates it")
        return head

    def append(self, rotor_id: str, events: Sequence[NewEvent]) -> list[Appended]:
        """Append what is new; what is there with the same digest keeps its first place.

        ConflictError names an id that is there, or among them, with another digest: then nothing is
        written.
        """
        if len(events) == 1 and (answer := self.append_new(rotor_id, events[0])) is not None:
            return [answer]
        head = self.lock(rotor_id)
        known = self._known(rotor_id, [event.event_id for event in events])
        answers: list[Appended] = []
        others: list[str] = []
        twice: list[str] = []
        rows: list[dict[str, object]] = []
        for event in events:
            digest, seq = known.get(event.event_id, (None, 0))
            if digest is None:
                seq = head + len(rows) + 1
                known[event.event_id] = (event.digest, seq)
                row = {name: getattr(event, name) for name in NewEvent.__slots__}
                rows.append(row | {"rotor_id": rotor_id, "seq": seq})
            elif digest != event.digest:
                (others if seq <= head else twice).append(event.event_id)
            answers.append(Appended(event.event_id, seq, digest is None))
        if others:
            remedy = "choose a new id, or post a correction with `replaces`"
            raise ConflictError(events[0].kind, ", ".join(others), remedy)
        if twice:
            remedy, problem = "give each its own", "is given twice, with different content"
            raise ConflictError(events[0].kind, ", ".join(twice), remedy, problem)
        if rows:
            told = {"posted_by": self._posted_by, "traceparent": tracing.current()}
            self._connection.execute(_APPEND, [row | told for row in rows])
            self._connection.execute(_ADVANCE, {"rotor": rotor_id, "head": head + len(rows)})
            self._appended(rotor_id, head, head + len(rows))
        return answers

    def append_new(
        self, rotor_id: str, event: NewEvent, card: ModelCard | None = None
    ) -> Appended | None:
        """Append an entry in the shortest way; None: it is not to be had, and nothing is written.

        card   of the rotor's model; then its blade must be one of the rotor, too
        """
        if not self._postgres:
            return None
        head, seq = append_one(self._connection, rotor_id, event, self._posted_by, card)
        if head is None or seq is None:
            return None
        self._appended(rotor_id, head, seq)
        return Appended(event.event_id, seq, True)

    @property
    def _postgres(self) -> bool:
        return self._connection.dialect.name == "postgresql"

    def _known(self, rotor_id: str, ids: Sequence[str]) -> dict[str, tuple[str | None, int]]:
        rows = self._named(_KNOWN, rotor_id, ids)
        return {event_id: (digest, seq) for event_id, digest, seq in rows}

    def replaced(self, rotor_id: str, ids: Sequence[str]) -> dict[str, str | None]:
        """What each of these entries replaces; those that are not there are left out."""
        return dict(self._named(_REPLACED, rotor_id, ids))

    def _named(self, query: Select[Any], rotor_id: str, ids: Sequence[str]) -> Iterator[Any]:
        for start in range(0, len(ids), CHUNK):
            asked = {"rotor": rotor_id, "ids": ids[start : start + CHUNK]}
            yield from self._connection.execute(query, asked)

    def _appended(self, rotor_id: str, head: int, last: int) -> None:
        """Entries after `head` came: there is work; workers are woken when none was pending."""
        self.appended = (head + 1 if self.appended is None else self.appended[0], last)
        self._connection.execute(_FLIP, {"rotor": rotor_id, "head": head})

    def free(self, rotor_id: str) -> None:
        """Let a blocked or pausing rotor be tried again at once, and one whose version of an older
        algorithm was given up (`service.worker.older`)."""
        self.lock(rotor_id)
        c = t.cursor.c
        given_up = (c.dirty == false()) & (c.blocked == false()) & c.last_error.is_not(None)
        held = (c.rotor_id == rotor_id) & (
            (c.blocked == true()) | c.not_before.is_not(None) | given_up
        )
        error = case((given_up, None), else_=c.last_error)
        values = {"blocked": False, "attempts": 0, "not_before": None, "last_error": error}
        if self._connection.execute(update(t.cursor).where(held).values(**values)).rowcount:
            notify(self._connection, "bladetwin_work")

    def find(self, rotor_id: str, event_id: str) -> Event | None:
        query = select(*COLUMNS).where(
            t.entry.c.rotor_id == rotor_id, t.entry.c.event_id == event_id
        )
        row = self._connection.execute(query).one_or_none()
        return None if row is None else Event(**row._mapping)

    def page(
        self,
        rotor_id: str,
        kind: str,
        after: int | None,
        limit: int,
        blade: str | None = None,
        newest: bool = False,
        most_values: int | None = None,
    ) -> list[Event]:
        """Entries of a kind after a number, or with `newest` below it, the greatest first.

        most_values   readings with more of them come without, and with their ``count``
        """
        query = page_query(after is not None, blade is not None, newest, most_values)
        asked = {"rotor": rotor_id, "kind": kind, "after": after, "blade": blade, "most": limit}
        return events_of(self._connection.execute(query, asked).all())

    def changes(self, rotor_id: str, after: int, limit: int) -> list[Event]:
        asked = {"rotor": rotor_id, "after": after, "most": limit}
        return events_of(self._connection.execute(CHANGES, asked).all())

    def named_since(self, rotor_id: str, after: int, through: int) -> list[str]:
        asked = {"rotor": rotor_id, "after": after, "through": through}
        return sorted(set(self._connection.execute(_NAMED_SINCE, asked).scalars()))

    def overruled(self, rotor_id: str, ids: Sequence[str]) -> list[Event]:
        """Retractions and corrections of these inspections, and retractions of those; no bodies."""
        found: dict[str, Event] = {}
        wanted = list(ids)
        while wanted:
            rows = self._overruling(rotor_id, wanted[:CHUNK])
            fresh = [event for event in events_of(rows) if event.event_id not in found]
            found |= {event.event_id: event for event in fresh}
            wanted = wanted[CHUNK:] + [e.event_id for e in fresh if e.kind == "inspection"]
        return list(found.values())

    def _overruling(self, rotor_id: str, ids: Sequence[str]) -> Sequence[Row[Any]]:
        asked: dict[str, object] = {"rotor": rotor_id, "ids": ids}
        if self._connection.dialect.name == "sqlite":
            return self._connection.execute(_OVERRULES_EACH, asked).all()
        return self._connection.execute(_OVERRULES, asked | {"ids": json.dumps(ids)}).all()

    def entries(self, rotor_id: str, after: int, through: int, limit: int) -> list[Event]:
        """At most `limit` entries of every kind with after < seq <= through, in order."""
        return read_entries(self._connection, rotor_id, after, through, limit)

    def restore(self, rotor_id: str, events: Sequence[Event]) -> None:
        rows = [{name: getattr(e, name) for name in NAMES} | {"rotor_id": rotor_id} for e in events]
        if rows:
            self._connection.execute(insert(t.entry), rows)
