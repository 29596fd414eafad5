"""One transaction with all rooms of the store."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from copy import copy

from sqlalchemy import Connection, Engine

from service.access import EXPECTED, Act
from service.ports import (
    Array,
    BladeReadings,
    BladeRecord,
    Gauges,
    Get,
    Guard,
    ModelCard,
    Operations,
    RotorRecord,
    Seen,
)
from service.store import creation
from service.store.answers import SqlAnswers
from service.store.blobs import SqlBlobs
from service.store.cache import ArrayCache, Checked, Compared, Sound
from service.store.engine import is_sqlite, transaction
from service.store.gauges import read_gauges
from service.store.glance import read_blade_readings, read_operations
from service.store.keys import SqlKeys
from service.store.log import SqlLog
from service.store.met import Met
from service.store.outbox import SqlOutbox
from service.store.records import SqlRecords
from service.store.seen import Looks
from service.store.settled import ended, settled
from service.store.states import SqlStates
from service.store.trail import SqlAudit
from service.store.webhooks import SqlWebhooks
from service.store.whole import Whole, sound_rotor
from service.telemetry import tell


class SqlTransaction:
    """Models, rotors, log, states, notes, keys and trail of one connection's open transaction."""

    def __init__(
        self,
        connection: Connection,
        cache: ArrayCache,
        checked: Checked,
        sound: Sound,
        posted_by: str | None = None,
        settled: float = 0.0,
        met: Met | None = None,
        compared: Compared | None = None,
    ) -> None:
        self.connection = connection
        self._sound = sound
        self._compared = compared
        self.records = SqlRecords(connection, met)
        self.log = SqlLog(connection, posted_by)
        self.states = SqlStates(connection, cache, checked, settled)
        self._looks = Looks(connection, self.records, self.states, sound)
        self.outbox = SqlOutbox(connection)
        self.keys = SqlKeys(connection)
        self.audit = SqlAudit(connection)
        self.answers = SqlAnswers(connection)
        self.webhooks = SqlWebhooks(connection)
        self.blobs = SqlBlobs(connection)

    def gauges(self, superseded: Sequence[str]) -> Gauges:
        return read_gauges(self.connection, superseded)

    def blade_readings(self, rotor_id: str, through: int) -> dict[str, BladeReadings]:
        return read_blade_readings(self.connection, rotor_id, through)

    def check_rotor(self, rotor: RotorRecord, blades: Sequence[BladeRecord]) -> None:
        creation.check(self.connection, rotor, blades, self._sound)

    def seen(self, rotor_id: str) -> Seen:
        return self._looks.whole(rotor_id)

    def seen_with(self, rotor_id: str, blade: str | None) -> Seen:
        return self._looks.with_blade(rotor_id, blade)

    def sound_rotor(self, rotor_id: str, seq: int, version: int) -> Whole:
        return sound_rotor(self.connection, rotor_id, seq, version, self._compared)

    def sound_blades(self, rotor: RotorRecord) -> list[BladeRecord]:
        return creation.sound_blades(self.connection, rotor, self._compared)

    def operations(self, limit: int, superseded: Sequence[str]) -> Operations:
        return read_operations(self.connection, limit, superseded)


class SqlStore:
    """Opens transactions on one database."""

    def __init__(self, engine: Engine, cache_mb: float = 64.0) -> None:
        self.engine = engine
        self.cache = ArrayCache(cache_mb)
        self.checked = Checked()
        self.sound = Sound()
        self.compared = Compared()
        self._met = Met()
        self._act: Act | None = None
        self._guard: Guard | None = None

    def acting_for(self, act: Act, guard: Guard | None = None) -> SqlStore:
        """The same database and cache for one state-changing request (`service.ports.Store`)."""
        other = copy(self)
        other._act, other._guard = act, guard
        return other

    def _opened(
        self, connection: Connection, posted_by: str | None = None, settled: float = 0.0
    ) -> SqlTransaction:
        kept = (self.cache, self.checked, self.sound)
        return SqlTransaction(connection, *kept, posted_by, settled, self._met, self.compared)

    @contextmanager
    def read(self) -> Iterator[SqlTransaction]:
        with transaction(self.engine, write=False) as connection:
            yield self._opened(connection)

    @contextmanager
    def read_as_of(self, rotor_id: str, at: float) -> Iterator[SqlTransaction]:
        until = settled(self.engine, rotor_id, at)
        with transaction(self.engine, write=False) as connection:
            yield self._opened(connection, settled=until)

    @contextmanager
    def write(self) -> Iterator[SqlTransaction]:
        act, row = self._act, None
        with transaction(self.engine, write=True) as connection:
            poster = None if act is None else act.poster
            tx = self._opened(connection, poster)
            if self._guard is not None:
                self._guard(tx)
            yield tx
            if act is not None and act.row is None:
                row = tx.audit.note(act, EXPECTED, entries=tx.log.appended)
        if tx.log.appended is not None:
            tell(entries="{}-{}".format(*tx.log.appended))
        if act is not None and row is not None:
            act.row = row

    def others_ended(self, patience_s: float) -> bool:
        return ended(self.engine, patience_s)

    def met(self, rotor_id: str, blade: str) -> ModelCard | None:
        """On PostgreSQL, where each question is a message (`service.ports.Store`)."""
        return None if is_sqlite(self.engine) else self._met.card_of(rotor_id, blade)

    def blob(self, name: str) -> bytes:
        """A stored file by its SHA-256, in a transaction of its own."""
        with self.read() as tx:
            return tx.blobs.get(name)

    def arrays(self, rotor_id: str, version: int) -> Get:
        """A lazy reader of one version's arrays: what is not cached takes a short transaction."""
        names = self.checked.get(rotor_id, version)

        def get(name: str) -> Array:
            key = (rotor_id, version, name)
            array = None if names is None else self.cache.get((*key, names.get(name)))
            if array is None:
                with self.read() as tx:
                    array = tx.states.array(key, names)
            return array

        return get

    def close(self) -> None:
        self.engine.dispose()
