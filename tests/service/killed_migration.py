"""Migrates a database again and again, killed at the 1st, 2nd, … statement, then to the end.

killed_migration.py URL HOW      HOW: whole | halves (a mutant that commits after each statement)

Prints one JSON object: how many statements there are, and after which of them the schema was
neither that of before nor that of the end.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from typing import Any

from sqlalchemy import event, inspect

from service.store.engine import is_sqlite, open_engine, transaction
from service.store.migrate import current, migrate


def schema(url: str) -> Any:
    """Revision, and every table with its columns and indices."""
    engine = open_engine(url)
    with transaction(engine, write=False) as connection:
        seen = inspect(connection)
        columns, indexes = seen.get_multi_columns(), seen.get_multi_indexes()
        tables = {
            str(table): [
                sorted(column["name"] for column in own),
                sorted(str(index["name"]) for index in indexes.get(table, [])),
            ]
            for table, own in columns.items()
        }
    found = [current(engine), tables]
    engine.dispose()
    return found


def attempt(url: str, number: int, *, halves: bool) -> None:
    """Migrate, and die by SIGKILL right after the statement of that number."""
    engine = open_engine(url)
    count = 0

    @event.listens_for(engine, "after_cursor_execute")
    def after(connection: Any, cursor: Any, statement: str, *rest: Any) -> None:
        nonlocal count
        count += 1
        if halves and statement.lstrip().split()[0] in ("CREATE", "ALTER", "INSERT", "UPDATE"):
            other = connection.connection.cursor()
            other.execute("COMMIT")
            other.execute("BEGIN IMMEDIATE" if is_sqlite(engine) else "BEGIN")
            other.close()
        if count == number:
            os.kill(os.getpid(), signal.SIGKILL)

    migrate(engine)


def main(url: str, how: str) -> None:
    before = schema(url)
    torn: list[int] = []
    number = 0
    while True:
        number += 1
        child = os.fork()
        if child == 0:
            try:
                attempt(url, number, halves=how == "halves")
            except BaseException:
                os._exit(3)
            os._exit(0)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        if code != -signal.SIGKILL:
            break
        if schema(url) != before:
            torn.append(number)
            break
    print(json.dumps({"statements": number - 1, "torn": torn, "code": code, "end": schema(url)}))


if __name__ == "__main__":
    main(*sys.argv[1:])
