"""Entries of the log as the science knows them, and whether one is what was written."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import lru_cache
from hashlib import sha256
from sys import intern
from typing import Any

from core.errors import CalibrationError
from core.log import Entry
from core.observation import Inspection
from service.adopted import KINDS
from service.ports import Event

READINGS, BLADES = ("inspection", "retraction"), ("blade", "retirement")
UNREADABLE = (
    *(ValueError, TypeError, KeyError, AttributeError),
    *(IndexError, OverflowError, RecursionError),
)
"""What reading a body raises whose fields have other types than were written, or none at all."""
SHORT = 1024  # characters of a body
KNOWN = frozenset((*READINGS, *BLADES, *KINDS))


def entry_of(event: Event) -> Entry:
    """The log's row as the science knows it; CalibrationError: it is not what was written."""
    if event.kind == "inspection":
        try:
            reading = Inspection.from_json(_shared(json.loads(event.body)))
            found = reading.digest()
        except UNREADABLE as error:
            found = f"unreadable: {error}"
        if found != event.digest:
            raise CalibrationError(
                f"entry {event.seq} of the log, {event.event_id}, is damaged ({found[:60]}). To "
                "mend it: restore the database, or import the rotor from an exported file.",
                event=event.event_id,
            )
        target = reading.id if reading.id == event.event_id else event.event_id  # one string
        return Entry(event.seq, "inspection", target, reading)
    return Entry(event.seq, "retraction", event.replaces or "")


def _shared(body: dict[str, Any]) -> dict[str, Any]:
    """The same, with words that many readings have in common held once in memory."""
    for name in ("blade", "quantity", "unit", "instrument", "campaign"):
        if name in body:
            body[name] = intern(body[name])
    return body


def entries_of(events: Sequence[Event]) -> list[Entry]:
    """Those of the log's rows that concern readings.

    CalibrationError: one is of a kind that this release does not know. A newer release wrote it,
    and a posterior without it would be another one.
    """
    for event in events:
        if event.kind not in KNOWN:
            raise CalibrationError(
                f"entry {event.seq} of the log, {event.event_id}, cannot be used: "
                f"{_stranger(event)}. To mend it: upgrade this worker, and retry the rotor where "
                "it is blocked by then.",
                event=event.event_id,
            )
    return [entry_of(e) for e in events if e.kind in READINGS]


def _stranger(event: Event) -> str:
    return f"its kind, {event.kind!r}, is none that this release knows"


def body_problem(event: Event) -> str | None:
    """What in an entry does not agree with its digest or its own columns; None: nothing.

    Of a short reading, what was found of the very same text and columns is remembered.
    """
    if event.kind != "inspection":
        return _compared(event)
    told = (event.event_id, event.replaces, event.blade, event.time_h)
    compared = _reading if len(event.body) <= SHORT else _reading.__wrapped__
    return compared(event.body, told, event.digest)


@lru_cache(maxsize=8192)
def _reading(
    body: str, columns: tuple[str, str | None, str | None, float | None], written: str
) -> str | None:
    try:
        reading = Inspection.from_json(json.loads(body))
        if (reading.id, reading.replaces, reading.blade, float(reading.time_h)) != columns:
            return "its body and its columns name another id, blade, time or reading replaced"
        return _other(reading.digest(), written)
    except UNREADABLE as error:
        return f"its body cannot be read: {type(error).__name__}: {error}"


def _compared(event: Event) -> str | None:
    """`body_problem` of what is no reading."""
    try:
        if event.kind == "retraction" or event.kind in BLADES:
            digest = sha256(event.body.encode()).hexdigest()
            named = event.replaces if event.kind == "retraction" else event.blade
            if event.event_id != f"{event.kind}/{named}":
                return f"it is called {event.event_id!r} and names {named!r}"
        elif event.kind in KINDS:
            digest = sha256(event.body.encode()).hexdigest()
            if event.event_id != f"{event.kind}/{json.loads(event.body)['number']}":
                return f"it is called {event.event_id!r}, its body says otherwise"
        else:
            return _stranger(event)
    except UNREADABLE as error:
        return f"its body cannot be read: {type(error).__name__}: {error}"
    return _other(digest, event.digest)


def _other(digest: str, written: str) -> str | None:
    if digest == written:
        return None
    return f"its body has digest {digest[:12]}…, written was {written[:12]}…"
