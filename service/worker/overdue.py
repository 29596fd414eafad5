"""A process that ends where its work takes too long.

Nothing in the science asks whether it is to stop, and what hangs in it may hold the interpreter's
lock, so that no thread of Python's runs any more: neither heartbeats nor a signal's handler. A
thread of the C library's (`faulthandler`) waits beside it, writes where each thread stands to
standard error, and ends the process. The lease is not given back, so that the attempt counts, as
that of a worker that died by itself.
"""

from __future__ import annotations

import faulthandler
import logging
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext

from service.worker.heartbeat import Deadline

log = logging.getLogger("bladetwin.worker")
STDERR = 2
LATER_S = 1.0  # than the last heartbeat, whose line in the log names the rotor
Bound = Callable[[float], AbstractContextManager[None]]


def endless(seconds: float) -> AbstractContextManager[None]:
    """No bound: of a worker that shares its process with others."""
    return nullcontext()


@contextmanager
def ends_process(seconds: float) -> Iterator[None]:
    """End this process with status 1 where the block takes longer; one block at a time."""
    faulthandler.dump_traceback_later(seconds + LATER_S, exit=True, file=STDERR)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()


def hangs(what: str, deadline: Deadline) -> None:
    """Say so of work one step of which is overdue."""
    log.error(
        "%s: a step has taken longer than BLADETWIN_STEP_MAX_S = %g s; the lease is prolonged no "
        "more, and it counts as a death",
        what,
        deadline.seconds,
    )


class Steps:
    """Work of many steps, none of which may take longer: `next` begins one."""

    def __init__(self, seconds: float, bound: Bound) -> None:
        self.deadline = Deadline(seconds)
        self._bound, self._stack = bound, ExitStack()

    def next(self) -> None:
        self._stack.close()
        self.deadline.again()
        self._stack.enter_context(self._bound(self.deadline.seconds))

    def __enter__(self) -> Steps:
        self.next()
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()
