"""A database clock that can be set: leases know no other (`service.store.engine.now_s`)."""

from __future__ import annotations

from typing import Any

from sqlalchemy import Engine, event

from core.errors import BladetwinError
from service.store.engine import is_sqlite

ASKED = {True: "julianday('now')", False: "clock_timestamp()"}
GIVEN = {
    True: "julianday('now', '{:+.3f} seconds')",
    False: "(clock_timestamp() + interval '{:+.3f} seconds')",
}


class Clock:
    """`ahead` seconds are added to whatever one engine is told of the time."""

    def __init__(self, engine: Engine) -> None:
        self.ahead = 0.0
        self.asked = 0
        self._sqlite = is_sqlite(engine)
        event.listen(engine, "before_cursor_execute", self._set, retval=True)

    def _set(self, _c: Any, _cursor: Any, statement: str, parameters: Any, *_: Any) -> Any:
        clock = ASKED[self._sqlite]
        if clock in statement:
            self.asked += 1
            statement = statement.replace(clock, GIVEN[self._sqlite].format(self.ahead))
        elif "CURRENT_TIMESTAMP" in statement.upper() or "NOW()" in statement.upper():
            raise BladetwinError(f"a clock that this one does not know: {statement[:200]}")
        return statement, parameters
