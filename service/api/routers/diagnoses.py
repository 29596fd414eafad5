"""Diagnoses: asked for, listed, looked at, cancelled."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter
from fastapi.responses import JSONResponse
from pydantic import ConfigDict, Field, FiniteFloat, StringConstraints

from service.api.routers.adoptions import adoption_out
from service.api.schemas import Body, Id
from service.api.services import Cursor, Limit, Name, Services, Wired, moment, page, page_size
from service.handlers import diagnoses as use
from service.handlers.adoptions import standing
from service.names import TITLE_PATTERN
from service.ports import JobRecord

router = APIRouter(prefix="/v1/rotors/{r}/diagnoses", tags=["diagnoses"])
Title = Annotated[str, StringConstraints(min_length=1, max_length=80, pattern=TITLE_PATTERN)]
EXAMPLE: dict[str, Any] = {
    "families": [
        {
            "name": "sagging fixture",
            "sentence": "a fixture of the gauge gives way while it is in use",
            "target": "reading",
            "of": "elongation",
            "how": "plus",
            "size": 0.01,
            "sign": 1,
            "shapes": ["linear"],
            "whom": ["instrument"],
            "clock": "rotor",
            "kind": "sensor",
        }
    ],
    "compare": True,
    "horizon_h": 50_000,
}


class FamilyIn(Body):
    """A family of effects (`core.diagnosis.Family`) that is tried beside the built-in ones."""

    name: Title
    sentence: Annotated[str, StringConstraints(min_length=1, max_length=500)]
    target: Literal["input", "reading"]
    of: Id
    how: Literal["plus", "times"]
    size: Annotated[FiniteFloat, Field(gt=0)] | None
    sign: Literal[-1, 0, 1]
    shapes: Annotated[
        list[Literal["constant", "early", "linear", "late", "step"]],
        Field(min_length=1, max_length=5),
    ]
    whom: Annotated[
        list[Literal["all", "lot", "coating_lot", "blade", "instrument", "campaign"]],
        Field(min_length=1, max_length=6),
    ]
    clock: Literal["blade", "rotor", "event"]
    kind: Literal["physics", "operation", "material", "sensor"]
    cause: Title | None = None

    def told(self) -> dict[str, Any]:
        """As `core.diagnosis.Family.to_json` tells it."""
        return {k: v for k, v in self.model_dump().items() if (k, v) != ("cause", None)}


class DiagnosisIn(Body):
    """What a diagnosis tries beside the built-in families, and what it compares."""

    model_config = ConfigDict(json_schema_extra={"examples": [EXAMPLE]})

    families: Annotated[tuple[FamilyIn, ...], Field(max_length=50, strict=False)] = ()
    compare: bool = True
    horizon_h: FiniteFloat | None = None


def diagnosis_out(job: JobRecord) -> dict[str, Any]:
    return {
        "id": job.id,
        "rotor": job.rotor_id,
        "status": job.status,
        "request": job.request,
        "progress": job.progress,
        "result": job.result,
        "error": job.error,
        "attempts": job.attempts,
        "created_at": moment(job.created_at),
        "finished_at": moment(job.finished_at),
    }


def whole(services: Services, job: JobRecord) -> dict[str, Any]:
    """A diagnosis with the last entry of the log that adopted it or backed it out."""
    assert job.rotor_id is not None
    change = standing(services.store, job.rotor_id, job.id)
    adoption = None if change is None else adoption_out(job.rotor_id, change)
    return diagnosis_out(job) | {"adoption": adoption}


@router.post("", status_code=202, summary="Look for effects that the model lacks")
def post_diagnosis(r: Name, services: Wired, body: DiagnosisIn | None = None) -> JSONResponse:
    asked = body or DiagnosisIn()
    job, new = use.request_diagnosis(
        services.store,
        services.science,
        r,
        [one.told() for one in asked.families],
        compare=asked.compare,
        horizon_h=asked.horizon_h,
    )
    headers = {"Location": f"/v1/rotors/{r}/diagnoses/{job.id}"}
    headers |= {} if new else {"Idempotent-Replayed": "true"}
    return JSONResponse({"diagnosis": whole(services, job)}, 202, headers=headers)


@router.get("", summary="Diagnoses without their results, the newest first")
def get_diagnoses(
    r: Name, services: Wired, limit: Limit = None, cursor: Cursor = None
) -> dict[str, Any]:
    size = page_size(services, limit)
    jobs = use.list_diagnoses(services.store, r, cursor, size + 1)
    return page([listed(job) for job in jobs], size, "id")


def listed(job: JobRecord) -> dict[str, Any]:
    """A diagnosis as a list shows it: of its result the verdict and the names alone, and why the
    rotor did not adopt it by itself."""
    told = diagnosis_out(job)
    result = told.pop("result") or {}
    return told | {name: result.get(name) for name in ("verdict", "names", "not_adopted")}


@router.get("/{d}", summary="A diagnosis: how far it is, and what was found")
def get_diagnosis(r: Name, d: Name, services: Wired) -> dict[str, Any]:
    return whole(services, use.find_diagnosis(services.store, r, d))


@router.delete("/{d}", summary="Cancel a diagnosis; one that has ended stays as it is")
def delete_diagnosis(r: Name, d: Name, services: Wired) -> dict[str, Any]:
    return whole(services, use.cancel_diagnosis(services.store, r, d))
