"""Server-sent events as text: written and read (HTML standard, section 9.2).

A frame is a few ``name: value`` lines and an empty one; a line that begins with a colon is a
comment, which keeps a silent connection alive.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import Any

HEARTBEAT = ": alive\n\n"


def frame(event: str, data: dict[str, Any], number: int | None = None) -> str:
    """One event; `number` becomes its id, from which a client goes on.

    >>> frame("applied", {"version": 3}, 7)
    'id: 7\\nevent: applied\\ndata: {"version": 3}\\n\\n'
    """
    head = "" if number is None else f"id: {number}\n"
    return f"{head}event: {event}\ndata: {json.dumps(data)}\n\n"


def events(lines: Iterable[str]) -> Iterator[dict[str, Any]]:
    """The events of a stream of lines: their data, with ``id`` and ``event``.

    >>> list(events(["id: 7", "event: applied", 'data: {"version": 3}', "", ": alive", ""]))
    [{'version': 3, 'id': 7, 'event': 'applied'}]
    """
    told: dict[str, str] = {}
    for line in lines:
        if line == "":
            if "data" in told:
                number = {"id": int(told["id"])} if "id" in told else {}
                yield {**json.loads(told["data"]), **number, "event": told.get("event", "message")}
            told = {}
            continue
        name, _, value = line.partition(":")
        if name:
            told[name] = value.removeprefix(" ")
