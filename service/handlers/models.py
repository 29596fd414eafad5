"""Models and jobs: built-in models are registered, others are trained on runs that are uploaded."""

from __future__ import annotations

import os
from collections.abc import Sequence

from core.errors import FaultsError, InputError
from core.network import Network
from service.errors import NotFoundError
from service.ports import JobRecord, Json, ModelCard, Science, Store

TRAIN = "train-model"
HDF5 = b"\x89HDF\r\n\x1a\n"


def request_builtin(store: Store, science: Science, name: str) -> JobRecord:
    """A job that registers a built-in model."""
    if name not in science.builtins:
        known = " or ".join(science.builtins)
        raise InputError("builtin", name, "is no built-in model", f"use {known}")
    with store.write() as tx:
        return tx.records.put_job(os.urandom(8).hex(), "register-model", {"builtin": name})


def request_training(
    store: Store,
    science: Science,
    name: str,
    network: Network,
    runs: bytes,
    leave_out: Sequence[str] = (),
) -> JobRecord:
    """A job that trains a model on runs (`core.archive.source`); they are stored with it.

    The runs are read by the job, in a process of its own: what a file can do to its reader is not
    done to the API. Here only its first bytes are looked at.
    """
    faults = []
    if name in science.builtins:
        faults.append(InputError("id", name, "is a built-in model's", "choose another id"))
    if not runs.startswith(HDF5):
        remedy = "write it with xarray, engine h5netcdf, or by `bladetwin model convert`"
        shown = f"{len(runs)} bytes" if runs else "empty"
        faults.append(InputError("runs", shown, "is no netCDF-4 file", remedy))
    if faults:
        raise FaultsError(faults)
    with store.write() as tx:
        request: Json = {"id": name, "archive": tx.blobs.put(runs), "bytes": len(runs)}
        request |= {"network": network.to_json(), "leave_out": list(leave_out)}
        return tx.records.put_job(os.urandom(8).hex(), TRAIN, request)


def register_trained(store: Store, science: Science, name: str, artefact: bytes) -> ModelCard:
    """A model that was trained elsewhere (`bladetwin model train`), put into the database.

    It is the version that new rotors get. Raises ModelError for a damaged one.
    """
    if name in science.builtins:
        raise InputError("id", name, "is a built-in model's", "choose another id")
    card = science.opened(name, artefact)
    with store.write() as tx:
        source = {"artefact": tx.blobs.put(artefact)}
        tx.records.put_model(card, source, newest=True)
    return card


def register_builtins(store: Store, science: Science) -> None:
    """Make the first built-in model known, and this release's version of those that are.

    What is known already stays as it is.
    """
    for number, name in enumerate(science.builtins):
        if number > 0 and not _known(store, name):
            continue
        card = science.builtin(name)
        if not _known(store, card.id, card.version):
            with store.write() as tx:
                tx.records.put_model(card, {"builtin": name})


def _known(store: Store, name: str, version: str | None = None) -> bool:
    with store.read() as tx:
        try:
            tx.records.model(name, version)
        except NotFoundError:
            return False
    return True


def find_job(store: Store, job_id: str) -> JobRecord:
    """The job and how far it is. A rotor's job is found below its rotor alone."""
    with store.read() as tx:
        job = tx.records.job(job_id)
    if job.rotor_id is not None:
        raise NotFoundError("job", job_id, "use the id of the answer to the POST")
    return job


def find_model(store: Store, model_id: str, version: str | None = None) -> ModelCard:
    """A version of a model; None: the newest."""
    with store.read() as tx:
        return tx.records.model(model_id, version)


def list_models(store: Store, after: str, limit: int) -> list[ModelCard]:
    """Models in the order of their names, after one name."""
    with store.read() as tx:
        return tx.records.models(after, limit)
