"""Models and jobs."""

from __future__ import annotations

import os

from core.errors import InputError
from service.errors import NotFoundError
from service.ports import JobRecord, ModelCard, Science, Store


def request_builtin(store: Store, science: Science, name: str) -> JobRecord:
    """A job that registers a built-in model."""
    if name not in science.builtins:
        known = " or ".join(science.builtins)
        raise InputError("builtin", name, "is no built-in model", f"use {known}")
    with store.write() as tx:
        return tx.records.put_job(os.urandom(8).hex(), "register-model", {"builtin": name})


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


def find_model(store: Store, model_id: str) -> ModelCard:
    """The newest version of a model."""
    with store.read() as tx:
        return tx.records.model(model_id)


def list_models(store: Store, after: str, limit: int) -> list[ModelCard]:
    """Models in the order of their names, after one name."""
    with store.read() as tx:
        return tx.records.models(after, limit)
