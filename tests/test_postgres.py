"""A database that a test left is, to the next one, as good as a new one."""

from __future__ import annotations

from threading import Event, Thread
from typing import Any

import pytest
from sqlalchemy import NullPool, create_engine, text
from sqlalchemy.exc import OperationalError

from service.fake import FakeScience
from service.handlers.models import register_builtins
from service.handlers.rotors import create_rotor
from service.ports import BladeRecord
from service.store.engine import open_engine
from service.store.schema import metadata
from service.store.unit_of_work import SqlStore
from tests.patience import PATIENCE_S
from tests.postgres import Databases


def contents(url: str) -> dict[str, Any]:
    """Every table's rows and every sequence's last value."""
    engine = open_engine(url)
    with engine.connect() as connection:
        rows = {
            name: [tuple(row) for row in connection.execute(text(f'SELECT * FROM "{name}"'))]
            for name in (*metadata.tables, "alembic_version")
        }
        sequences = connection.execute(
            text("SELECT sequencename, last_value FROM pg_sequences ORDER BY sequencename")
        )
        rows["sequences"] = [tuple(row) for row in sequences]
    engine.dispose()
    return rows


def use(url: str) -> SqlStore:
    """A store with a rotor in it; its connections are left open."""
    store = SqlStore(open_engine(url))
    register_builtins(store, FakeScience())
    create_rotor(store, "r1", "rotor-blade", [BladeRecord("B1")], 64, 7)
    return store


def test_what_a_test_left_is_emptied_and_found_by_nobody_who_knew_it(databases: Databases) -> None:
    first = databases.take()
    fresh = contents(databases.url(first))
    left = use(databases.url(first))
    assert contents(databases.url(first)) != fresh, "negative control"
    databases.give(first)
    second = databases.take()
    assert second != first
    assert contents(databases.url(second)) == fresh
    left.engine.dispose()  # as a process that goes on and connects again
    with pytest.raises(OperationalError, match="does not exist"), left.engine.connect():
        pass
    databases.give(second)


def test_whoever_connects_again_and_again_holds_nothing_up(databases: Databases) -> None:
    """A thread of a test that is over, for instance, that waits for news."""
    name, stop, turned_away = databases.take(), Event(), Event()
    engine = create_engine(databases.url(name), poolclass=NullPool)

    def again() -> None:
        while not stop.is_set():
            try:
                with engine.connect() as connection:
                    connection.execute(text("SELECT pg_sleep(60)"))
            except OperationalError as error:
                if "does not exist" in str(error):
                    turned_away.set()

    others = [Thread(target=again) for _ in range(4)]
    for other in others:
        other.start()
    databases.give(name)
    assert turned_away.wait(PATIENCE_S)
    stop.set()
    for other in others:
        other.join(PATIENCE_S)
    following = databases.take()
    assert following != name
    databases.give(following)


@pytest.mark.parametrize(
    "change",
    [
        "DROP INDEX {index}",
        "ALTER TABLE rotor ADD COLUMN more INTEGER",
        "CREATE TABLE more (id INTEGER)",
        "UPDATE alembic_version SET version_num = '0001'",
        "ALTER DATABASE {name} SET lock_timeout = '1s'",
    ],
)
def test_a_database_whose_shape_was_changed_is_not_taken_again(
    databases: Databases, change: str
) -> None:
    name = databases.take()
    index = sorted(one.name or "" for table in metadata.tables.values() for one in table.indexes)
    engine = create_engine(databases.url(name))
    with engine.begin() as connection:
        connection.execute(text(change.format(index=index[0], name=name)))
    engine.dispose()
    databases.give(name)
    with pytest.raises(OperationalError, match="does not exist"):
        create_engine(databases.url(name)).connect()
    following = databases.take()
    engine = create_engine(databases.url(following))
    with engine.connect() as connection:
        assert connection.execute(text("SHOW lock_timeout")).scalar() != "1s"
    engine.dispose()
    databases.give(following)
