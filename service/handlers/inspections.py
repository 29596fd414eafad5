"""Readings: posted, corrected, retracted, listed.

A batch is all or nothing: every fault of every item is reported, and nothing is stored unless
there is none. Checking happens before the writing transaction, so that a large batch does not
keep other writers waiting; blades are only ever added, so a check that passed stays true.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from heapq import nsmallest

from core.errors import InputError
from core.network import Network
from core.observation import Covers, Inspection, faults, replaced
from service.digests import digest_of_json
from service.entries import body_problem
from service.errors import MOST_FAULTS, DamagedLogError, FaultsError, NotFoundError
from service.handlers.circles import circles
from service.ports import Appended, Event, Json, NewEvent, Store, Transaction

SHOWN = 8


@dataclass(frozen=True, slots=True)
class Item:
    """A reading and the name of its place in the request, e.g. ``inspections[3].``."""

    where: str
    reading: Inspection


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


def post_inspections(store: Store, rotor_id: str, items: Sequence[Item]) -> list[Appended]:
    """Append readings to the log; FaultsError lists every fault of every item."""
    if len(items) == 1 and (answer := _post_known(store, rotor_id, items)) is not None:
        return answer
    if found := faults_here(store, rotor_id, items):
        raise FaultsError(found)
    events = [_event(item.reading) for item in items]
    corrects = any(item.reading.replaces is not None for item in items)
    with store.write() as tx:
        if corrects:
            tx.log.lock(rotor_id)
            if found := circles(tx, rotor_id, items):
                raise FaultsError(found)
        return tx.log.append(rotor_id, events)


def _post_known(store: Store, rotor_id: str, items: Sequence[Item]) -> list[Appended] | None:
    """One sound reading of a blade that this process has met, which is checked without asking for
    it. None: not by this way."""
    (item,) = items
    blade = item.reading.blade
    card = None if item.reading.replaces else store.met(rotor_id, blade)
    if card is None or faults_of(items, card.network, card, {blade}, rotor_id):
        return None
    event = _event(item.reading)
    with store.write() as tx:
        answer = tx.log.append_new(rotor_id, event, card)
        if answer is not None:
            return [answer]
        if found := faults_in(tx, rotor_id, items):
            raise FaultsError(found)
        return tx.log.append(rotor_id, [event])


def faults_here(store: Store, rotor_id: str, items: Sequence[Item]) -> list[InputError]:
    """`faults_of` a rotor as it stands."""
    with store.read() as tx:
        return faults_in(tx, rotor_id, items)


def faults_in(tx: Transaction, rotor_id: str, items: Sequence[Item]) -> list[InputError]:
    """`faults_of` a rotor as a transaction sees it."""
    named = {item.reading.blade for item in items}
    card, blades = tx.records.covering(rotor_id, named)
    if not named <= blades:
        blades = tx.records.blade_ids(rotor_id)  # a fault names those that exist
    return faults_of(items, card.network, card, blades, rotor_id)


def faults_of(
    items: Sequence[Item], network: Network, model: Covers, blades: Collection[str], rotor_id: str
) -> list[InputError]:
    """What keeps readings out of a rotor with these blades, each by its place; where that is more
    than `MOST_FAULTS`, not much more than these."""
    found: list[InputError] = []
    known = ", ".join(nsmallest(SHOWN, blades)) + ("…" if len(blades) > SHOWN else "")
    for item in items:
        if len(found) > MOST_FAULTS:
            break
        where, reading = item.where, item.reading
        if reading.blade not in blades:
            found.append(
                InputError(
                    f"{where}blade",
                    reading.blade,
                    f"is no blade of rotor {rotor_id}",
                    f"use one of {known or 'none yet'}, or POST /v1/rotors/{rotor_id}/blades",
                )
            )
        if reading.replaces == reading.id:
            found.append(
                InputError(f"{where}replaces", reading.id, "is the reading itself", "give a new id")
            )
        for error in faults(reading, network, model, where):
            prefixed = error.what if error.what.startswith(where) else f"{where}{error.what}"
            found.append(type(error)(prefixed, error.value, error.problem, error.remedy))
    return found


def _event(reading: Inspection) -> NewEvent:
    return NewEvent(
        event_id=reading.id,
        kind="inspection",
        body=json.dumps(reading.to_json(), separators=(",", ":")),
        digest=reading.digest(),
        replaces=reading.replaces,
        blade=reading.blade,
        time_h=float(reading.time_h),
    )


def retract(store: Store, rotor_id: str, inspection_id: str) -> Appended:
    """As if the reading had never come; frees a rotor that it had blocked."""
    body, digest = digest_of_json({})
    event = NewEvent(
        f"retraction/{inspection_id}", "retraction", body, digest, replaces=inspection_id
    )
    with store.write() as tx:
        tx.log.lock(rotor_id)
        _find(tx.log.find(rotor_id, inspection_id), rotor_id, inspection_id)
        answer = tx.log.append(rotor_id, [event])[0]
        if answer.new:
            tx.log.free(rotor_id)
    return answer


def _find(event: Event | None, rotor_id: str, inspection_id: str) -> Event:
    if event is None or event.kind != "inspection":
        remedy = f"GET /v1/rotors/{rotor_id}/inspections lists those that exist"
        raise NotFoundError("inspection", inspection_id, remedy)
    return event


def find_inspection(store: Store, rotor_id: str, inspection_id: str) -> Listed:
    """One reading with all its values."""
    with store.read() as tx:
        tx.records.rotor(rotor_id)
        event = _find(tx.log.find(rotor_id, inspection_id), rotor_id, inspection_id)
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
