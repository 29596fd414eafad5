"""Logs: one JSON object a line on standard error.

Nothing secret is ever given to them; should a client put its key where keys do not belong (a path,
say), it is taken out of the line all the same. Lines that belong to a request carry its id, the
id of its key, and the numbers of the entries that it appended to its rotor's log.
"""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime

from service.tokens import redacted

_facts: ContextVar[dict[str, str] | None] = ContextVar("bladetwin_request", default=None)


@contextmanager
def request(request_id: str) -> Iterator[None]:
    """Inside, every line of this request, in whichever thread, carries its id."""
    token = _facts.set({"request_id": request_id})
    try:
        yield
    finally:
        _facts.reset(token)


def tell(**facts: str | None) -> None:
    """Let the lines of this request carry more; None: nothing to tell."""
    known = _facts.get()
    if known is not None:
        known |= {name: value for name, value in facts.items() if value is not None}


@contextmanager
def about(**facts: str) -> Iterator[None]:
    """Inside, every line of this thread carries these facts as well."""
    token = _facts.set({**(_facts.get() or {}), **facts})
    try:
        yield
    finally:
        _facts.reset(token)


class JsonLines(logging.Formatter):
    """A record as one line of JSON."""

    def format(self, record: logging.LogRecord) -> str:
        at = datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds")
        line = {
            "at": at,
            "level": record.levelname.lower(),
            "logger": record.name,
            "pid": record.process,
            "message": redacted(record.getMessage()),
        }
        line |= _facts.get() or {}
        if record.exc_info:
            line["error"] = redacted(self.formatException(record.exc_info))
        return json.dumps(line)


def configure_logs(level: str) -> None:
    """Log `level` and above of bladetwin, and warnings and above of everything else."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLines())
    logging.basicConfig(level=logging.WARNING, handlers=[handler], force=True)
    logging.getLogger("bladetwin").setLevel(level.upper())
