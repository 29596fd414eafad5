"""What follows from a diagnosis that has ended, in the transaction in which it ends.

What it found, or that it failed, is told to who listens; and where the rotor says so, what it named
is adopted, or it is told why not.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

from core.log import Entry
from service.adopted import BACK_OUT
from service.errors import AdoptionError
from service.handlers.adoptable import read_ahead
from service.handlers.adoptions import Ready, enter, in_order, ready
from service.handlers.diagnoses import BECAUSE
from service.ports import Json, Science, Transaction
from service.store.unit_of_work import SqlStore, SqlTransaction
from service.worker.job_lease import JobLease

log = logging.getLogger("bladetwin.worker")
TOLD = 500  # characters of an error


def ahead_of(store: SqlStore, rotor_id: str, found: Json) -> Sequence[Entry]:
    """The rotor's entries so far, where its option may adopt what was found."""
    with store.read() as tx:
        option = tx.records.rotor(rotor_id).adopts
    wanted = option == "effect" and found["verdict"] == "effect"
    return read_ahead(store, rotor_id) if wanted else ()


def concluded(
    tx: SqlTransaction, science: Science, lease: JobLease, found: Json, ahead: Sequence[Entry]
) -> Json:
    """The result of a diagnosis; adopted with it where the rotor says so and nothing forbids.

    What forbids it stands in the result, as ``not_adopted``, and who listens is told.
    """
    assert lease.rotor_id is not None
    tx.log.lock(lease.rotor_id)
    told = {"diagnosis": lease.id, "verdict": found["verdict"], "names": found["names"]}
    made = None
    try:
        made = wanted(tx, science, lease, found, ahead)
    except AdoptionError as error:
        log.warning("%s", error)
        found = found | {"not_adopted": str(error)}
        told |= {"not_adopted": str(error)[:TOLD]}
    tx.outbox.post(lease.rotor_id, "diagnosed", told)
    if made is not None:
        enter(tx, made)
    return found


def wanted(
    tx: SqlTransaction, science: Science, lease: JobLease, found: Json, ahead: Sequence[Entry]
) -> Ready | None:
    """What the rotor adopts by itself of a result; None: it adopts nothing by itself, or nothing
    is named. AdoptionError: something forbids it."""
    assert lease.rotor_id is not None
    if tx.records.rotor(lease.rotor_id).adopts != "effect" or found["verdict"] != "effect":
        return None
    job = tx.records.job(lease.id)
    asked = BECAUSE not in job.request
    problem = None if asked else backed_out(tx, lease.rotor_id, found["effects"])
    if problem is not None:
        there = f"/v1/rotors/{lease.rotor_id}/diagnoses/{lease.id}"
        remedy = f"where it is to be had all the same, POST {there}/adoption"
        raise AdoptionError(lease.id, "adopted unasked", problem, remedy)
    return ready(tx, science, job, found, ahead, unasked=True)


def backed_out(tx: Transaction, rotor_id: str, effects: Sequence[Json]) -> str | None:
    """Which back-out keeps these effects from being adopted unasked, in words; None: none does.

    One that is the last thing done to the rotor's model, or one of an effect of the same cause that
    nobody has adopted since.
    """
    own = in_order(tx, rotor_id)
    if own and own[-1].event.kind == BACK_OUT:
        seq = own[-1].event.seq
        return f"somebody backed out what was adopted last, with entry {seq}"
    last = {_cause(e): (change.event, e) for change in own for e in change.body["effects"]}
    for event, effect in (last[_cause(e)] for e in effects if _cause(e) in last):
        if event.kind == BACK_OUT:
            return f"somebody backed out {effect['name']}, with entry {event.seq}"
    return None


def _cause(effect: Json) -> str:
    """Older entries tell none."""
    return str(effect.get("cause") or effect["name"])


def in_vain(tx: SqlTransaction, lease: JobLease, error: str) -> None:
    """That a diagnosis has failed, and is not tried again."""
    assert lease.rotor_id is not None
    tx.log.lock(lease.rotor_id)
    told = {"diagnosis": lease.id, "error": error[:TOLD]}
    tx.outbox.post(lease.rotor_id, "diagnosis-failed", told)
