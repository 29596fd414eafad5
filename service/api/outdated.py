"""Posts to a database that a newer release has migrated, on which this one may not go on.

Its workers rest then (`service.worker.outdated`) and `/readyz` says 503, but whoever posts may not
ask that: a reading would be written in a form that the newer release no longer reads, and be
answered as if it were kept. It is refused, and whoever tries again reaches the newer release.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from time import monotonic

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse

from service.api.problems import fault, problem

LOOK_S = 1.0  # how often the database is asked, at most
RETRY_S = 5


class Outdated:
    """`schema`: the database's revision, and what to do where this release may not run on it."""

    def __init__(self, schema: Callable[[], tuple[str | None, str | None]]) -> None:
        self._schema = schema
        self._look = -math.inf
        self._found: tuple[str | None, str | None] = (None, None)

    async def refusal(self, request: Request) -> JSONResponse | None:
        """The answer to a request that would change the database; None: it may."""
        if monotonic() >= self._look:
            self._look = monotonic() + LOOK_S  # the others go by what was found before
            self._found = await run_in_threadpool(self._schema)
        revision, remedy = self._found
        if remedy is None:
            return None
        told = "is not one that this release may write to; nothing was done"
        detail = f"the database's schema {revision} {told}. To mend it: {remedy}."
        faults = [fault("schema", revision, told, remedy)]
        return problem(request, 503, "outdated", detail, faults, {"Retry-After": str(RETRY_S)})
