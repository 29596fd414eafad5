"""Which arrays a version has: from those of a version before, the same as from all of them."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from sqlalchemy import event, insert, text

from service.errors import DamagedError
from service.store import tables as t
from service.store.named import digests, digests_since
from service.store.unit_of_work import SqlStore, SqlTransaction
from tests.service.test_store import _write as write


def rows(count: int, seed: int) -> Iterator[dict[str, Any]]:
    """Of twenty names each version changes some and ends some."""
    chosen = random.Random(seed)
    for version in range(1, count + 1):
        for name in range(20):
            if version == 1 or chosen.random() < 0.2:
                ended = version > 1 and chosen.random() < 0.2
                sha256 = "" if ended else f"{chosen.getrandbits(64):x}"
                row = {"rotor_id": "r1", "name": f"n{name}", "version": version, "sha256": sha256}
                yield row | {"encoding": "raw", "dtype": "<f8", "shape": "[]", "data": b""}


def test_from_a_version_before_they_are_those_of_all(store: SqlStore, rotor: str) -> None:
    with store.write() as tx:
        tx.connection.execute(insert(t.state_array), list(rows(12, 3)))
    with store.read() as tx:
        whole = [digests(tx.connection, rotor, version) for version in range(13)]
        for since in range(1, 13):
            for version in range(since, 13):
                after = digests_since(tx.connection, rotor, version, since, whole[since])
                assert after == whole[version]
    assert len({len(names) for names in whole}) > 3, "names ended, and came again"


@contextmanager
def whole_questions(store: SqlStore) -> Iterator[list[str]]:
    """The statements meanwhile that look at all names of a rotor."""
    found: list[str] = []

    def note(connection: Any, cursor: Any, statement: str, *rest: Any) -> None:
        if "state_array" in statement and "max(" in statement:
            found.append(statement)

    event.listen(store.engine, "before_cursor_execute", note)
    yield found
    event.remove(store.engine, "before_cursor_execute", note)


def test_of_a_new_version_only_what_changed_is_asked_for(store: SqlStore, rotor: str) -> None:
    write(store, 1, a=1.5, b=2.5)
    with store.read() as tx:
        tx.states.get(rotor)
    write(store, 2, b=3.5)
    reader = SqlStore(store.engine)
    reader.checked = store.checked
    with whole_questions(store) as found, reader.read() as tx:
        get = tx.states.reader(tx.states.get(rotor))
        assert (float(get("a")[0]), float(get("b")[0])) == (1.5, 3.5)
    assert found == []
    with whole_questions(store) as found, SqlStore(store.engine).read() as tx:
        tx.states.get(rotor)
    assert len(found) == 1, "the control: a process that has met no version"


DAMAGE = text("UPDATE state_array SET sha256 = 'x' WHERE name = :name AND version = :version")


@pytest.mark.parametrize(("name", "version"), [("a", 1), ("b", 2)])
def test_a_row_that_is_damaged_is_never_served(
    store: SqlStore, rotor: str, name: str, version: int
) -> None:
    """Neither one of before, which who has met that version looks at when it is read, nor a new
    one, nor either by a process that has met no version."""
    write(store, 1, a=1.5, b=2.5)
    with store.read() as tx:
        tx.states.get(rotor)
    write(store, 2, b=3.5)
    with store.write() as tx:
        tx.connection.execute(DAMAGE, {"name": name, "version": version})
    with store.read() as tx:
        with pytest.raises(DamagedError):
            read_array(tx, rotor, name)
        other = {"a": "b", "b": "a"}[name]
        if version == 1:
            assert read_array(tx, rotor, other) == 3.5
        else:
            with pytest.raises(DamagedError):
                read_array(tx, rotor, other)
    with SqlStore(store.engine).read() as tx, pytest.raises(DamagedError):
        tx.states.get(rotor)


def read_array(tx: SqlTransaction, rotor: str, name: str) -> float:
    return float(tx.states.reader(tx.states.get(rotor))(name)[0])
