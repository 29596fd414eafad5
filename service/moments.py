"""Moments as people and programs write them: ISO 8601 with an offset."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import overload

LAST_S = 253402300799.0  # 9999-12-31T23:59:59Z: no later moment can be written


@overload
def moment(seconds: float) -> str: ...
@overload
def moment(seconds: None) -> None: ...
@overload
def moment(seconds: float | None) -> str | None: ...
def moment(seconds: float | None) -> str | None:
    """Seconds since 1970 as ISO 8601.

    >>> moment(86400.25)
    '1970-01-02T00:00:00.250Z'
    """
    if seconds is None:
        return None
    text = datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")
    return text.replace("+00:00", "Z")


class OutsideError(ValueError):
    """A moment before 1970 or after 9999."""


def seconds_of(text: str) -> float:
    """A moment as seconds since 1970; ValueError without an offset, OutsideError before 1970
    or after 9999.

    >>> seconds_of("1970-01-02T01:00:00.250+01:00")
    86400.25
    """
    at = datetime.fromisoformat(text)
    if at.tzinfo is None:
        raise ValueError("a moment needs its offset, e.g. 2031-05-04T10:00:00Z")
    seconds = at.timestamp()
    if seconds < 0:
        raise OutsideError("lies before 1970, when no log had begun")
    if seconds > LAST_S:
        raise OutsideError("lies after 9999")
    return seconds
