"""Models and jobs.

A model is registered by JSON, ``{"builtin": …}``, or trained on runs that come as a form
(multipart): ``id``, ``network`` (YAML or JSON, text or file), ``runs`` (netCDF-4), ``leave_out``?
"""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query
from fastapi.responses import JSONResponse

from service.api.model_bodies import BODY, Upload, asked_of
from service.api.services import Cursor, Limit, Name, Wired, moment, page, page_size
from service.handlers import models as use
from service.names import ID_PATTERN
from service.ports import JobRecord, ModelCard

router = APIRouter(prefix="/v1", tags=["models"])
Version = Annotated[
    str | None,
    Query(
        max_length=100,
        pattern=ID_PATTERN,
        description="as a rotor's `model_version` names it; left out: the newest",
    ),
]


def model_out(card: ModelCard) -> dict[str, Any]:
    return {"state": "ready"} | card.to_json()


def job_out(job: JobRecord) -> dict[str, Any]:
    return {
        "id": job.id,
        "kind": job.kind,
        "status": job.status,
        "request": job.request,
        "result": job.result,
        "error": job.error,
        "progress": job.progress,
        "attempts": job.attempts,
        "created_at": moment(job.created_at),
        "finished_at": moment(job.finished_at),
    }


@router.post(
    "/models",
    status_code=202,
    summary="Register a built-in model, or train one on runs; answers with a job",
    openapi_extra=BODY,
)
def post_model(services: Wired, asked: Annotated[Upload | str, Depends(asked_of)]) -> JSONResponse:
    store, science = services.store, services.science
    if isinstance(asked, Upload):
        job = use.request_training(
            store, science, asked.id, asked.network, asked.runs, asked.leave_out
        )
    else:
        job = use.request_builtin(store, science, asked)
    return JSONResponse({"job": job_out(job)}, 202, headers={"Location": f"/v1/jobs/{job.id}"})


@router.get("/models", summary="Models, page by page")
def get_models(services: Wired, limit: Limit = None, cursor: Cursor = None) -> dict[str, Any]:
    size = page_size(services, limit)
    cards = use.list_models(services.store, cursor or "", size + 1)
    rows = [{"id": c.id, "version": c.version, "digest": c.digest, "state": "ready"} for c in cards]
    return page(rows, size, "id")


@router.get("/models/{m}", summary="A model: network, quantities, mesh, errors")
def get_model(m: Name, services: Wired, version: Version = None) -> dict[str, Any]:
    return model_out(use.find_model(services.store, m, version))


@router.get("/jobs/{id}", summary="How far a job is")
def get_job(id: Name, services: Wired) -> dict[str, Any]:
    return job_out(use.find_job(services.store, id))
