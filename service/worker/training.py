"""The training of an uploaded model as a job.

The runs were stored in the transaction of the job's request, so a worker that dies leaves them for
the next one. They are dropped in the transaction that ends the job, in whichever way, unless
another job still names them: the database is no archive of files, and the model's card keeps their
SHA-256.
"""

from __future__ import annotations

from json import dumps, loads

from sqlalchemy import select

from core.errors import FaultsError, InputError, ModelError
from core.network import Network
from service.handlers.models import TRAIN
from service.ports import Json, ModelCard, Progress, Science
from service.store import tables as t
from service.store.jobs import UNFINISHED
from service.store.unit_of_work import SqlStore, SqlTransaction


def train(
    store: SqlStore, science: Science, request: Json, progress: Progress
) -> tuple[ModelCard, bytes]:
    """The card and the artefact of a request's model; FaultsError with what is wrong with it."""
    progress("reading the archive", 0, 1)
    runs = store.blob(request["archive"])
    network = Network.from_json(request["network"])
    facts = {"archive": {"sha256": request["archive"], "bytes": request["bytes"]}}
    return science.train(request["id"], network, runs, request["leave_out"], facts, progress)


def keep(tx: SqlTransaction, job_id: str, request: Json, card: ModelCard, artefact: bytes) -> Json:
    """Register the model with its artefact and drop the runs; the job's result."""
    name = tx.blobs.put(artefact)
    source = {"artefact": name, "archive": request["archive"], "job": job_id}
    tx.records.put_model(card, source, newest=True)
    drop_runs(tx, job_id, request)
    return {
        "model": card.id,
        "version": card.version,
        "digest": card.digest,
        "quality": card.summary.get("quality", {}),
        "warnings": card.summary.get("warnings", []),
    }


def drop_runs(tx: SqlTransaction, job_id: str, request: Json) -> None:
    """Forget the runs of a job that ends, unless another one is to train on them."""
    name = request["archive"]
    tx.blobs.lock(name)
    others = select(t.job.c.request).where(
        t.job.c.kind == TRAIN, t.job.c.status.in_(UNFINISHED), t.job.c.id != job_id
    )
    waiting = {loads(text)["archive"] for text in tx.connection.execute(others).scalars()}
    if name not in waiting:
        tx.blobs.drop(name)


def refusal(error: Exception) -> str | None:
    """What a refused training answers with, as JSON text: faults and warnings; None: no refusal."""
    if isinstance(error, FaultsError):
        warnings = getattr(error, "warnings", ())
        faults = {"faults": [one.to_json() for one in error.faults]}
        return dumps(faults | {"warnings": [one.to_json() for one in warnings]})
    if isinstance(error, InputError):
        return dumps({"faults": [error.to_json()], "warnings": []})
    if isinstance(error, ModelError):
        one = InputError(
            "runs", None, str(error), "write them as core/README.md says, and upload again"
        )
        return dumps({"faults": [one.to_json()], "warnings": []})
    return None
