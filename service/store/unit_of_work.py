"""One transaction with all rooms of the store."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy import Connection, Engine

from service.ports import Array, Gauges, Get
from service.store.cache import ArrayCache, Checked
from service.store.engine import transaction
from service.store.gauges import read_gauges
from service.store.log import SqlLog
from service.store.outbox import SqlOutbox
from service.store.records import SqlRecords
from service.store.states import SqlStates


class SqlTransaction:
    """Models, rotors, log, states and notes of one connection's open transaction."""

    def __init__(self, connection: Connection, cache: ArrayCache, checked: Checked) -> None:
        self.connection = connection
        self.records = SqlRecords(connection)
        self.log = SqlLog(connection)
        self.states = SqlStates(connection, cache, checked)
        self.outbox = SqlOutbox(connection)

    def gauges(self) -> Gauges:
        return read_gauges(self.connection)


class SqlStore:
    """Opens transactions on one database."""

    def __init__(self, engine: Engine, cache_mb: float = 64.0) -> None:
        self.engine = engine
        self.cache = ArrayCache(cache_mb)
        self.checked = Checked()

    @contextmanager
    def read(self) -> Iterator[SqlTransaction]:
        with transaction(self.engine, write=False) as connection:
            yield SqlTransaction(connection, self.cache, self.checked)

    @contextmanager
    def write(self) -> Iterator[SqlTransaction]:
        with transaction(self.engine, write=True) as connection:
            yield SqlTransaction(connection, self.cache, self.checked)

    def arrays(self, rotor_id: str, version: int) -> Get:
        """A lazy reader of one version's arrays: what is not cached takes a short transaction."""

        def get(name: str) -> Array:
            key = (rotor_id, version, name)
            array = self.cache.get(key)
            if array is None:
                with self.read() as tx:
                    array = tx.states.array(key)
            return array

        return get

    def close(self) -> None:
        self.engine.dispose()
