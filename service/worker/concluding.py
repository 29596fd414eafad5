"""What follows from a diagnosis that has ended, in the transaction in which it ends.

What it found, or that it failed, is told to who listens; and where the rotor says so, what it named
is adopted.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

from core.log import Entry
from service.errors import AdoptionError
from service.handlers.adoptable import read_ahead
from service.handlers.adoptions import adopt_in, backed_out
from service.handlers.diagnoses import BECAUSE
from service.ports import Json, Science
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

    What forbids it stands in the result, as ``not_adopted``.
    """
    assert lease.rotor_id is not None
    tx.log.lock(lease.rotor_id)
    told = {"diagnosis": lease.id, "verdict": found["verdict"], "names": found["names"]}
    tx.outbox.post(lease.rotor_id, "diagnosed", told)
    option = tx.records.rotor(lease.rotor_id).adopts
    if option != "effect" or found["verdict"] != "effect":
        return found
    try:
        job = tx.records.job(lease.id)
        asked = BECAUSE not in job.request
        problem = None if asked else backed_out(tx, lease.rotor_id, found["effects"])
        if problem is not None:
            there = f"/v1/rotors/{lease.rotor_id}/diagnoses/{lease.id}"
            remedy = f"where it is to be had all the same, POST {there}/adoption"
            raise AdoptionError(lease.id, "adopted unasked", problem, remedy)
        adopt_in(tx, science, job, found, ahead, unasked=True)
    except AdoptionError as error:
        log.warning("%s", error)
        return found | {"not_adopted": str(error)}
    return found


def in_vain(tx: SqlTransaction, lease: JobLease, error: str) -> None:
    """That a diagnosis has failed, and is not tried again."""
    assert lease.rotor_id is not None
    tx.log.lock(lease.rotor_id)
    told = {"diagnosis": lease.id, "error": error[:TOLD]}
    tx.outbox.post(lease.rotor_id, "diagnosis-failed", told)
