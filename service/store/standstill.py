"""Every table of a PostgreSQL that is in use, for a migration.

A migration that takes tables one by one, as it changes them, meets whoever took them in another
order: each waits for the other, and PostgreSQL ends one of the two. So all tables are locked before
anything is changed. Only the first is waited for: nobody waits for who holds nothing yet. The
others have to be free within moments; one that is not is the first of the next attempt, when all
that was locked has been given back. So in a few attempts those tables come first that others take
first, `rotor` before all, whose row every writer locks.

PostgreSQL looks for deadlocks among those who waited for `deadlock_timeout`. An attempt that holds
a table ends before (`OTHERS` of it), so that no one who waits for a migration is ended for that.
Each fifth attempt waits longer for its first table: only then does PostgreSQL end an autovacuum
that is in the way.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import monotonic

from sqlalchemy import Connection, Engine, inspect, text
from sqlalchemy.exc import OperationalError

from service.store import access_tables, hook_tables  # noqa: F401  the whole schema
from service.store.engine import transaction
from service.store.schema import metadata
from service.store.tables import rotor

# Of deadlock_timeout: for the first table, mostly and each fifth time; for another one; for these.
SHORT, LONG, EACH, OTHERS = 0.5, 2.0, 0.05, 0.5
LONG_EVERY = 5
NOT_AVAILABLE = "55P03"
TIMEOUT = text("SELECT setting::double precision FROM pg_settings WHERE name = 'deadlock_timeout'")
OLDEST = text(
    "SELECT pid, backend_type, application_name,"
    " extract(epoch FROM clock_timestamp() - xact_start) AS seconds FROM pg_stat_activity"
    " WHERE datname = current_database() AND pid <> pg_backend_pid() AND xact_start IS NOT NULL"
    " ORDER BY xact_start LIMIT 3"
)


class InUseError(Exception):
    """A table was not to be had in time; the transaction has to be rolled back."""

    def __init__(self, table: str) -> None:
        self.table = table
        super().__init__(table)


def first_order() -> list[str]:
    """Our tables as a first attempt takes them."""
    return [rotor.name, *sorted(set(metadata.tables) - {rotor.name})]


def lock_all(connection: Connection, order: Sequence[str], attempt: int) -> None:
    """Lock those tables that are there against all others, until the transaction ends.

    attempt   counted from 1

    InUseError names the table that is to be the first next time.
    """
    timeout_s = 1e-3 * float(connection.execute(TIMEOUT).scalar_one())
    there = set(inspect(connection).get_table_names())
    wait_s = timeout_s * (SHORT if attempt % LONG_EVERY else LONG)
    end = None
    for name in order:
        if name not in there:
            continue
        _lock(connection, name, wait_s)
        end = monotonic() + OTHERS * timeout_s if end is None else end
        wait_s = min(EACH * timeout_s, end - monotonic())
    connection.execute(text("SET LOCAL lock_timeout = 0"))


def _lock(connection: Connection, name: str, most_s: float) -> None:
    connection.execute(text(f"SET LOCAL lock_timeout = {max(1, round(1e3 * most_s))}"))
    try:
        connection.execute(text(f'LOCK TABLE "{name}" IN ACCESS EXCLUSIVE MODE'))
    except OperationalError as error:
        if getattr(error.orig, "sqlstate", None) == NOT_AVAILABLE:
            raise InUseError(name) from error
        raise


def in_the_way(engine: Engine) -> str:
    """A sentence on the transactions that have been under way for longest."""
    with transaction(engine, write=False) as connection:
        rows = connection.execute(OLDEST).all()
    told = [
        f"process {row.pid} ({row.application_name or row.backend_type}) for {row.seconds:.0f} s"
        for row in rows
    ]
    if not told:
        return "No transaction is under way now."
    return f"Transactions that are under way: {', '.join(told)}."
