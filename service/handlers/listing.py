"""Readings as the log has them: one, a page, all of a rotor; and whether each counts."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from core.log import replaced
from service.entries import body_problem
from service.errors import DamagedLogError, NotFoundError
from service.ports import Event, Json, Store, Transaction


@dataclass(frozen=True, slots=True)
class Listed:
    """A reading of the log; status ``counts``, ``replaced`` or ``retracted``.

    posted_by   id of the key that it came with, or by which way else (`service.ports.Event`)
    """

    seq: int
    received_at: float
    status: str
    body: Json
    posted_by: str | None


Pages = Iterator[list[Listed]]


@dataclass(frozen=True, slots=True)
class Log:
    """A rotor's log up to one entry."""

    rotor: str
    model: str
    head_seq: int
    created_at: float


def found(event: Event | None, rotor_id: str, inspection_id: str) -> Event:
    """The entry, if it is a reading."""
    if event is None or event.kind != "inspection":
        remedy = f"GET /v1/rotors/{rotor_id}/inspections lists those that exist"
        raise NotFoundError("inspection", inspection_id, remedy)
    return event


def find_inspection(store: Store, rotor_id: str, inspection_id: str) -> Listed:
    """One reading with all its values."""
    with store.read() as tx:
        tx.records.rotor(rotor_id)
        event = found(tx.log.find(rotor_id, inspection_id), rotor_id, inspection_id)
        overruling = tx.log.overruled(rotor_id, [inspection_id])
    return _listed(rotor_id, [event], overruling)[0]


def list_inspections(
    store: Store,
    rotor_id: str,
    after: int | None,
    limit: int,
    blade: str | None = None,
    newest: bool = False,
) -> list[Listed]:
    """Readings in the order of their arrival, after a sequence number; `newest`: the other way.

    One with more than `FEW` values comes without them, with their ``count``.
    """
    with store.read() as tx:
        tx.records.rotor(rotor_id)
        _known(tx, rotor_id, blade)
        events = tx.log.page(rotor_id, "inspection", after, limit, blade, newest, FEW)
        overruling = tx.log.overruled(rotor_id, [event.event_id for event in events])
    return _listed(rotor_id, events, overruling)


PAGE = 100
FEW = 16  # values of a reading that a list shows
COUNT = "count"  # of values, in place of them


def all_inspections(store: Store, rotor_id: str, blade: str | None) -> tuple[Log, Pages]:
    """Every reading as the log stands now, in the order of arrival, and where that is.

    Entries that come while the pages are read are left out, so that status and readings fit.
    """
    log = log_now(store, rotor_id, blade)
    return log, pages_of(store, log, blade)


def _known(tx: Transaction, rotor_id: str, blade: str | None) -> None:
    """NotFoundError: the rotor never had this blade."""
    if blade is not None and tx.records.blade(rotor_id, blade) is None:
        remedy = f"GET /v1/rotors/{rotor_id} names its blades"
        raise NotFoundError(f"blade of rotor {rotor_id}", blade, remedy)


def log_now(store: Store, rotor_id: str, blade: str | None = None) -> Log:
    """The rotor's log as it stands; NotFoundError: the blade is not one of its."""
    with store.read() as tx:
        rotor = tx.records.rotor(rotor_id)
        _known(tx, rotor_id, blade)
    return Log(rotor.id, rotor.model_id, rotor.head_seq, rotor.created_at)


def pages_of(store: Store, log: Log, blade: str | None) -> Pages:
    """The readings of a log, or of one blade in it, up to its head."""
    after: int | None = None
    while True:
        with store.read() as tx:
            events = tx.log.page(log.rotor, "inspection", after, PAGE, blade)
            overruling = tx.log.overruled(log.rotor, [event.event_id for event in events])
        here = [event for event in events if event.seq <= log.head_seq]
        known = [event for event in overruling if event.seq <= log.head_seq]
        yield _listed(log.rotor, here, known)
        if len(here) < PAGE:
            return
        after = here[-1].seq


def _listed(rotor: str, events: Sequence[Event], overruling: Sequence[Event]) -> list[Listed]:
    """Readings with their status; DamagedLogError: one is not what was written."""
    named = [(e.kind, e.event_id, e.replaces) for e in overruling if e.replaces is not None]
    gone = {target for kind, _, target in named if kind == "retraction"}
    over = replaced({own: target for kind, own, target in named if kind == "inspection"}, gone)

    def status(event_id: str) -> str:
        return "retracted" if event_id in gone else "replaced" if event_id in over else "counts"

    return [
        Listed(e.seq, e.received_at, status(e.event_id), _body(rotor, e), e.posted_by)
        for e in events
    ]


def _body(rotor: str, event: Event) -> Json:
    """What a reading says. Without its values its digest cannot be made again: then it has to
    agree with the columns beside it."""
    try:
        body: Json = json.loads(event.body)
        if COUNT in body:
            columns = (event.event_id, event.replaces, event.blade, event.time_h)
            same = columns == tuple(body.get(n) for n in ("id", "replaces", "blade", "time_h"))
            problem = None if same else "its body and its columns differ"
        else:
            problem = body_problem(event)
    except ValueError as error:
        problem = f"its body cannot be read: {error}"
    if problem is not None:
        raise DamagedLogError(rotor, event.event_id, problem)
    return body
