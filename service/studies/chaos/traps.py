"""Points of a process at which it kills or stops itself.

They are named by what the process says to the database, through SQLAlchemy's own events, so that
nothing of it is in the service: a point is a statement, which may be a part of another one, and
whether it was just executed, its transaction is about to be committed, or was just committed.
``computed`` is the science's return.
"""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from sqlalchemy import Engine, event

from core.observation import Inspection
from service.fake import FakeState
from service.ports import ModelCard, RotorSpec
from service.studies.chaos.processes import Kind
from service.studies.chaos.twin import Descent

Moment = Literal["executed", "before COMMIT", "after COMMIT"]
NOTED = "bladetwin_trap"
CLAIM = r"UPDATE cursor SET (?=.*fence=)"
READ = r"SELECT .*FROM event"
ADVANCE = r"UPDATE cursor SET applied_seq="
STATE = r"INSERT INTO state "
ARRAYS = r"INSERT INTO state_array"
THIN = r"DELETE FROM state"
ENTRY = r"INSERT INTO event"


@dataclass(frozen=True, slots=True)
class Point:
    """The `count`-th time that a statement is at a moment; None: that the science returns."""

    moment: Moment
    statement: str | None
    count: int = 1


WORKER: dict[str, Point] = {
    "claim, before COMMIT": Point("before COMMIT", CLAIM),
    "claim, after COMMIT": Point("after COMMIT", CLAIM),
    "log read": Point("after COMMIT", READ),
    "computed": Point("executed", None),
    "cursor moved": Point("executed", ADVANCE),
    "version written": Point("executed", STATE),
    "arrays written": Point("executed", ARRAYS),
    "update, before COMMIT": Point("before COMMIT", ADVANCE),
    "update, after COMMIT": Point("after COMMIT", ADVANCE),
    "seal computed": Point("executed", None, 2),
    "seal, before COMMIT": Point("before COMMIT", ADVANCE, 2),
    "seal, after COMMIT": Point("after COMMIT", ADVANCE, 2),
}
API: dict[str, Point] = {
    "entry written": Point("executed", ENTRY),
    "post, before COMMIT": Point("before COMMIT", ENTRY),
    "post, after COMMIT, before the answer": Point("after COMMIT", ENTRY),
}


class Trap:
    """Sends this process a signal at a point."""

    def __init__(self, point: Point, number: int = signal.SIGKILL) -> None:
        self._point = point
        self._number = number
        self._left = point.count

    def spring(self) -> None:
        self._left -= 1
        if self._left == 0:
            os.kill(os.getpid(), self._number)

    def watch(self, engine: Engine) -> None:
        """Listen to what is said to the database."""
        if self._point.statement is None:
            return
        pattern = re.compile(self._point.statement, re.DOTALL)
        moment = self._point.moment

        def executed(connection: Any, _c: Any, statement: str, *_rest: Any) -> None:
            if pattern.search(statement):
                if moment == "executed":
                    self.spring()
                connection.info[NOTED] = True

        def commit(connection: Any) -> None:
            if moment == "before COMMIT" and connection.info.pop(NOTED, False):
                self.spring()

        def checkin(_connection: Any, record: Any) -> None:
            if record.info.pop(NOTED, False) and moment == "after COMMIT":
                self.spring()

        event.listen(engine, "after_cursor_execute", executed)
        event.listen(engine, "commit", commit)
        event.listen(engine, "checkin", checkin)


class Trapped(Descent):
    """The exact twin; `trap` springs whenever an update is computed."""

    trap: Trap | None = None

    def update(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        readings: Sequence[Inspection],
        previous: Any,
        *,
        quick: bool,
    ) -> FakeState:
        state = super().update(card, rotor, readings, previous, quick=quick)
        if Trapped.trap is not None:
            Trapped.trap.spring()
        return state


def main(kind: Kind, owner: str, point: Point, number: int, delay_s: float = 0.0) -> None:
    """An API or a worker that sends itself signal `number` at `point`."""
    import uvicorn

    from service.bootstrap import make_app, make_store, make_worker
    from service.settings import Settings
    from service.telemetry import configure_logs
    from service.worker.loop import run_worker

    settings = Settings.load()
    configure_logs(settings.log_level)
    store, trap = make_store(settings), Trap(point, number)
    science = Trapped(delay_s=delay_s, provisional=True)
    if kind == "api":
        app = make_app(store, science, settings)
        trap.watch(store.engine)
        uvicorn.run(app, host=settings.host, port=settings.port, log_config=None)
        return
    worker = make_worker(store, science, settings, owner, kind)
    worker.warm()
    trap.watch(store.engine)
    if point.statement is None:
        Trapped.trap = trap
    run_worker(worker)
