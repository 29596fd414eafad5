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


class Reader:
    """Reads a stream line by line."""

    def __init__(self) -> None:
        self._told: dict[str, str] = {}

    def line(self, line: str) -> dict[str, Any] | None:
        """The event that this line ends: its data, with ``id`` and ``event``; None: none."""
        if line != "":
            name, _, value = line.partition(":")
            if name:
                self._told[name] = value.removeprefix(" ")
            return None
        told, self._told = self._told, {}
        if "data" not in told:
            return None
        number = {"id": int(told["id"])} if "id" in told else {}
        return {**json.loads(told["data"]), **number, "event": told.get("event", "message")}


def events(lines: Iterable[str]) -> Iterator[dict[str, Any]]:
    """The events of a stream of lines.

    >>> list(events(["id: 7", "event: applied", 'data: {"version": 3}', "", ": alive", ""]))
    [{'version': 3, 'id': 7, 'event': 'applied'}]
    """
    reader = Reader()
    return (event for line in lines if (event := reader.line(line)) is not None)
