"""How tests wait for what must come, on a machine that may be slow or busy with other work."""

from __future__ import annotations

import time
from collections.abc import Callable

from sqlalchemy import Engine, text

from service.store.engine import transaction

PATIENCE_S = 120.0
"""The limit only ends a test that hangs: what works takes a small part of it."""
AGES_S = 10 * PATIENCE_S
"""A wait that a test must not sit out: whoever does is told from the slowest machine by that."""
BEHIND_A_LOCK = text(
    "SELECT count(*) FROM pg_stat_activity"
    " WHERE datname = current_database() AND wait_event_type = 'Lock'"
)


def until(what: str, true: Callable[[], object], pause_s: float = 0.01) -> None:
    """Wait for something that must come."""
    end = time.monotonic() + PATIENCE_S
    while not true():
        assert time.monotonic() < end, f"{what} did not come"
        time.sleep(pause_s)


def behind_a_lock(engine: Engine) -> bool:
    """Whether somebody in this database of PostgreSQL waits for a lock."""
    with transaction(engine, write=False) as connection:
        return bool(connection.execute(BEHIND_A_LOCK).scalar_one())
