"""What pages show: blades at one hour, kept versions, the service."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from fastapi.responses import Response
from pydantic import FiniteFloat

from service.api.rotor_answers import blade_out, rotor_out
from service.api.routers.diagnoses import diagnosis_out
from service.api.services import (
    Cursor,
    Limit,
    Name,
    Wired,
    moment,
    page,
    page_size,
    seq_of,
    tag_of,
    tagged,
    unchanged,
)
from service.api.which import Asked
from service.handlers import glance as use
from service.handlers.questions import question
from service.handlers.reads import basis, health
from service.ports import StateRecord

router = APIRouter(prefix="/v1", tags=["glance"])
ROTOR = "/rotors/{r}"
Quantity = Annotated[str | None, Query(max_length=100, description="default: the model's first")]
Hour = Annotated[FiniteFloat | None, Query(description="default: the model's last hour")]


@router.get(ROTOR + "/blades", summary="Blades at one hour: prediction and readings of each")
def get_blades(
    r: Name,
    request: Request,
    services: Wired,
    which: Asked,
    quantity: Quantity = None,
    time_h: Hour = None,
    node: Annotated[str | None, Query(max_length=100)] = None,
    limit: Limit = None,
    cursor: Cursor = None,
) -> Response:
    size = page_size(services, limit)
    found = basis(services.store, services.science, r, which)
    hours = [found.card.horizon_h if time_h is None else time_h]
    asked = question(found.card, quantity, hours, node, 0.95)
    seen = use.glance(services.store, found, which, cursor or "", size + 1)
    tag = tag_of(request, found.state.version, found.state.digest, found.card.digest, seen)
    if (same := unchanged(request, tag)) is not None:
        return same
    told = use.at_one_hour(services.store, services.science, found, asked, seen.blades[:size])
    items: list[dict[str, Any]] = [
        blade_out(blade)
        | {
            "readings": use.readings_out(seen.readings.get(blade.id, use.NO_READINGS)),
            "prediction": told[i] if i < size else None,
        }
        for i, blade in enumerate(seen.blades)
    ]
    body = page(items, size, "id") | {
        "rotor": r,
        "quantity": asked.quantity,
        "unit": found.card.outputs[asked.quantity].unit,
        "node": asked.node,
        "time_h": asked.times[0],
        "head_seq": seen.head_seq,
        "health": health(found.state),
        "rests_on": found.to_json(),
    }
    return tagged(body, tag)


@router.get(ROTOR + "/versions", summary="Versions that are kept, the newest first")
def get_versions(
    r: Name, services: Wired, limit: Limit = None, cursor: Cursor = None
) -> dict[str, Any]:
    size = page_size(services, limit)
    found = use.versions(services.store, r, seq_of(cursor), size + 1)
    return page([version_out(state) for state in found], size, "version")


def version_out(state: StateRecord) -> dict[str, Any]:
    return {
        "version": state.version,
        "through_seq": state.through_seq,
        "sealed": state.sealed,
        "state_digest": state.digest,
        "events_digest": state.events_digest,
        "model_version": state.model_version,
        "algorithm_version": state.algorithm_version,
        "created_at": moment(state.created_at),
        "health": health(state),
    }


@router.get("/operations", summary="The service at one moment: backlog, workers, jobs, blocked")
def get_operations(services: Wired, limit: Limit = None) -> dict[str, Any]:
    found = use.operations(services.store, services.science, page_size(services, limit))
    jobs = [diagnosis_out(job) | {"kind": job.kind} for job in found.jobs]
    return {
        "gauges": asdict(found.gauges),
        "work": [asdict(one) for one in found.work],
        "jobs": [{k: v for k, v in job.items() if k != "result"} for job in jobs],
        "blocked": [rotor_out(rotor) for rotor in found.blocked],
    }
