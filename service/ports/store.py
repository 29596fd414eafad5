"""One transaction of the store, by what it is about."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from contextlib import AbstractContextManager
from typing import Protocol

from service.access import Act, Answers, Audit, Keys
from service.hooks import Webhooks
from service.ports.glance import BladeReadings, Gauges, Operations
from service.ports.records import (
    Appended,
    BladeRecord,
    Event,
    JobRecord,
    NewEvent,
    Note,
    ResidualRecord,
    RotorRecord,
    Seen,
    StateRecord,
)
from service.ports.values import (
    Adopt,
    Diagnose,
    Get,
    Json,
    ModelCard,
)


class Records(Protocol):
    """Models, jobs, rotors and blades."""

    def put_model(self, card: ModelCard, source: Json, *, newest: bool = False) -> None:
        """Make a version known; `newest`: the one that new rotors get, though it was known."""
        ...

    def model_sources(self) -> list[tuple[ModelCard, Json]]:
        """Every version of every model, with where it comes from."""
        ...

    def model(self, model_id: str, version: str | None = None) -> ModelCard: ...
    def models(self, after: str, limit: int) -> list[ModelCard]: ...
    def put_job(
        self, job_id: str, kind: str, request: Json, rotor_id: str | None = None
    ) -> JobRecord: ...
    def job(self, job_id: str) -> JobRecord: ...
    def jobs_of(
        self, rotor_id: str, kind: str, before: str | None, limit: int
    ) -> list[JobRecord]: ...
    def unfinished(self, rotor_id: str, kind: str) -> list[JobRecord]: ...
    def residuals(self, rotor_id: str) -> ResidualRecord: ...
    def cancel_job(self, job_id: str) -> None: ...
    def put_rotor(self, rotor: RotorRecord, blades: Sequence[BladeRecord]) -> bool: ...
    def rotor(self, rotor_id: str) -> RotorRecord: ...
    def put_policy(self, rotor_id: str, adopt: Adopt, diagnose: Diagnose) -> None:
        """What the rotor does by itself from now on; residuals that stand are judged under it."""
        ...

    def standing(self, rotor_id: str) -> tuple[RotorRecord, str | None]:
        """A rotor, and the digest of its newest version without looking into it."""
        ...

    def rotors(
        self, after: str, limit: int, only: Sequence[str] | None = None
    ) -> list[RotorRecord]: ...
    def blades(self, rotor_id: str) -> list[BladeRecord]: ...
    def blade_ids(self, rotor_id: str, among: Collection[str] | None = None) -> set[str]: ...
    def covering(self, rotor_id: str, among: Collection[str]) -> tuple[ModelCard, set[str]]: ...
    def blade(self, rotor_id: str, blade_id: str) -> BladeRecord | None: ...
    def put_blade(self, rotor_id: str, blade: BladeRecord) -> None: ...
    def retire_blade(self, rotor_id: str, blade_id: str, seq: int) -> None: ...


class Log(Protocol):
    """The inspection log, which is the queue."""

    def lock(self, rotor_id: str) -> int: ...
    def append(self, rotor_id: str, events: Sequence[NewEvent]) -> list[Appended]: ...
    def append_new(
        self, rotor_id: str, event: NewEvent, card: ModelCard | None = None
    ) -> Appended | None: ...
    def free(self, rotor_id: str) -> None: ...
    def find(self, rotor_id: str, event_id: str) -> Event | None: ...
    def page(
        self,
        rotor_id: str,
        kind: str,
        after: int | None,
        limit: int,
        blade: str | None = None,
        newest: bool = False,
        most_values: int | None = None,
    ) -> list[Event]:
        """Entries of a kind; readings with more than `most_values` without them (``count``)."""
        ...

    def changes(self, rotor_id: str, after: int, limit: int) -> list[Event]:
        """Entries after one that adopt effects or back them out (`service.adopted`)."""
        ...

    def overruled(self, rotor_id: str, ids: Sequence[str]) -> list[Event]:
        """What retracts or corrects these readings, and what retracts that; without bodies."""
        ...

    def named_since(self, rotor_id: str, after: int, through: int) -> list[str]:
        """What entries with after < seq <= through retract or correct."""
        ...

    def replaced(self, rotor_id: str, ids: Sequence[str]) -> dict[str, str | None]:
        """What each of these entries replaces; those that are not there are left out."""
        ...

    def entries(self, rotor_id: str, after: int, through: int, limit: int) -> list[Event]: ...
    def restore(self, rotor_id: str, events: Sequence[Event]) -> None:
        """Append entries of another database to a new rotor, with their own numbers and times."""
        ...


class States(Protocol):
    """Versions of posteriors."""

    def get(self, rotor_id: str, version: int | None = None) -> StateRecord: ...
    def newest(self, rotor_id: str) -> tuple[int, str] | None:
        """Number and digest of the newest version, without looking into it."""
        ...

    def standing(self, rotor_ids: Sequence[str]) -> dict[str, tuple[bool, Json]]:
        """Whether the newest version of each rotor is sealed, and its account; not compared."""
        ...

    def page(self, rotor_id: str, before: int | None, limit: int) -> list[StateRecord]: ...
    def as_of(self, rotor_id: str, at: float) -> StateRecord:
        """The newest version of what was received by a moment (in `Store.read_as_of`)."""
        ...

    def reader(self, state: StateRecord) -> Get: ...


class Outbox(Protocol):
    """Notes of what was committed."""

    def after(self, rotor_id: str, number: int, limit: int) -> list[Note]:
        """Notes with a greater number, in order."""
        ...

    def newest(self, rotor_ids: Sequence[str]) -> dict[str, int]:
        """The number of the newest note of each rotor that has one."""
        ...

    def missing(self, rotor_id: str, number: int) -> bool:
        """Whether notes after this number are no longer kept, or it was never given."""
        ...

    def post(self, rotor_id: str, kind: str, payload: Json) -> None:
        """A note of what this transaction does, once the rotor is locked."""
        ...


class Blobs(Protocol):
    """Files by their SHA-256: uploaded runs, trained surrogates."""

    def put(self, data: bytes) -> str: ...
    def has(self, name: str) -> bool: ...
    def get(self, name: str) -> bytes: ...
    def drop(self, name: str) -> None: ...


class Transaction(Protocol):
    """One transaction: all of it is written, or nothing."""

    @property
    def records(self) -> Records: ...
    @property
    def log(self) -> Log: ...
    @property
    def states(self) -> States: ...
    @property
    def keys(self) -> Keys: ...
    @property
    def audit(self) -> Audit: ...
    @property
    def answers(self) -> Answers: ...
    @property
    def outbox(self) -> Outbox: ...
    @property
    def webhooks(self) -> Webhooks: ...
    @property
    def blobs(self) -> Blobs: ...
    def gauges(self, superseded: Sequence[str]) -> Gauges: ...
    def blade_readings(self, rotor_id: str, through: int) -> dict[str, BladeReadings]:
        """By blade, what the entries up to `through` say of its readings."""
        ...

    def check_rotor(self, rotor: RotorRecord, blades: Sequence[BladeRecord]) -> None:
        """DamagedRotorError: the rotor's row, or one of its blades', is not what was written."""
        ...

    def seen(self, rotor_id: str) -> Seen:
        """The rotor as it stands, with all of its blades."""
        ...

    def seen_with(self, rotor_id: str, blade: str | None) -> Seen:
        """The same with one blade, if the rotor has it, or none."""
        ...

    def operations(self, limit: int, superseded: Sequence[str]) -> Operations: ...


Guard = Callable[[Transaction], None]


class Store(Protocol):
    """Opens transactions."""

    def read(self) -> AbstractContextManager[Transaction]: ...
    def read_as_of(self, rotor_id: str, at: float) -> AbstractContextManager[Transaction]:
        """A reading transaction in which what a rotor received by a moment is all there."""
        ...

    def write(self) -> AbstractContextManager[Transaction]: ...
    def acting_for(self, act: Act, guard: Guard | None = None) -> Store:
        """The store for one state-changing request.

        Its writing transactions begin with the guard, which raises where they must not go on, and
        end with the request's row of the audit trail.
        """
        ...

    def others_ended(self, patience_s: float) -> bool:
        """Wait until every transaction that writes now has ended; false: not in time."""
        ...

    def met(self, rotor_id: str, blade: str) -> ModelCard | None:
        """The card of a rotor that is known to have this blade; None: it is to be asked for, or
        asking costs nothing. What is appended by it is held against the database (`append_new`)."""
        ...

    def arrays(self, rotor_id: str, version: int) -> Get:
        """A lazy reader of a version's arrays, each in a short transaction of its own.

        What takes long reads so: no snapshot is held while it computes. GoneError where the version
        is thinned out meanwhile.
        """
        ...
