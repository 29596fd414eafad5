"""Entries of the log as the science knows them, and whether one is what was written."""

from __future__ import annotations

import json
from collections.abc import Sequence
from hashlib import sha256
from sys import intern
from typing import Any

from core.errors import CalibrationError
from core.observation import Entry, Inspection
from service.adopted import KINDS
from service.ports import Event

READINGS, BLADES = ("inspection", "retraction"), ("blade", "retirement")
KNOWN = frozenset((*READINGS, *BLADES, *KINDS))


def entry_of(event: Event) -> Entry:
    """The log's row as the science knows it; CalibrationError: it is not what was written."""
    if event.kind == "inspection":
        try:
            reading = Inspection.from_json(_shared(json.loads(event.body)))
            found = reading.digest()
        except (ValueError, TypeError, KeyError) as error:
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
    """What in an entry does not agree with its digest or its own columns; None: nothing."""
    try:
        if event.kind == "inspection":
            reading = Inspection.from_json(json.loads(event.body))
            digest = reading.digest()
            columns = (reading.id, reading.replaces, reading.blade, float(reading.time_h))
            if columns != (event.event_id, event.replaces, event.blade, event.time_h):
                return "its body and its columns name another id, blade, time or reading replaced"
        elif event.kind == "retraction" or event.kind in BLADES:
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
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        return f"its body cannot be read: {type(error).__name__}: {error}"
    if digest != event.digest:
        return f"its body has digest {digest[:12]}…, written was {event.digest[:12]}…"
    return None
