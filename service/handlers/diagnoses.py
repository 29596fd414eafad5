"""Diagnoses: effects that a rotor's model lacks, looked for as a long job.

A diagnosis rests on the log as it stands when it is asked for, through its head; what comes later
belongs to the next one. The same question about the same log, while it is being answered, is the
same diagnosis, whether somebody asked it or the rotor's own residuals (`service.worker.asking`).
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence

from core.errors import RangeError
from service.adopted import adopted_at
from service.errors import NotFoundError
from service.ports import JobRecord, Json, ModelCard, Science, Store, Transaction

KIND = "diagnose"
BECAUSE = "because"  # of a request that nobody made: what alarms
HORIZON_H = 50_000.0


def diagnosis_id() -> str:
    """An id that no other has and that grows with time: milliseconds since 1970, then chance."""
    return f"{int(1e3 * time.time()):012x}{os.urandom(4).hex()}"


def request_diagnosis(
    store: Store,
    science: Science,
    rotor_id: str,
    families: Sequence[Json],
    *,
    compare: bool,
    horizon_h: float | None,
) -> tuple[JobRecord, bool]:
    """A diagnosis of the log as it stands, or the one that is under way; whether it is new.

    families    beside the built-in ones, as `core.diagnosis.Family.to_json` tells them
    horizon_h   hour of the forecast before and after [h]; None: the model's last, at most 50,000

    Raises InputError for a family or an hour that the model cannot be asked for.
    """
    with store.read() as tx:
        rotor = tx.records.rotor(rotor_id)
        card = tx.records.model(rotor.model_id, rotor.model_version)
        network = adopted_at(tx, rotor).network
    if families:
        science.check_families(science.vary(card, network), families)
    asked = {
        "families": list(families),
        "compare": compare,
        "horizon_h": _horizon(card, horizon_h),
    }
    with store.write() as tx:
        request = asked | {"through_seq": tx.log.lock(rotor_id)}
        for job in tx.records.unfinished(rotor_id, KIND):
            if {k: v for k, v in job.request.items() if k != BECAUSE} == request:
                return job, False
        return tx.records.put_job(diagnosis_id(), KIND, request, rotor_id), True


def ask_unasked(tx: Transaction, rotor_id: str, through: int, because: Json) -> JobRecord:
    """A diagnosis that nobody asked for, of the log through an entry, with what it is there for.

    It asks what a request without a word of its own asks.
    """
    rotor = tx.records.rotor(rotor_id)
    card = tx.records.model(rotor.model_id, rotor.model_version)
    request = {"families": [], "compare": True, "horizon_h": _horizon(card, None)}
    request |= {"through_seq": through, BECAUSE: because}
    return tx.records.put_job(diagnosis_id(), KIND, request, rotor_id)


def _horizon(card: ModelCard, asked: float | None) -> float:
    if asked is None:
        return min(HORIZON_H, card.horizon_h)
    if not 0 < asked <= card.horizon_h:
        problem = f"lies outside 0 … {card.horizon_h:g} h, which the model covers"
        raise RangeError("horizon_h", asked, problem, "give an hour inside")
    return asked


def list_diagnoses(store: Store, rotor_id: str, before: str | None, limit: int) -> list[JobRecord]:
    """Diagnoses of a rotor, the newest first, older than one."""
    with store.read() as tx:
        tx.records.rotor(rotor_id)
        return tx.records.jobs_of(rotor_id, KIND, before, limit)


def find_diagnosis(store: Store, rotor_id: str, diagnosis: str) -> JobRecord:
    """A diagnosis and how far it is."""
    with store.read() as tx:
        return found_in(tx, rotor_id, diagnosis)


def cancel_diagnosis(store: Store, rotor_id: str, diagnosis: str) -> JobRecord:
    """End a diagnosis that is queued or running; one that has ended stays as it is."""
    with store.write() as tx:
        tx.log.lock(rotor_id)
        before = found_in(tx, rotor_id, diagnosis)
        tx.records.cancel_job(diagnosis)
        job = tx.records.job(diagnosis)
        if job.status != before.status:  # who waits for its end is told
            tx.outbox.post(rotor_id, "diagnosis-cancelled", {"diagnosis": diagnosis})
        return job


def found_in(tx: Transaction, rotor_id: str, diagnosis: str) -> JobRecord:
    """A diagnosis of this rotor."""
    tx.records.rotor(rotor_id)
    remedy = f"GET /v1/rotors/{rotor_id}/diagnoses lists those of the rotor"
    try:
        job = tx.records.job(diagnosis)
    except NotFoundError:
        raise NotFoundError("diagnosis", diagnosis, remedy) from None
    if (job.rotor_id, job.kind) != (rotor_id, KIND):
        raise NotFoundError("diagnosis", diagnosis, remedy)
    return job
