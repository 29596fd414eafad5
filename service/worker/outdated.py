"""Whether a process's release may (still) run on the database, looked at now and then.

A newer release may migrate the database while this one's processes are at work. Where its migration
says that these may not go on, they rest: what they do not know they would take for damage.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from time import monotonic

log = logging.getLogger("bladetwin.worker")


class Outdated:
    """`remedy`: what is to be done before this release may run on the database; None: it may."""

    def __init__(self, remedy: Callable[[], str | None]) -> None:
        self._remedy = remedy
        self._look, self._is = -math.inf, False

    def now(self, every_s: float) -> bool:
        """It may not; the database is asked no more often than every so many seconds. The log says
        so when that begins. StoreAwayError: it does not answer."""
        if monotonic() >= self._look:
            do, before = self._remedy(), self._is
            self._look, self._is = monotonic() + every_s, do is not None
            if self._is and not before:
                log.error(
                    "this release may not run on the database; its worker rests. To mend it: %s.",
                    do,
                )
        return self._is
