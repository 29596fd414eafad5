"""What the main thread computes, ended by a signal.

A sealing is one call of the science, up to half a minute long, and nothing in it asks whether the
worker is to end. Python runs a signal's handler in the main thread, between two steps of what
computes there; so the handler can raise out of it, and what was claimed goes back unused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager


class Interrupted(BaseException):
    """The worker is to end. No `Exception`: it is never taken for a failure of the computing."""


class Interrupt:
    """Raises Interrupted out of blocks that allow it. `stopping` says that the worker is to end."""

    def __init__(self, stopping: Callable[[], bool]) -> None:
        self._stopping = stopping
        self._allowed = False

    @contextmanager
    def allowed(self) -> Iterator[None]:
        """A block of the main thread, without transactions that write, that may end at any step."""
        self._allowed = True
        try:
            if self._stopping():
                raise Interrupted
            yield
        finally:
            self._allowed = False

    def __call__(self) -> None:
        """Called by a signal's handler: end the block that runs; outside of one nothing happens."""
        if self._allowed:
            self._allowed = False  # a second signal finds the first one at its work
            raise Interrupted
