"""Services with one rule taken away, each of which the machine has to notice."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy import ColumnElement, and_, false, select

from service.adopted import Adopted, adopted_at
from service.ports import Event, ModelCard, Note, RotorRecord, StateRecord, Transaction, Which
from service.store import tables as t
from service.store.hook_tables import delivery
from service.store.log import SqlLog
from service.store.outbox import SqlOutbox
from service.store.records import SqlRecords
from service.worker.clock import rested
from tests.service.machine.adoptions import Adoptions
from tests.service.machine.base import Machine
from tests.service.machine.hooks import Hooks
from tests.service.machine.journeys import Journeys
from tests.service.machine.keys import Keys
from tests.service.machine.models import Models
from tests.service.machine.moments import Moments
from tests.service.machine.reads import Reads
from tests.service.machine.streams import Streams


@dataclass(frozen=True, slots=True)
class Mutant:
    """What is put in the place of a name, and the rules that notice it.

    first   seed of a sequence that does; 0: one of the first does
    """

    words: str
    machine: type[Machine]
    name: str
    broken: Any
    first: int = 0


restore = SqlLog.restore
after, put_model, model = SqlOutbox.after, SqlRecords.put_model, SqlRecords.model


def came_now(self: SqlLog, rotor_id: str, events: Sequence[Event]) -> None:
    restore(self, rotor_id, [replace(one, received_at=time.time()) for one in events])


def effects_of_now(tx: Transaction, rotor: RotorRecord, *given: int | None) -> Adopted:
    return adopted_at(tx, rotor)


def due_out_of_turn(longest_s: float) -> ColumnElement[bool]:
    """Whatever of its rotor rests before it."""
    return and_(delivery.c.status == "pending", rested(delivery.c.not_before, longest_s))


def from_the_known(self: SqlOutbox, rotor_id: str, number: int, limit: int) -> list[Note]:
    return after(self, rotor_id, number - 1, limit)


def newest_always(tx: Transaction, rotor_id: str, which: Which) -> StateRecord:
    return tx.states.get(rotor_id, None)


def known_stays(self: SqlRecords, card: ModelCard, source: Any, *, newest: bool = False) -> None:
    put_model(self, card, source)


def newest_model(self: SqlRecords, model_id: str, version: str | None = None) -> ModelCard:
    return model(self, model_id)


MUTANTS = (
    Mutant("every moment is now", Moments, "service.store.kept.end_of", lambda at: at + 3600.0, 28),
    Mutant("webhooks told nothing", Hooks, "service.store.outbox.tell", lambda *given: None, 29),
    Mutant("deliveries out of turn", Hooks, "service.worker.hook_lease.due", due_out_of_turn, 56),
    Mutant(
        "webhooks told of every rotor",
        Hooks,
        "service.store.webhooks._knows",
        lambda row, rotor: True,
        32,
    ),
    Mutant("imported entries came now", Journeys, "service.store.log.SqlLog.restore", came_now),
    Mutant(
        "imports not compared",
        Journeys,
        "service.handlers.transfer_in._same",
        lambda *given: None,
        36,
    ),
    Mutant(
        "adoptions of readings that are gone",
        Adoptions,
        "service.handlers.adoptions.readings_since",
        lambda *given: 0,
        32,
    ),
    Mutant(
        "effects of today in old versions",
        Adoptions,
        "service.handlers.rotors.adopted_at",
        effects_of_now,
        34,
    ),
    Mutant(
        "a key knows every rotor", Keys, "service.access.KeyRecord.knows", lambda self, rotor: True
    ),
    Mutant(
        "a revoked key is usable", Keys, "service.access.KeyRecord.status", lambda *given: "usable"
    ),
    Mutant("scopes not asked for", Keys, "service.api.gate._beyond", lambda *given: None),
    Mutant("all posters are one", Keys, "service.access.Act.poster", "somebody", 28),
    Mutant("refusals leave no row", Keys, "service.api.trail.conclude", lambda *given: None),
    Mutant(
        "models trained again stay",
        Models,
        "service.store.records.SqlRecords.put_model",
        known_stays,
        29,
    ),
    Mutant(
        "every model the newest", Models, "service.store.records.SqlRecords.model", newest_model
    ),
    Mutant("any file is runs", Models, "service.handlers.models.HDF5", b""),
    Mutant(
        "the known event again", Streams, "service.store.outbox.SqlOutbox.after", from_the_known
    ),
    Mutant(
        "no event is missed",
        Streams,
        "service.store.outbox.SqlOutbox.missing",
        lambda *given: False,
    ),
    Mutant(
        "Last-Event-ID ignored",
        Streams,
        "service.api.routers.events.last_event_id",
        lambda r: None,
        28,
    ),
    Mutant("kept answers for ever", Reads, "service.api.kept.Ground.holds", lambda *given: True),
    Mutant(
        "one ETag for all", Reads, "service.api.routers.reads.tag_of_basis", lambda *given: '"one"'
    ),
    Mutant("every version the newest", Reads, "service.handlers.reads.state_of", newest_always, 46),
    Mutant(
        "what was retracted counts",
        Reads,
        "service.store.glance._gone",
        lambda *given: select(t.entry.c.replaces).where(false()),
    ),
    Mutant(
        "residuals of long ago",
        Reads,
        "service.worker.residuals.Residuals.run_once",
        lambda s: False,
    ),
)
