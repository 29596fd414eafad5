"""Whether a job is still wanted, asked while a step of it computes.

A step of a diagnosis may take half a minute, and writes its progress before it begins. Within it
the science calls `Heed` every few seconds of work at most (`core.calibration.workspace`): where the
worker is to end, or the job was cancelled or taken over, the step ends there, and so the next one
does not wait for it.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from time import monotonic

from sqlalchemy import Engine

from core.errors import BladetwinError
from service.errors import StoreAwayError
from service.worker.job_lease import JobLease, still_holds

ASK_S = 1.0  # between two questions to the database


class StoppedError(BladetwinError):
    """The worker is to end: the job goes back as if it had not been begun."""


@dataclass
class Heed:
    """Called within the steps of a job. `stopping` says that the worker is to end.

    Raises StoppedError where it is; LostLeaseError where the job is the worker's no more.
    """

    engine: Engine
    lease: JobLease
    stopping: Callable[[], bool]
    _asked: float = field(default_factory=monotonic)

    def __call__(self) -> None:
        if self.stopping():
            raise StoppedError(f"job {self.lease.id} goes back: its worker ends")
        if monotonic() - self._asked >= ASK_S:
            with suppress(StoreAwayError):
                still_holds(self.engine, self.lease)
            self._asked = monotonic()
