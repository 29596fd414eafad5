"""Readings: posted, corrected, retracted (listed: `service.handlers.listing`).

A batch is all or nothing: every fault of every item is reported, and nothing is stored unless
there is none. Checking happens before the writing transaction, so that a large batch does not
keep other writers waiting; blades are only ever added, so a check that passed stays true.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from heapq import nsmallest

from core.errors import InputError, RangeError
from core.network import Network
from core.observation import Covers, Inspection, faults
from service.digests import digest_of_json
from service.errors import MOST_FAULTS, FaultsError
from service.handlers.circles import circles
from service.handlers.listing import found
from service.ports import Appended, NewEvent, Store, Transaction

SHOWN = 8


@dataclass(frozen=True, slots=True)
class Item:
    """A reading and the name of its place in the request, e.g. ``inspections[3].``."""

    where: str
    reading: Inspection


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
        answers = tx.log.append(rotor_id, events)
        if corrects and tx.records.rotor(rotor_id).last_error_event in _corrected(answers, items):
            tx.log.free(rotor_id)
        return answers


def _corrected(answers: Sequence[Appended], items: Sequence[Item]) -> set[str]:
    """The readings that new corrections name."""
    both = zip(answers, items, strict=True)
    return {name for one, item in both if one.new and (name := item.reading.replaces) is not None}


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
    use = f"use one of {known}, or " if known else ""
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
                    f"{use}POST /v1/rotors/{rotor_id}/blades",
                )
            )
        if reading.replaces == reading.id:
            found.append(
                InputError(f"{where}replaces", reading.id, "is the reading itself", "give a new id")
            )
        for error in (*faults(reading, network, model, where), *_vague(reading, network, where)):
            prefixed = error.what if error.what.startswith(where) else f"{where}{error.what}"
            found.append(type(error)(prefixed, error.value, error.problem, error.remedy))
    return found


def _vague(reading: Inspection, network: Network, where: str) -> Iterator[InputError]:
    """A reading whose noise is wider than all that it may be says nothing, and its square may be no
    number any more: residuals of the whole rotor end with that."""
    sigma = reading.sigma
    quantity = next((one for one in network.quantities if one.name == reading.quantity), None)
    if sigma is None or quantity is None or not quantity.high - quantity.low < sigma < math.inf:
        return
    plausible = f"{quantity.low:g} … {quantity.high:g} {quantity.unit}"
    problem = f"is wider than the plausible {plausible}"
    remedy = "check the unit, or leave out a reading that says nothing"
    yield RangeError(f"{where}sigma", sigma, problem, remedy)


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
        found(tx.log.find(rotor_id, inspection_id), rotor_id, inspection_id)
        answer = tx.log.append(rotor_id, [event])[0]
        if answer.new:
            tx.log.free(rotor_id)
    return answer
