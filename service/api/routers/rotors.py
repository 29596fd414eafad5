"""Rotors: created, listed, looked at or waited for, tried again."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from fastapi.responses import JSONResponse, Response
from starlette.concurrency import run_in_threadpool

from service.api.kept import Make, shows
from service.api.preconditions import rotor_tag, text_of
from service.api.problems import RequestError, fault
from service.api.rotor_answers import blade_out, listed_out, rotor_out, view_out
from service.api.rotor_bodies import BladeIn, PolicyIn, RotorIn
from service.api.schemas import Nothing
from service.api.services import (
    Cursor,
    Limit,
    Name,
    Seen,
    Services,
    Wired,
    accepted,
    moment,
    page,
    page_size,
    tagged,
    unchanged,
)
from service.api.which import Asked
from service.handlers import rotors as use
from service.handlers.blades import add_blade, retire_blade
from service.handlers.policy import decide

router = APIRouter(prefix="/v1/rotors", tags=["rotors"])
LOOK_AGAIN_S = 1.0
WAIT_S = 30.0


@router.post("", status_code=201, summary="Create a rotor; the same again gives the same answer")
def post_rotor(body: RotorIn, services: Wired) -> JSONResponse:
    network, blades = body.asked_network(), [blade.record() for blade in body.blades]
    asked = (services.store, body.id, body.model, blades)
    options = (body.adopt, body.diagnose)
    made = use.created_before(*asked, body.particles, body.seed, network, *options)
    if made is None:
        card = use.check_network(services.store, services.science, body.model, network)
        count = services.settings.particles if body.particles is None else body.particles
        made = use.create_rotor(*asked, count, body.seed, network, body.adopt, card, body.diagnose)
    rotor, ordered, new = made
    answer = {
        "id": rotor.id,
        "model": rotor.model_id,
        "model_version": rotor.model_version,
        "blades": [blade_out(blade) for blade in ordered],
        "particles": rotor.particles,
        "seed": rotor.seed,
        "network": rotor.network,
        "adopt": rotor.adopt,
        "diagnose": rotor.diagnose,
        "created_at": moment(rotor.created_at),
    }
    headers = {"Location": f"/v1/rotors/{rotor.id}"}
    return JSONResponse(answer, 201, headers if new else headers | {"Idempotent-Replayed": "true"})


@router.get("", summary="Rotors, page by page")
def get_rotors(
    services: Wired, seen: Seen, limit: Limit = None, cursor: Cursor = None
) -> dict[str, Any]:
    size = page_size(services, limit)
    rotors = use.list_rotors(services.store, cursor or "", size + 1, seen)
    return page([listed_out(*one) for one in rotors], size, "id")


@router.get(
    "/{r}", summary="A rotor as it stands, or stood; wait_for=SEQ waits until SEQ is applied"
)
async def get_rotor(
    r: Name,
    request: Request,
    services: Wired,
    which: Asked,
    wait_for: Annotated[int | None, Query(ge=0, lt=2**62)] = None,
    timeout: Annotated[
        float | None,
        Query(ge=0, description="of `wait_for`, s; 30 where the service waits so long"),
    ] = None,
) -> Response:
    if which.newest:
        view = await _wait(services, r, wait_for, timeout)
    elif wait_for is None:
        view = await run_in_threadpool(use.view_rotor, services.store, r, which)
    else:
        raise _both(wait_for)
    if not which.newest or wait_for is not None:
        return _told(request, view)

    def again(request: Request) -> Response:
        return _as_it_stands(request, use.view_rotor(services.store, r), again)

    return _as_it_stands(request, view, again)


def _as_it_stands(request: Request, view: use.RotorView, again: Make) -> Response:
    shows(request, view, again)
    return _told(request, view)


def _told(request: Request, view: use.RotorView) -> Response:
    body = view_out(view)
    text = text_of(body)
    tag = rotor_tag(view.rotor.id, text)
    return unchanged(request, tag) or tagged(body, tag, text)


def _both(wait_for: int) -> RequestError:
    problem, remedy = "is given beside `version` or `at`", "wait first, then ask for the version"
    faults = [fault("wait_for", wait_for, problem, remedy)]
    return RequestError(422, "invalid-input", f"wait_for {problem}. To mend it: {remedy}", faults)


async def _wait(
    services: Services, r: str, wait_for: int | None, timeout: float | None
) -> use.RotorView:
    """The rotor once `wait_for` is applied, or as it stands when the time is over or it blocks."""
    most = services.settings.wait_max_s
    timeout = min(WAIT_S, most) if timeout is None else timeout
    if timeout > most:
        remedy = f"wait at most {most:g} s, and ask again"
        raise RequestError(
            422,
            "invalid-input",
            f"timeout = {timeout:g} is above {most:g} s. To mend it: {remedy}",
            [fault("timeout", timeout, f"is above {most:g} s", remedy)],
        )
    if wait_for is None:
        return await run_in_threadpool(use.view_rotor, services.store, r)
    changes = services.changes
    end = time.monotonic() + timeout
    async with changes.waiting():
        event = changes.event()
        view = await run_in_threadpool(use.view_rotor, services.store, r)
        rotor = view.rotor
        while not (use.has_applied(rotor, wait_for) or rotor.blocked or changes.closing):
            left = end - time.monotonic()
            if left <= 0:
                break
            with suppress(TimeoutError):
                await asyncio.wait_for(event.wait(), min(left, LOOK_AGAIN_S))
            # each commit of any rotor wakes all who wait: they look at no more than they wait for
            event = changes.event()
            rotor = await run_in_threadpool(use.find_rotor, services.store, r)
    if rotor == view.rotor:
        return view
    return await run_in_threadpool(use.view_rotor, services.store, r)


@router.post("/{r}/retry", status_code=202, summary="Let a blocked rotor be tried again")
def post_retry(r: Name, services: Wired, body: Nothing | None = None) -> dict[str, Any]:
    return rotor_out(use.retry(services.store, r))


@router.post("/{r}/policy", summary="Decide what the rotor does by itself from now on")
def post_policy(r: Name, body: PolicyIn, services: Wired) -> dict[str, Any]:
    return rotor_out(decide(services.store, r, body.adopt, body.diagnose))


@router.post("/{r}/blades", status_code=202, summary="A blade joins the rotor")
def post_blade(r: Name, body: BladeIn, services: Wired) -> JSONResponse:
    return accepted([add_blade(services.store, r, body.record())])


@router.post("/{r}/blades/{b}/retirement", status_code=202, summary="A blade leaves the rotor")
def post_retirement(r: Name, b: Name, services: Wired, body: Nothing | None = None) -> JSONResponse:
    return accepted([retire_blade(services.store, r, b)])
