"""The report of a diagnosis that has ended with a verdict."""

from __future__ import annotations

from service.errors import NotFoundError, NotYetError
from service.handlers.diagnoses import find_diagnosis
from service.moments import moment
from service.ports import Store
from service.report.page import report


def diagnosis_report(store: Store, rotor_id: str, diagnosis: str, limit: float | None) -> str:
    """The page to hand on; a function of the diagnosis and the limit alone.

    limit  of the quantity that is forecast [its unit]: the remaining life until it; None: left out

    Raises NotYetError while the diagnosis runs, NotFoundError where it ended without a verdict.
    """
    job = find_diagnosis(store, rotor_id, diagnosis)
    where = f"/v1/rotors/{rotor_id}/diagnoses/{diagnosis}"
    if job.status in ("queued", "running"):
        raise NotYetError(
            f"diagnosis {diagnosis} of rotor {rotor_id}", f"follow it with GET {where}"
        )
    if job.result is None:
        why = f"it is {job.status}, as GET {where} says; POST {where.rpartition('/')[0]} begins one"
        raise NotFoundError("report of diagnosis", diagnosis, why)
    return report(job.result, rotor_id, diagnosis, moment(job.finished_at), limit)
